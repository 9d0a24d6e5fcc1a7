"""Size and shape of a hand from a recording."""

from __future__ import annotations

import json
from bisect import insort
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import RecordingError, ResultError
from posetrack_cli.files import write_output
from posetrack_cli.hand.config import HandConfig, HandSettings
from posetrack_cli.hand.fit.fitter import tile_of
from posetrack_cli.hand.fit.skeleton import FOREARM, NO_INNER, NO_THUMB, THUMB
from posetrack_cli.hand.fit.terms import Terms, Tile
from posetrack_cli.hand.model.anatomy import (
    FINGERS,
    POSE_SIZE,
    HandAnatomy,
    HandShape,
    ShapeSpace,
    shape_space,
)
from posetrack_cli.hand.model.hand import HandMaker, HandModel, hand_maker, inside_limits
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.search import Acquisition
from posetrack_cli.hand.shape_bundle import Bundle, Observe, adjusted
from posetrack_cli.outputs import whole_or_nothing
from posetrack_cli.phases import Advance, phase
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.reader import read_result

# Which frames a hand's shape is estimated from: those that show the most of fingers


FIRST_FRAMES = 16
"""How many frames the first round uses, one of each part of the recording. The average hand is placed wrongly
in more of the others, and a shape adjusted to those starts the next round worse."""


class _Shown(NamedTuple):
    """A frame, and how much of fingers it shows, mm^2."""

    fingers_mm2: float
    frame: Frame

    def rank(self) -> tuple[float, int]:
        """What sorts those first that show the most, of equal ones the earliest."""
        return -self.fingers_mm2, self.frame.index


class ShownFingers:
    """Chooses frames by how much of fingers they show, those of the first round from all parts.

    Frames that show much of them follow each other, and are much alike. The first round, which knows the
    average hand alone, takes the best frame of each of ``FIRST_FRAMES`` parts of the recording; what it still
    lacks, and all others, are the best of the rest. No more frames are kept than are chosen.

    Args:
        most: how many are chosen.
        count: how many are expected; further ones belong to the last part.
    """

    def __init__(self, most: int, count: int) -> None:
        self._first, self._most, self._count = min(FIRST_FRAMES, most), most, max(count, 1)
        self._best: dict[int, _Shown] = {}
        self._rest: list[_Shown] = []
        self.seen = 0

    def add(self, frame: Frame, fingers_mm2: float) -> None:
        """Take the next frame into account."""
        part = min(self.seen * self._first // self._count, self._first - 1)
        self.seen += 1
        shown, best = _Shown(fingers_mm2, frame), self._best.get(part)
        passed: _Shown | None = shown
        if fingers_mm2 > 0.0 and (best is None or shown.rank() < best.rank()):
            self._best[part], passed = shown, best
        if passed is not None:
            insort(self._rest, passed, key=_Shown.rank)
        del self._rest[self._most - len(self._best) :]

    @property
    def frames(self) -> list[Frame]:
        """Those of the first round, in order, then the others."""
        ranked = [*self._best.values(), *self._rest]
        parts = (ranked[: self._first], ranked[self._first :])
        return [shown.frame for part in parts for shown in sorted(part, key=lambda one: one.frame.index)]


# What is doubtful about a hand's shape, in words, and what to do about it


HAND_LENGTHS_MM = (120.0, 225.0)
"""Of a child of three years, and of the largest men, wrist to tip."""
LARGEST_COEFFICIENT = 3.0
"""One hand in four hundred is farther from the mean in a coefficient."""
HARDLY_LEARNT = 0.8
"""A measure whose standard deviation is no less than this share of what it was before."""
_SHOWN = {
    "fingers' lengths": (("index_length", "middle_length", "ring_length", "little_length"), "the open hand"),
    "thumb": (("thumb_length",), "the thumb beside the open hand"),
    "palm": (("palm_length", "palm_width"), "the palm or the back of the hand"),
}


def doubts_of(found: Calibration) -> str:
    """Return what to add to a line about a hand; empty where nothing is doubtful."""
    length, (low, high) = found.length_mm, HAND_LENGTHS_MM
    if not low <= length <= high:
        return f", which no hand is ({low:.0f} to {high:.0f} mm): is the depth in mm (--depth-unit-mm)?"
    if max((abs(c) for c in found.shape.coefficients), default=0.0) > LARGEST_COEFFICIENT:
        return ", of proportions that hardly any hand has; posetrack view shows whether it fits"
    sd, prior = found.measured.sd, found.measured.prior_sd
    for what, (names, shown) in _SHOWN.items():
        if all(sd[name] > HARDLY_LEARNT * prior[name] for name in names):
            return f", its {what} hardly seen; record {shown} facing the sensor for a few seconds"
    return ""


# What a hand measures, mm: what people can compare with a ruler, whatever numbers a shape is made of


MEASURES: tuple[str, ...] = (
    "hand_length",
    "palm_length",
    "palm_width",
    *(f"{finger}_length" for finger in FINGERS),
    *(f"{finger}_radius" for finger in FINGERS),
)


def measures_of(anatomy: HandAnatomy) -> FloatArray:
    """Return the measures (13,) of a hand, mm, in the order of ``MEASURES``.

    ``hand_length`` is from the wrist to the tip of the straight middle finger, ``palm_length`` to its
    knuckle; ``palm_width`` from the index to the little finger's knuckle; lengths of fingers are from knuckle
    (of the thumb, from its second joint) to tip, radii means over a finger.
    """
    bases, segments = anatomy.base_positions, anatomy.segments
    palm = float(np.linalg.norm(bases[2]))
    lengths = segments.sum(axis=1) - np.array([segments[0, 0], 0.0, 0.0, 0.0, 0.0])
    width = float(np.linalg.norm(bases[1] - bases[4]))
    return np.array([palm + segments[2].sum(), palm, width, *lengths, *anatomy.radii.mean(axis=1)])


@dataclass(frozen=True, eq=False)
class Measured:
    """A hand's measures, mm, and their standard deviations: stated, and what they are before a recording.

    Attributes:
        values, sd, prior_sd: by the names of ``MEASURES``, and ``padding``.
    """

    values: Mapping[str, float]
    sd: Mapping[str, float]
    prior_sd: Mapping[str, float]


def measured(
    maker: HandMaker, space: ShapeSpace, side: str, shape: HandShape, covariance: FloatArray
) -> Measured:
    """Return a shape's measures, and their standard deviations from those of the space's numbers (S, S).

    ``padding``, by how much the skin stands out, is measured beside ``MEASURES`` where the space has one.
    """
    theta = space.theta(shape)

    def numbers(of: FloatArray) -> FloatArray:
        shape = space.shape(of)
        known = measures_of(maker(side, shape).anatomy)
        return np.append(known, shape.padding_mm) if has_padding else known

    has_padding = "padding_mm" in space.names
    names = (*MEASURES, "padding") if has_padding else MEASURES
    here = numbers(theta)
    rates = np.array([(numbers(theta + step) - here) / step.sum() for step in np.diag(space.steps)])

    def deviations(of: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.einsum("sm,st,tm->m", rates, of, rates)))

    stated, before = deviations(covariance), deviations(np.diag(space.sd**2))
    rows = (dict(zip(names, row.tolist(), strict=True)) for row in (here, stated, before))
    return Measured(*rows)


# The hand that an earlier run tracked: its side and shape, as settings of another one


def hand_assignments(path: Path) -> tuple[str, ...]:
    """Return the ``[hand]`` table of a result's run as assignments, such as ``hand.scale=1.05``.

    Args:
        path: of a result of ``hand run``, finished or not.

    Raises:
        ResultError: it is none, or says nothing of a hand.
    """
    run = read_result(path).run
    try:
        settings = HandSettings.model_validate(json.loads(run["configuration"])["hand"])
    except (KeyError, TypeError, ValueError, RecursionError, ValidationError) as error:
        raise ResultError(
            "tells no hand's shape", where=path, expected="a result of posetrack hand run"
        ) from error
    # texts, numbers and lists of numbers are the same in JSON and in TOML
    told = settings.model_dump(mode="json", exclude_none=True)
    return tuple(f"hand.{name}={json.dumps(value)}" for name, value in told.items())


# Calibration of a recording's hand: find it in frames that show its fingers, adjust its shape; again.
#
# No truth is used. Frames are chosen from the whole recording by how much of fingers they show: a fist from
# the back fits many hands, and makes every one of them a wrong one. The first time the hand is found with the
# average shape, in the frame of each part of the recording that shows the most; then with the one that was
# found, in more frames; a third time if that one fits no better.


LOOKED_AT = 64
"""Frames, evenly over the recording, of which those are chosen that show the most of fingers; less than twice
as many where the recording's frames do not divide."""
_UNKNOWN_COUNT = 900
"""Frames of a recording that does not say how many it has: half a minute."""
ROUNDS, MOST_ROUNDS = 2, 3
"""How often a hand is found and its shape adjusted: once more where the adjusted hand costs no less than the
average one. An adjustment may end at skin that stands out by 6 mm, and the next one returns from there. What
the last adjustment gave is found once more before it is judged."""
_FEWEST_FRAMES = 4
_DEAREST = 1.15
"""Of the median cost: dearer frames are not found well."""
_ITERATIONS = 8
_ANOTHER_SIZE = 1.25
"""A shape that is by more larger or smaller than the size that fits best explains something else, too."""
_GOOD_PERCENT = 20.0
"""Of the frames' costs: what good fits cost."""

_DECIMALS = 4  # of the numbers in a hand file


@dataclass(frozen=True)
class CalibrationOptions:
    """What a calibration depends on besides recording and configuration.

    Attributes:
        side: ``right`` or ``left``; None to find out.
        frames: how many frames the shape is adjusted to in the end.
        start: the first frame that is used.
    """

    side: str | None = None
    frames: int = 32
    start: int = 0


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration found.

    Attributes:
        side: ``right`` or ``left``.
        shape: of the hand.
        measured: its lengths, mm, with standard deviations.
        frames_seen: frames that were looked at.
        frames_used: frames that the shape was adjusted to.
        residual_mm: weighted root mean square of their residuals.
        costs_mm: median costs of the frames of the first round for the average hand of that size, and for
            the adjusted hand that they were found with last.
        good_mm: what the hand of the last round costs in frames in which it fits well.
        begun_scale, begun_mm: scale and length of the hand that it was begun with.
    """

    side: str
    shape: HandShape
    measured: Measured
    frames_seen: int
    frames_used: int
    residual_mm: float
    costs_mm: tuple[float, float]
    good_mm: float
    begun_scale: float
    begun_mm: float

    @property
    def length_mm(self) -> float:
        """From the wrist to the middle finger's tip."""
        return self.measured.values["hand_length"]

    @property
    def is_of_another_size(self) -> bool:
        """Whether the hand is much larger or smaller than the one that it was begun with."""
        return not 1.0 / _ANOTHER_SIZE < self.length_mm / self.begun_mm < _ANOTHER_SIZE

    @property
    def likely_scale(self) -> float:
        """What would make the hand that it was begun with as long."""
        return self.begun_scale * self.length_mm / self.begun_mm

    @property
    def settings(self) -> dict[str, object]:
        """The shape as keys of a configuration's ``[hand]`` table."""
        named = {
            name: getattr(self.shape, name) for name in HandSettings.model_fields if hasattr(self.shape, name)
        }
        return {name: _rounded(value) for name, value in named.items()}


def shape_of(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration:
    """Estimate the shape of a hand whose side and size are known roughly: those of the configuration.

    Raises:
        RecordingError: no frame, or no hand that can be found in at least four frames.
    """
    calibrator = _Calibrator(recording, config, options)
    side, shape, found = config.hand.side, HandShape(config.hand.scale), None
    medians: list[float] = []
    while len(medians) < ROUNDS or (len(medians) < MOST_ROUNDS and medians[-1] >= medians[0]):
        again = f"{len(medians) + 1} of {ROUNDS}" if len(medians) < ROUNDS else "once more"
        most = options.frames if medians else FIRST_FRAMES
        poses, thumbs, costs = calibrator.find(shape, most, again)
        chosen = calibrator.chosen(costs)
        medians.append(float(np.median(costs[:FIRST_FRAMES])))
        found = calibrator.adjust(chosen, poses[chosen], thumbs[chosen], shape)
        shape = found.shape
    if medians[-1] >= medians[0]:  # which tells of the shape before the last adjustment
        medians.append(float(np.median(calibrator.find(shape, FIRST_FRAMES, "with its last shape")[2])))
    assert found is not None
    numbers = measured(calibrator.maker, calibrator.space, side, shape, found.covariance)
    cost, good = (medians[0], medians[-1]), good_cost(costs)
    begun = HandShape(config.hand.scale)
    begun_mm = float(measures_of(calibrator.maker(side, begun).anatomy)[0])
    return Calibration(
        side,
        shape,
        numbers,
        calibrator.seen,
        len(chosen),
        found.residual_mm,
        cost,
        good,
        begun.scale,
        begun_mm,
    )


def good_cost(costs: FloatArray) -> float:
    """Return what good fits cost: one of the costs (F,), which are infinite where no hand is found."""
    return float(np.percentile(costs, _GOOD_PERCENT, method="lower"))


class _Calibrator:
    """The parts of a calibration."""

    def __init__(self, recording: Recording, config: HandConfig, options: CalibrationOptions) -> None:
        self._recording, self._config, self._options = recording, config, options
        self._side, self._camera = config.hand.side, recording.cameras[0]
        self.maker, self.space = hand_maker(config.hand.mesh), shape_space(config.hand.mesh)
        shown = self._showing_fingers(HandShape(config.hand.scale))
        self.seen, self._frames = shown.seen, shown.frames

    def _showing_fingers(self, shape: HandShape) -> ShownFingers:
        """The frames that show the most of fingers: those of the first round, in order, then the others.

        Raises:
            RecordingError: there is none.
        """
        options, count = self._options, self._recording.frame_count
        ahead = _UNKNOWN_COUNT if count is None else count - options.start
        stride = max(1, ahead // LOOKED_AT)
        finder, shown = self._finder(shape), ShownFingers(options.frames, -(-ahead // stride))
        with phase("choosing frames", "frame", -(-ahead // stride)) as advance:
            for frame in self._recording.frames(start=options.start, end=None, stride=stride):
                area = max((place.fingers_mm2 for place in finder.detect(frame.depth)), default=0.0)
                shown.add(frame, area)
                advance(1)
        if not shown.seen:
            raise RecordingError("holds no frame", where=self._recording.path)
        return shown

    def _finder(self, shape: HandShape) -> Acquisition:
        return Acquisition(self._config, self.maker(self._side, shape), self._camera)

    def find(self, shape: HandShape, most: int, again: str) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The poses (F, 22) of a hand in the frames, its thumb's inner angles (F, 2), and costs (F,), mm.

        A cost is infinite where there is none.

        Args:
            shape: of the hand.
            most: how many of the frames, those of the first round first.
            again: for people: which time it is.
        """
        finder, frames = self._finder(shape), self._frames[:most]
        poses, costs = np.zeros((len(frames), POSE_SIZE)), np.full(len(frames), np.inf)
        poses[:, 6], thumbs = 1.0, np.zeros((len(frames), len(NO_THUMB)))
        with phase(f"finding the {self._side} hand, {again}", "frame", len(frames)) as advance:
            for k, frame in enumerate(frames):
                found = finder.search(frame.depth)
                if found is not None:
                    poses[k], costs[k] = inside_limits(found.pose[None])[0], found.cost
                    thumbs[k] = found.inner[THUMB]
                advance(1)
        return poses, thumbs, costs

    def chosen(self, costs: FloatArray) -> IntArray:
        """Frames in which the hand was found well.

        Raises:
            RecordingError: there are too few.
        """
        limit = _DEAREST * float(np.median(costs[np.isfinite(costs)])) if np.isfinite(costs).any() else 0.0
        good = np.flatnonzero(costs <= limit)
        if good.size < _FEWEST_FRAMES:
            raise RecordingError(
                "no hand that can be tracked",
                where=self._recording.path,
                found=f"{good.size} of {len(costs)} frames",
                expected=f"{_FEWEST_FRAMES} or more",
                hint="choose a recording that shows one hand well, open and with its fingers bent",
            )
        return good

    def adjust(self, chosen: IntArray, poses: FloatArray, thumbs: FloatArray, shape: HandShape) -> Bundle:
        """The shape and the poses that fit the frames best."""
        with phase(f"adjusting its shape to {len(chosen)} frames", "view") as advance:
            return adjusted(
                self.maker,
                self.space,
                self._side,
                shape,
                poses,
                thumbs,
                self._observing([self._frames[k] for k in chosen], advance),
                self._config.observation.tile_px,
                iterations=_ITERATIONS,
                terms=_terms(self._config),
            )

    def _observing(self, frames: Sequence[Frame], advance: Advance) -> Observe:
        def observe(f: int, pose: FloatArray, thumb: FloatArray, hand: HandModel) -> Tile:
            advance(1)
            observer = Observer(self._config, hand.anatomy, self._camera, segment=True)
            expected = np.append(NO_INNER[FOREARM], thumb)
            return tile_of(observer.observe(frames[f].depth, pose, expected), self._camera)

        return observe


def _terms(config: HandConfig) -> Terms:
    """The residuals' weights with the configuration's clamp."""
    return Terms()._replace(
        clamp_mm=config.observation.clamp_mm, unread_weight=config.observation.unread_weight
    )


def write_hand_file(path: Path, calibration: Calibration, mesh: str | None, source: str) -> None:
    """Write a TOML file that ``--shape`` and ``--config`` read.

    Args:
        path: the file.
        calibration: side and shape.
        mesh: the GLB file that the shape is of, None for the average hand.
        source: name of the recording, for the comment.

    Raises:
        ResultError: it cannot be written.
    """
    with whole_or_nothing(path) as part:
        write_output(part, hand_text(calibration, mesh, source, path.parent).encode())


def hand_text(calibration: Calibration, mesh: str | None, source: str, folder: Path) -> str:
    """The file's text; a mesh is named relative to the file's folder where it lies in it, else in full."""
    values, sd = calibration.measured.values, calibration.measured.sd
    settings = calibration.settings
    names = (
        ("scale", "coefficients", "padding_mm")
        if mesh is None
        else tuple(n for n in settings if n != "coefficients")
    )
    lines = [
        f"# Calibrated from {json.dumps(source)}: {calibration.frames_used} frames,"
        f" residual {calibration.residual_mm:.2f} mm.",
        "[hand]",
        f'side = "{calibration.side}"',
        *(f"{name} = {_value(settings[name])}" for name in names),
    ]
    if mesh is not None:
        lines.append(f"mesh = {json.dumps(_reachable(Path(mesh), folder))}")
    lines += ["", "# Measures, mm, and their standard deviations:"]
    lines += [f"# {name.replace('_', ' ')} {value:.1f} +- {sd[name]:.1f}" for name, value in values.items()]
    return "\n".join(lines) + "\n"


def _reachable(mesh: Path, folder: Path) -> str:
    mesh, folder = mesh.resolve(), folder.resolve()
    return str(mesh.relative_to(folder) if mesh.is_relative_to(folder) else mesh)


def _rounded(value: object) -> object:
    if isinstance(value, tuple):
        return tuple(round(one, _DECIMALS) for one in value)
    return round(float(value), _DECIMALS)  # type: ignore[arg-type]


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(f'{one:.{_DECIMALS}f}' for one in value)}]"
    return f"{value:.{_DECIMALS}f}"
