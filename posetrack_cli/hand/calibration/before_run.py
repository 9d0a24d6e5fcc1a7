"""What a run finds out about its hand before its first frame: right or left and, on request, its shape.

It depends on the recording, the configuration and the seed alone, so a run that is resumed finds the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, dropwhile, islice, takewhile

import numpy as np

from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.calibration.calibrate import (
    NS_PER_S,
    SIDES,
    Calibration,
    CalibrationOptions,
    calibrate,
)
from posetrack_cli.hand.calibration.sequence import SequenceFitter
from posetrack_cli.hand.config import HandConfig, HandSettings
from posetrack_cli.hand.model import hand_maker
from posetrack_cli.hand.segmentation import detect
from posetrack_cli.hand.shape import SHAPE_NAMES
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording

LOOKED_AT_S = 10.0
"""A hand that shows itself later is not waited for."""
TRIAL_FRAMES = 12
_CLEAR_SHARE = 0.1
"""Mean costs that differ by less than this share of the smaller do not tell a right hand from a left one."""


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
    side, line = _side_of(recording, config, start, seed)
    return HandFound(_with_hand(config, {"side": side}), line)


def _side_of(recording: Recording, config: HandConfig, start: int, seed: int) -> tuple[str, str]:
    camera = recording.cameras[0]
    frames = _with_hand_in_view(recording.frames(start=start, end=None, stride=1), config, camera)
    if not frames:
        return SIDES[0], f"no hand in the first {LOOKED_AT_S:g} s, taken for a right one; --hand-side tells"
    costs = {side: _mean_cost(frames, config, camera, side, seed) for side in SIDES}
    side, other = sorted(SIDES, key=lambda side: costs[side])
    if costs[other] - costs[side] < _CLEAR_SHARE * costs[side]:
        return side, f"a {side} hand, but hardly so; --hand-side tells"
    return side, f"a {side} hand"


def _with_hand_in_view(frames: Iterator[Frame], config: HandConfig, camera: Camera) -> list[Frame]:
    """The first frames from that on in which a hand is detected; none if that takes too long."""
    first = next(frames, None)
    if first is None:
        return []
    last = first.stamp_ns + int(LOOKED_AT_S * NS_PER_S)
    early = takewhile(lambda frame: frame.stamp_ns <= last, _readable(frames))
    unseen = dropwhile(
        lambda frame: not detect(frame.depth, camera, config.detection), chain((first,), early)
    )
    return list(islice(unseen, TRIAL_FRAMES))


def _readable(frames: Iterator[Frame]) -> Iterator[Frame]:
    """The frames up to one that cannot be read, which the run itself will tell."""
    with suppress(RecordingError):
        yield from frames


def _mean_cost(frames: Sequence[Frame], config: HandConfig, camera: Camera, side: str, seed: int) -> float:
    """At which mean cost frames are tracked with a hand of a side, mm; a lost one costs the clamp."""
    hand = hand_maker(config.hand.mesh)(side, config.hand.shape)
    fitted = SequenceFitter(config, hand, camera).fit(frames, np.random.default_rng(seed))
    return float(np.minimum(fitted.costs, config.observation.clamp_mm).mean())


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
