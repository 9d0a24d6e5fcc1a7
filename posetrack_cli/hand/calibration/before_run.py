"""What a run finds out about its hand before its first frame: right or left and, on request, its shape.

It depends on the recording, the configuration and the seed alone, so a run that is resumed finds the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, takewhile

import numpy as np

from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.acquisition import Acquisition
from posetrack_cli.hand.calibration.calibrate import (
    NS_PER_S,
    SIDES,
    Calibration,
    CalibrationOptions,
    calibrate,
)
from posetrack_cli.hand.config import HandConfig, HandSettings
from posetrack_cli.hand.model import hand_maker
from posetrack_cli.hand.shape import SHAPE_NAMES
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording

LOOKED_AT_S = 10.0
"""A hand that shows itself later is not waited for."""
ASKED_EVERY = 12
"""Frames between those that are asked for the side: they err less alike than neighbours do."""
_COST_PER_LOG_ODDS, _MOST_A_FRAME = 0.9, 3.0
"""What the other side costs more, mm, for one unit of log odds, and what a frame tells at most **[ours]**.

Of 94 frames of 14 people (600-617 of the synthetic strangers, with the average hand) the true side is the
cheaper one in four of five; 0.7 mm would be likeliest if frames erred independently."""
CLEAR_LOG_ODDS, MOST_ASKED = 4.0, 16
"""Above it the side is certain (.98); frames asked at most."""


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
    seed: int,
    report: Callable[[str], None] = lambda line: None,
) -> HandFound:
    """Decide what a configuration leaves open about the hand, from the first seconds of the run's part.

    Args:
        recording: depth frames.
        config: its ``hand.side`` may be ``auto``, its ``init.calibrate`` true.
        start: the run's first frame.
        seed: of fits.
        report: called with what is being done.

    Raises:
        RecordingError: a shape is asked for, and no hand can be tracked.
        UsageError: the configuration's mesh is no hand that can be used.
    """
    if config.init.calibrate:
        given = None if config.hand.side == "auto" else config.hand.side
        options = CalibrationOptions(given, seed=seed, start=start)
        found = calibrate(recording, config, options, report)
        return HandFound(_with_shape(config, found), _shape_line(found))
    if config.hand.side != "auto":
        return HandFound(config)
    side, line = _side_of(recording, config, start)
    return HandFound(_with_hand(config, {"side": side}), line)


def _side_of(recording: Recording, config: HandConfig, start: int) -> tuple[str, str]:
    """The side of a hand, and a line that tells it: frames are asked until they agree clearly enough."""
    finders = {side: _finder(config, recording.cameras[0], side) for side in SIDES}
    log_odds, asked = 0.0, 0
    for frame in _early_frames(recording, start):
        if not finders[SIDES[0]].detect(frame.depth):
            continue
        costs = [finders[side].best_cost(frame.depth) for side in SIDES]
        log_odds += float(np.clip((costs[1] - costs[0]) / _COST_PER_LOG_ODDS, -_MOST_A_FRAME, _MOST_A_FRAME))
        asked += 1
        if abs(log_odds) >= CLEAR_LOG_ODDS or asked == MOST_ASKED:
            break
    if not asked:
        return SIDES[0], f"no hand in the first {LOOKED_AT_S:g} s, taken for a right one; --hand-side tells"
    side = SIDES[0] if log_odds >= 0.0 else SIDES[1]
    probability = 1.0 / (1.0 + np.exp(-abs(log_odds)))
    if abs(log_odds) < CLEAR_LOG_ODDS:
        return side, f"a {side} hand, but hardly so (probability {probability:.2f}); --hand-side tells"
    return side, f"a {side} hand"


def _finder(config: HandConfig, camera: Camera, side: str) -> Acquisition:
    return Acquisition(config, hand_maker(config.hand.mesh)(side, config.hand.shape), camera)


def _early_frames(recording: Recording, start: int) -> Iterator[Frame]:
    """Frames of the first seconds, some time apart: hands that turn and open tell their side."""
    frames = recording.frames(start=start, end=None, stride=ASKED_EVERY)
    first = next(frames, None)
    if first is None:
        return iter(())
    last = first.stamp_ns + int(LOOKED_AT_S * NS_PER_S)
    return takewhile(lambda frame: frame.stamp_ns <= last, chain((first,), _readable(frames)))


def _readable(frames: Iterator[Frame]) -> Iterator[Frame]:
    """The frames up to one that cannot be read, which the run itself will tell."""
    with suppress(RecordingError):
        yield from frames


def _with_shape(config: HandConfig, found: Calibration) -> HandConfig:
    shape = found.shape
    own = {name: getattr(shape, name) for name in ("scale", "finger_lengths", "finger_widths")}
    palm = {name: getattr(shape, name) for name in SHAPE_NAMES if name in HandSettings.model_fields}
    return _with_hand(config, {"side": found.side, **own, **palm})


def _with_hand(config: HandConfig, changes: dict[str, object]) -> HandConfig:
    return config.model_copy(update={"hand": config.hand.model_copy(update=changes)})


def _shape_line(found: Calibration) -> str:
    return (
        f"a {found.side} hand of scale {found.shape.scale:.3f}, calibrated on {found.frames_used} frames,"
        f" residual {found.residual_mm:.2f} mm"
    )
