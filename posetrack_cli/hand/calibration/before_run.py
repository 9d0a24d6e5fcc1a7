"""What is found out about a hand before it is tracked: right or left, its size and its shape.

It depends on the recording and the configuration alone, so a run that is resumed finds the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice

from posetrack_cli.errors import RecordingError
from posetrack_cli.hand.calibration.calibrate import Calibration, CalibrationOptions, shape_of
from posetrack_cli.hand.calibration.doubts import doubts_of
from posetrack_cli.hand.calibration.sides import decide_side
from posetrack_cli.hand.calibration.trial import (
    LOOKED_AT_S,
    SIDES,
    WELL_KNOWN_MM,
    Trial,
    early_frames,
    is_size_open,
    tried,
    tried_all_over,
)
from posetrack_cli.hand.config import HandConfig, HandSettings
from posetrack_cli.hand.evidence import DepthEvidence
from posetrack_cli.hand.keypoints.file import KeypointFile
from posetrack_cli.recording.recording import Recording

_SHOWN = 8
"""Frames that are described where none shows a hand."""
_FAR_CHEAPER = 0.8
"""Of what the average hand costs in the size that fitted best: what a hand of another size costs at most."""
_DEARER = 1.25
"""Of what the average hand costs: what a shape costs at most **[ours]**. Shapes are adjusted to other
residuals than searches are judged by, so a better one may cost more. Of 133 people (504 to 753 of the
synthetic strangers) nineteen had shapes that cost .91 to 1.12, and fingertips of all were closer with them
than with the average hand, by 1.9 mm on average; sixteen of these cost .79 to 1.16 once steps
stayed within bounds."""


@dataclass(frozen=True)
class HandFound:
    """What is known of the hand when a run begins.

    Attributes:
        config: with a side, and the shape that was found.
        line: what was found, for people; empty where nothing was left open.
        is_doubtful: whether the line tells a doubt.
    """

    config: HandConfig
    line: str = ""
    is_doubtful: bool = False


def find_hand(
    recording: Recording,
    config: HandConfig,
    start: int,
    keypoints: KeypointFile | None = None,
) -> HandFound:
    """Decide what a configuration leaves open about the hand: its side, its size, its shape.

    Side and size are told by the first seconds from the run's first frame, the shape by frames from there to
    the recording's end, wherever the run ends.

    Args:
        recording: depth frames.
        config: its ``hand.side`` may be ``auto``, its ``init.shape``, too.
        start: the run's first frame.
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
        line = _nothing_found(recording, config, start, sides[0]) if len(sides) > 1 else ""
        return HandFound(_with_hand(config, {"side": sides[0]}), line, bool(line))

    estimate = _shapes(recording, config, trial, CalibrationOptions(start=start))

    def estimate_usable(side: str) -> Calibration | None:
        found = estimate(side)
        return found if found is not None and _is_usable(found) else None

    is_unknown = is_open and trial.cost > WELL_KNOWN_MM
    likelier = decide_side(trial, estimate_usable if is_unknown else lambda side: None)
    sized, found = _sized(config, trial, likelier.side), likelier.found
    told = f"a {likelier.side} hand"
    doubt = (
        ""
        if likelier.is_sure
        else f", but hardly so (probability {likelier.probability:.2f}); --hand-side tells"
    )
    if found is not None:
        more = doubts_of(found)
        line = f"{told}, {found.length_mm:.0f} mm long{doubt}{more}"
        return HandFound(_judged_by(_with_hand(sized, found.settings), found), line, bool(doubt or more))
    changed = sized.hand.scale != config.hand.scale
    line = told + (f" of scale {sized.hand.scale:.2f}" if changed else "") + doubt
    return HandFound(sized, line if len(sides) > 1 or changed else "", bool(doubt))


def _nothing_found(recording: Recording, config: HandConfig, start: int, side: str) -> str:
    """What the first seconds show, and what a hand that comes later is taken for."""
    frames = list(islice(early_frames(recording, start), _SHOWN))
    line = f"no hand in the first {LOOKED_AT_S:g} s"
    if not frames:
        return line
    seen = DepthEvidence(recording, config, frames)
    line = f"{line}: {seen.line}"
    later = f"; a later one is taken for a {side} hand, --hand-side states another"
    return f"{line}{later if seen.is_in_range else ''}"


def calibrate(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration:
    """Estimate side, size and shape of the hand in a recording, whatever is configured of them.

    Args:
        recording: depth frames.
        config: of window, segmentation and fits; of its hand only the mesh is read.
        options: the rest.

    Raises:
        RecordingError: no frame, or no hand that can be found in at least four frames.
        UsageError: the configuration's mesh is no hand that can be used.
    """
    sides = (options.side,) if options.side else SIDES
    bare = config.model_copy(update={"hand": HandSettings(mesh=config.hand.mesh)})
    trial = tried_all_over(recording, bare, options.start, sides)
    likelier = decide_side(trial, _shapes(recording, bare, trial, options))
    # what is wrong where there is none is said by trying again
    return likelier.found or shape_of(recording, _sized(bare, trial, likelier.side), options)


def _shapes(
    recording: Recording,
    config: HandConfig,
    trial: Trial,
    options: CalibrationOptions,
) -> Callable[[str], Calibration | None]:
    """Return what estimates the shape of a side's hand, begun in the size that is known best by then."""
    scales = {side: trial.scale(side) for side in trial.sides}

    def estimate(side: str) -> Calibration | None:
        sized = _with_hand(config, {"side": side, "scale": scales[side]})
        found = _shape_in_its_size(recording, sized, replace(options, side=side))
        if found is not None and found.begun_scale != scales[side]:
            scales.update(dict.fromkeys(scales, found.begun_scale))  # which hand it is changes no size
        return found

    return estimate


def _shape_in_its_size(
    recording: Recording, config: HandConfig, options: CalibrationOptions
) -> Calibration | None:
    """The hand's shape; one that leaves the size that fitted best is begun once more from its own.

    Sizes are tried in few frames and by short searches, which small hands before a forearm may mislead.
    """
    found = _shape(recording, config, options)
    if found is None or not found.is_of_another_size:
        return found
    again = _shape(recording, _with_hand(config, {"scale": found.likely_scale}), options)
    if again is None or again.is_of_another_size:
        return found
    return again if again.costs_mm[1] < _FAR_CHEAPER * found.costs_mm[0] else found


def _shape(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration | None:
    """The hand's shape, where enough frames show it."""
    try:
        return shape_of(recording, config, options)
    except RecordingError:
        return None


def _is_usable(found: Calibration) -> bool:
    """Whether a shape explains the frames nearly as well as the average hand or better, and is as large."""
    average, own = found.costs_mm
    return own <= _DEARER * average and not found.is_of_another_size


def _sized(config: HandConfig, trial: Trial, side: str) -> HandConfig:
    return _with_hand(config, {"side": side, "scale": trial.scale(side)})


def _with_hand(config: HandConfig, changes: dict[str, object]) -> HandConfig:
    return config.model_copy(update={"hand": config.hand.model_copy(update=changes)})


def _judged_by(config: HandConfig, found: Calibration) -> HandConfig:
    """The configuration with what good fits of the recording cost, where it says nothing of that."""
    if config.status.good_mm > 0.0:
        return config
    status = config.status.model_copy(update={"good_mm": round(found.good_mm, 4)})
    return config.model_copy(update={"status": status})
