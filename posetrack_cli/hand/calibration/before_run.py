"""What a run finds out about its hand before its first frame: right or left, its size and its shape.

It depends on the recording and the configuration alone, so a run that is resumed finds the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from posetrack_cli.errors import RecordingError
from posetrack_cli.hand.anatomy import make_anatomy
from posetrack_cli.hand.calibration.calibrate import Calibration, CalibrationOptions, shape_of
from posetrack_cli.hand.calibration.doubts import doubts_of
from posetrack_cli.hand.calibration.measures import measures_of
from posetrack_cli.hand.calibration.trial import (
    LOOKED_AT_S,
    SIDES,
    WELL_KNOWN_MM,
    Trial,
    is_size_open,
    tried,
)
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.keypoints.file import KeypointFile
from posetrack_cli.recording.recording import Recording

_ANOTHER_SIZE = 1.25
"""A shape that is by more larger or smaller than the size that fits best explains something else, too."""


@dataclass(frozen=True)
class HandFound:
    """What is known of the hand when a run begins.

    Attributes:
        config: with a side, and the shape that was found.
        line: what was found, for people; empty where nothing was left open.
    """

    config: HandConfig
    line: str = ""


def find_hand(
    recording: Recording,
    config: HandConfig,
    start: int,
    report: Callable[[str], None] = lambda line: None,
    keypoints: KeypointFile | None = None,
) -> HandFound:
    """Decide what a configuration leaves open about the hand: its side, its size, its shape.

    Side and size are told by the first seconds from the run's first frame, the shape by frames from there to
    the recording's end, wherever the run ends.

    Args:
        recording: depth frames.
        config: its ``hand.side`` may be ``auto``, its ``init.shape``, too.
        start: the run's first frame.
        report: called with what is being done.
        keypoints: from elsewhere: further places, and evidence of the side.

    Raises:
        UsageError: the configuration's mesh is no hand that can be used.
    """
    is_open = is_size_open(config)
    if config.hand.side != "auto" and not is_open:
        return HandFound(config)
    sides = SIDES if config.hand.side == "auto" else (config.hand.side,)
    trial = tried(recording, config, start, sides, keypoints)
    if not trial.asked:
        line = f"no hand in the first {LOOKED_AT_S:g} s, taken for a {sides[0]} one; --hand-side tells"
        return HandFound(_with_hand(config, {"side": sides[0]}), line if len(sides) > 1 else "")
    sized = _with_hand(config, {"side": trial.side, "scale": trial.scale})
    found = None
    if is_open and trial.cost > WELL_KNOWN_MM:
        report("estimating the hand's shape")
        found = _shape(recording, sized, CalibrationOptions(trial.side, start=start))
    doubt = _doubt_of_side(trial, len(sides))
    if found is not None:
        line = f"a {trial.side} hand, {found.length_mm:.0f} mm long{doubt}"
        return HandFound(_with_hand(sized, found.settings), line + doubts_of(found))
    changed = trial.scale != config.hand.scale
    line = f"a {trial.side} hand" + (f" of scale {trial.scale:.2f}" if changed else "") + doubt
    return HandFound(sized, line if len(sides) > 1 or changed else "")


def _doubt_of_side(trial: Trial, sides: int) -> str:
    if sides == 1 or trial.is_sure_of_side:
        return ""
    return f", but hardly so (probability {trial.probability:.2f}); --hand-side tells"


def _shape(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration | None:
    """The hand's shape, where enough frames show it and it explains them better than its size alone does."""
    try:
        found = shape_of(recording, config, options)
    except RecordingError:
        return None
    before, after = found.costs_mm
    ratio = measures_of(make_anatomy(found.side, config.hand.scale))[0] / found.length_mm
    return found if after < before and 1.0 / _ANOTHER_SIZE < ratio < _ANOTHER_SIZE else None


def _with_hand(config: HandConfig, changes: dict[str, object]) -> HandConfig:
    return config.model_copy(update={"hand": config.hand.model_copy(update=changes)})
