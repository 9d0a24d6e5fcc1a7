"""Calibration of a hand's size and shape from a recording."""

from __future__ import annotations

import json
from bisect import insort
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import ValidationError

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import RecordingError, ResultError, UsageError
from posetrack_cli.files import write_output
from posetrack_cli.hand.config import BOTH, HandConfig, HandSettings
from posetrack_cli.hand.fit.fitter import tile_of
from posetrack_cli.hand.fit.skeleton import FOREARM, NO_INNER, NO_THUMB, THUMB
from posetrack_cli.hand.fit.terms import Terms, Tile
from posetrack_cli.hand.model.anatomy import (
    FINGERS,
    HAND_LENGTH_MM,
    POSE_SIZE,
    HandAnatomy,
    HandShape,
    ShapeSpace,
    shape_space,
)
from posetrack_cli.hand.model.hand import HandMaker, HandModel, hand_maker, inside_limits
from posetrack_cli.hand.observe.detection import Detection
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.search import Acquisition, quick_search
from posetrack_cli.hand.shape_bundle import Bundle, Observe, adjusted
from posetrack_cli.outputs import whole_or_nothing
from posetrack_cli.phases import Advance, phase
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.depth import USUAL_UNITS_MM, unit_mm_of
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.reader import read_result

# Selection of frames

# One frame of each part of the recording: the average hand is misplaced in more of the others, and a shape
# adjusted to those gives the next round a worse start.
FIRST_FRAMES = 16


class _RankedFrame(NamedTuple):
    """A frame and its visible finger area, mm^2."""

    fingers_mm2: float
    frame: Frame

    def rank(self) -> tuple[float, int]:
        """Return the sort key: most finger area first, then the earliest frame."""
        return -self.fingers_mm2, self.frame.index


class FrameSelector:
    """Selects frames by visible fingers, with the first round's frames spread over the recording.

    The best frames follow each other and are similar. So the first round, which starts from the average hand,
    uses the best frame of each of ``FIRST_FRAMES`` parts; what it lacks, and all further frames, are the best
    of the rest. Only selected frames are kept in memory.

    Args:
        most: number of frames to select.
        count: number of expected frames; further ones belong to the last part.
    """

    def __init__(self, most: int, count: int) -> None:
        self._first, self._most, self._count = min(FIRST_FRAMES, most), most, max(count, 1)
        self._best: dict[int, _RankedFrame] = {}
        self._rest: list[_RankedFrame] = []
        self.seen = 0

    def add(self, frame: Frame, fingers_mm2: float) -> None:
        """Add the next frame."""
        part = min(self.seen * self._first // self._count, self._first - 1)
        self.seen += 1
        shown, best = _RankedFrame(fingers_mm2, frame), self._best.get(part)
        passed: _RankedFrame | None = shown
        if fingers_mm2 > 0.0 and (best is None or shown.rank() < best.rank()):
            self._best[part], passed = shown, best
        if passed is not None:
            insort(self._rest, passed, key=_RankedFrame.rank)
        del self._rest[self._most - len(self._best) :]

    @property
    def frames(self) -> list[Frame]:
        """Return the first round's frames in order, then the others."""
        ranked = [*self._best.values(), *self._rest]
        parts = (ranked[: self._first], ranked[self._first :])
        return [shown.frame for part in parts for shown in sorted(part, key=lambda one: one.frame.index)]


# Limits of plausible shapes

HAND_LENGTHS_MM = (120.0, 225.0)  # wrist to tip, from a three-year-old to the largest men
_LENGTH_SD_MM = 8.0  # of the population's ends and of an estimated length
LARGEST_COEFFICIENT = 3.0  # exceeded by one hand in 400
UNOBSERVED_SHARE = 0.8  # of the prior standard deviation; a measure above it was hardly observed
_PARTS = {
    "finger lengths": (("index_length", "middle_length", "ring_length", "little_length"), "the open hand"),
    "thumb": (("thumb_length",), "the thumb next to the open hand"),
    "palm": (("palm_length", "palm_width"), "the palm or the back of the hand"),
}

# Measures that can be checked with a ruler, mm

MEASURES: tuple[str, ...] = (
    "hand_length",
    "palm_length",
    "palm_width",
    *(f"{finger}_length" for finger in FINGERS),
    *(f"{finger}_radius" for finger in FINGERS),
)


def length_warning(length_mm: float, unit_mm: float) -> str:
    """Return a clause about a length that no hand has; empty for a plausible one.

    Lengths are proportional to the depth unit, so the unit of a usual hand follows: a common one if that
    gives a plausible length, else that of the average hand.

    Args:
        length_mm: of the hand.
        unit_mm: millimetres per stored unit of depth, as it was read.
    """
    low, high = HAND_LENGTHS_MM
    if low <= length_mm <= high:
        return ""
    common = [unit for unit in USUAL_UNITS_MM if low <= length_mm * unit / unit_mm <= high]
    likely = common or [float(f"{unit_mm * HAND_LENGTH_MM / length_mm:.2g}")]
    unit = min(likely, key=lambda unit: abs(np.log(length_mm * unit / unit_mm / HAND_LENGTH_MM)))
    better = f"--depth-unit-mm {unit:g} would give {length_mm * unit / unit_mm:.0f} mm"
    return f", outside {low:.0f} to {high:.0f} mm: {better}"


def length_probability(length_mm: float) -> float:
    """Return the probability of a hand's length against an error of size or unit: 1 if it is plausible."""
    low, high = HAND_LENGTHS_MM
    beyond = max(low - length_mm, length_mm - high, 0.0)
    return float(np.exp(-0.5 * (beyond / _LENGTH_SD_MM) ** 2))


def measures_of(anatomy: HandAnatomy) -> FloatArray:
    """Return the measures (13,) of a hand, mm, in the order of ``MEASURES``.

    ``hand_length`` is from the wrist to the tip of the straight middle finger, ``palm_length`` to its
    knuckle, ``palm_width`` between the knuckles of index and little finger. Finger lengths are from knuckle
    (for the thumb, second joint) to tip; radii are means over a finger.
    """
    bases, segments = anatomy.base_positions, anatomy.segments
    palm = float(np.linalg.norm(bases[2]))
    lengths = segments.sum(axis=1) - np.array([segments[0, 0], 0.0, 0.0, 0.0, 0.0])
    width = float(np.linalg.norm(bases[1] - bases[4]))
    return np.array([palm + segments[2].sum(), palm, width, *lengths, *anatomy.radii.mean(axis=1)])


@dataclass(frozen=True, eq=False)
class Measured:
    """A hand's measures and their standard deviations after and before the recording, mm.

    Attributes:
        values, sd, prior_sd: by the names of ``MEASURES``, and ``padding``.
    """

    values: Mapping[str, float]
    sd: Mapping[str, float]
    prior_sd: Mapping[str, float]


def measured(
    maker: HandMaker, space: ShapeSpace, side: str, shape: HandShape, covariance: FloatArray
) -> Measured:
    """Return a shape's measures and their standard deviations, given the covariance (S, S) of its parameters.

    ``padding``, the skin's extra thickness, is included if the space has it.
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


# Shape from an earlier result


class GivenShape(NamedTuple):
    """Configuration that a requested shape stands for.

    Attributes:
        init: value of ``init.shape``; None leaves it as configured.
        files: configuration files.
        assignments: settings such as ``hand.scale=1.05``, which others may override.
    """

    init: Literal["auto", "given"] | None = None
    files: tuple[str, ...] = ()
    assignments: tuple[str, ...] = ()


def read_shape(shape: str | Path | None) -> GivenShape:
    """Return the configuration of ``auto``, ``average``, a file of ``hand calibrate``, or hand results.

    Args:
        shape: a folder stands for the mean over its results, which are of one person.

    Raises:
        UsageError: a folder without results.
        ResultError: not a hand result.
    """
    name = None if shape is None else str(shape)
    if name is None:
        return GivenShape()
    if name == "auto":
        return GivenShape("auto")
    if name == "average":
        return GivenShape("given")
    path = Path(name)
    if path.is_dir():
        if not (results := sorted(path.rglob("*.mcap"))):
            expected = "results of posetrack hand run"
            raise UsageError("folder has no results", where=path, expected=expected)
        return GivenShape("given", assignments=_mean_assignments(results))
    if path.suffix == ".mcap":
        settings, baseline_mm = _settings_of(path)
        # both hands of a person have one shape; how many there are is not part of it
        left_out = {"count", "side"} if settings.count == BOTH else {"count"}
        baseline = (f"status.baseline_cost_mm={baseline_mm}",) if baseline_mm else ()
        return GivenShape("given", assignments=(*_assignments(settings, left_out), *baseline))
    return GivenShape(files=(name,))


def _settings_of(path: Path) -> tuple[HandSettings, float]:
    """Return the ``[hand]`` table of a result's run, finished or not, and the cost of its good fits, mm.

    Raises:
        ResultError: not a hand result.
    """
    run = read_result(path).run
    try:
        configuration = json.loads(run["configuration"])
        baseline_mm = float(configuration.get("status", {}).get("baseline_cost_mm", 0.0))
        return HandSettings.model_validate(configuration["hand"]), baseline_mm
    except (KeyError, TypeError, ValueError, RecursionError, ValidationError) as error:
        raise ResultError(
            "result has no hand shape", where=path, expected="a result of posetrack hand run"
        ) from error


def write_mean_shape(results: Sequence[Path], path: Path) -> None:
    """Write a configuration of the mean shape of hand results; replace an existing file.

    Raises:
        ResultError: see ``_mean_assignments``.
    """
    write_output(path, "".join(f"{line}\n" for line in _mean_assignments(results)).encode())


def _mean_assignments(results: Sequence[Path]) -> tuple[str, ...]:
    """Return the mean shape of results of one person, of either hand.

    Raises:
        ResultError: one is not of a hand, or the hands come from different files.
    """
    each = [_settings_of(path)[0] for path in results]
    meshes = {one.mesh and str(Path(one.mesh).absolute()) for one in each}
    if len(meshes) > 1:
        found = " and ".join(sorted(str(mesh) for mesh in meshes))
        raise ResultError("results are of hands from different files", where=results[0], found=found)
    space = shape_space(each[0].mesh)
    shape = space.shape(np.mean([space.theta(one.shape) for one in each], axis=0))
    mean = each[0].model_copy(update={**_shape_settings(shape), "mesh": meshes.pop()})
    return _assignments(mean, {"count", "side"})


def _shape_settings(shape: HandShape) -> dict[str, object]:
    """Return a shape as keys of the ``[hand]`` table."""
    named = {name: getattr(shape, name) for name in HandSettings.model_fields if hasattr(shape, name)}
    return {name: _rounded(value) for name, value in named.items()}


def _assignments(settings: HandSettings, left_out: set[str]) -> tuple[str, ...]:
    """Return a ``[hand]`` table as assignments, such as ``hand.scale=1.05``."""
    # texts, numbers and lists of numbers are the same in JSON and in TOML
    values = settings.model_dump(mode="json", exclude_none=True, exclude=left_out)
    return tuple(f"hand.{name}={json.dumps(value)}" for name, value in values.items())


# Calibration: find the hand in selected frames, adjust its shape to them, repeat
#
# Frames are selected by visible fingers: a fist from the back fits many hands, and a wrong shape explains all
# of them. The first round uses the average shape and one frame per part of the recording, the second its
# result and more frames. A third round follows if the result fits no better than the average hand.

SAMPLED_FRAMES = 64  # evenly over the recording; up to twice as many where its length does not divide
_ASSUMED_FRAMES = 900  # of a recording of unknown length: half a minute
ROUNDS, MAX_ROUNDS = 2, 3  # a shape with extreme padding recovers in the third round
_MIN_FRAMES = 4  # or all of a recording with fewer
_MAX_COST_RATIO = 1.15  # to the median cost; the hand is misplaced in costlier frames
_ITERATIONS = 4
_MAX_SIZE_RATIO = 1.25  # a shape that changes size by more explains something else
_BASELINE_PERCENT = 20.0  # percentile of the frames' costs that counts as a good fit

_DECIMALS = 4  # of the numbers in a hand file


@dataclass(frozen=True)
class CalibrationOptions:
    """Options of a calibration.

    Attributes:
        side: ``right`` or ``left``; None to detect it.
        frames: number of frames in the last round.
        start: first frame.
        places: frames to use, and the wrist (3,) of the hand in each, mm; none to select frames.
    """

    side: str | None = None
    frames: int = 32
    start: int = 0
    places: Sequence[tuple[Frame, FloatArray]] = ()


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a calibration.

    Attributes:
        side: ``right`` or ``left``.
        shape: of the hand.
        measured: its lengths, mm, with standard deviations.
        frames_seen: number of sampled frames.
        frames_used: number of frames the shape was adjusted to.
        residual_mm: weighted root mean square of their residuals.
        costs_mm: median costs of the first round's frames for the average hand of the start size, and for the
            adjusted hand.
        baseline_cost_mm: cost of good fits of the last round's hand.
        begun_scale, begun_mm: scale and length of the start shape.
        covariance: (S, S) of the shape's parameters.
        unit_mm: millimetres per stored unit of depth.
        unlikeliness: of the shape among people, nats: half its squared distance from the mean, in sd.
        frame_costs: costs of the last round's hand by frame index, mm, of frames that show it.
    """

    side: str
    shape: HandShape
    measured: Measured
    frames_seen: int
    frames_used: int
    residual_mm: float
    costs_mm: tuple[float, float]
    baseline_cost_mm: float
    begun_scale: float
    begun_mm: float
    covariance: FloatArray
    unit_mm: float = 1.0
    unlikeliness: float = 0.0
    frame_costs: Mapping[int, float] = field(default_factory=dict)

    @property
    def length_mm(self) -> float:
        """Return the length from the wrist to the middle finger's tip."""
        return self.measured.values["hand_length"]

    @property
    def is_of_another_size(self) -> bool:
        """Return whether the hand is much larger or smaller than the start shape."""
        return not 1.0 / _MAX_SIZE_RATIO < self.length_mm / self.begun_mm < _MAX_SIZE_RATIO

    @property
    def likely_scale(self) -> float:
        """Return the scale that gives the start shape the same length."""
        return self.begun_scale * self.length_mm / self.begun_mm

    @property
    def warning(self) -> str:
        """Return a clause to append to a line about the hand; empty if its shape is plausible."""
        if implausible := length_warning(self.length_mm, self.unit_mm):
            return implausible
        if max((abs(c) for c in self.shape.coefficients), default=0.0) > LARGEST_COEFFICIENT:
            return ", of unusual proportions; check the fit with posetrack view"
        sd, prior = self.measured.sd, self.measured.prior_sd
        for part, (names, pose) in _PARTS.items():
            if all(sd[name] > UNOBSERVED_SHARE * prior[name] for name in names):
                return f", its {part} hardly visible; record {pose} facing the sensor for a few seconds"
        return ""

    @property
    def settings(self) -> dict[str, object]:
        """Return the shape as keys of the ``[hand]`` table."""
        return _shape_settings(self.shape)


def shape_of(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration:
    """Estimate the shape of a hand whose side and approximate size are configured.

    Raises:
        RecordingError: no frame, or no hand found in four frames (or all of fewer).
    """
    calibrator = _Calibrator(recording, config, options)
    side, shape, found = config.hand.side, HandShape(config.hand.scale), None
    known: dict[int, FloatArray] = {}
    medians: list[float] = []  # of the first frames, for the shape before each adjustment
    while len(medians) < ROUNDS or (len(medians) < MAX_ROUNDS and medians[-1] >= medians[0]):
        round_name = f"round {len(medians) + 1} of {ROUNDS}" if len(medians) < ROUNDS else "extra round"
        most = options.frames if medians else FIRST_FRAMES
        poses, thumbs, costs = calibrator.find(shape, most, round_name, known)
        chosen = calibrator.chosen(costs)
        medians.append(float(np.median(costs[:FIRST_FRAMES])))
        found = calibrator.adjust(chosen, poses[chosen], thumbs[chosen], shape)
        shape, known = found.shape, dict(zip(chosen.tolist(), found.poses, strict=True))
    if medians[-1] >= medians[0]:  # the last median is of the shape before the last adjustment
        medians.append(float(np.median(calibrator.find(shape, FIRST_FRAMES, "final shape", known)[2])))
    assert found is not None
    numbers = measured(calibrator.maker, calibrator.space, side, shape, found.covariance)
    cost, good = (medians[0], medians[-1]), baseline_cost(costs)
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
        found.covariance,
        unit_mm_of(recording.pixels[0]),
        0.5 * float(np.square(calibrator.space.theta(shape) / calibrator.space.sd).sum()),
        calibrator.costs_by_index(costs),
    )


def combined(first: Calibration, second: Calibration, mesh: str | None) -> Calibration:
    """Return the shape that both hands of a person share, the second mirrored; of the first one's side.

    The product of both posteriors over their common prior N(0, diag sd^2): with information L_k = C_k^-1, L =
    L_1 + L_2 - diag sd^-2 and theta = L^-1 (L_1 theta_1 + L_2 theta_2).

    Args:
        first, second: calibrations of the hands.
        mesh: file of the hand; None for the average hand.
    """
    maker, space = hand_maker(mesh), shape_space(mesh)
    both = (first, second)
    information = [np.linalg.inv(one.covariance) for one in both]
    covariance = np.linalg.inv(sum(information) - np.diag(space.sd**-2))
    weighted = sum(L @ space.theta(one.shape) for L, one in zip(information, both, strict=True))
    theta = np.clip(covariance @ weighted, space.low, space.high)
    shape = space.shape(theta)
    return replace(
        first,
        shape=shape,
        measured=measured(maker, space, first.side, shape, covariance),
        frames_used=first.frames_used + second.frames_used,
        baseline_cost_mm=min(one.baseline_cost_mm for one in both),
        covariance=covariance,
    )


def baseline_cost(costs: FloatArray) -> float:
    """Return the cost of good fits among costs (F,), which are infinite for frames without a hand."""
    return float(np.percentile(costs, _BASELINE_PERCENT, method="lower"))


_NEAR_WRIST_MM = 130.0
"""Distance of a detected palm from the wrist of a hand at the same place."""


def _is_near(detection: Detection, wrist: FloatArray) -> bool:
    return bool(np.linalg.norm(detection.palm - wrist) < _NEAR_WRIST_MM)


class _Calibrator:
    """Steps of a calibration."""

    def __init__(self, recording: Recording, config: HandConfig, options: CalibrationOptions) -> None:
        self._recording, self._config, self._options = recording, config, options
        self._side, self._camera = config.hand.side, recording.cameras[0]
        self.maker, self.space = hand_maker(config.hand.mesh), shape_space(config.hand.mesh)
        self._detections: dict[int, list[Detection]] = {}  # by frame index
        finder = self._finder(HandShape(config.hand.scale))
        if options.places:
            self.seen, self._frames = len(options.places), [frame for frame, _ in options.places]
            for frame, wrist in options.places:
                near = [one for one in finder.detect(frame.depth) if _is_near(one, wrist)]
                self._detections[frame.index] = near
            return
        shown = self._select_frames(finder)
        self.seen, self._frames = shown.seen, shown.frames
        self._detections = {frame.index: self._detections[frame.index] for frame in self._frames}

    def _select_frames(self, finder: Acquisition) -> FrameSelector:
        """Select the frames with the most visible fingers, the first round's first.

        Raises:
            RecordingError: the recording has no frame.
        """
        options, count = self._options, self._recording.frame_count
        ahead = _ASSUMED_FRAMES if count is None else count - options.start
        stride = max(1, ahead // SAMPLED_FRAMES)
        shown = FrameSelector(options.frames, -(-ahead // stride))
        with phase("selecting frames", "frame", -(-ahead // stride)) as advance:
            for frame in self._recording.frames(start=options.start, end=None, stride=stride):
                found = self._detections[frame.index] = finder.detect(frame.depth)
                shown.add(frame, max((place.fingers_mm2 for place in found), default=0.0))
                advance(1)
        if not shown.seen:
            raise RecordingError("recording has no frame", where=self._recording.path)
        return shown

    def _finder(self, shape: HandShape) -> Acquisition:
        return Acquisition(quick_search(self._config), self.maker(self._side, shape), self._camera)

    def find(
        self, shape: HandShape, most: int, round_name: str, known: Mapping[int, FloatArray]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return poses (F, 22), thumb inner angles (F, 2) and costs (F,), mm, of the hand in each frame.

        A cost is infinite without a hand.

        Args:
            shape: of the hand.
            most: number of frames, the first round's first.
            round_name: for the progress bar.
            known: poses (22,) of the hand, by frame; other frames are searched.
        """
        finder, frames = self._finder(shape), self._frames[:most]
        poses, costs = np.zeros((len(frames), POSE_SIZE)), np.full(len(frames), np.inf)
        poses[:, 6], thumbs = 1.0, np.zeros((len(frames), len(NO_THUMB)))
        with phase(f"finding the {self._side} hand, {round_name}", "frame", len(frames)) as advance:
            for k in range(len(frames)):
                depth = frames[k].depth
                if k in known:
                    found = finder.refit(depth, known[k])
                else:
                    found = finder.best_at(depth, self._detections[frames[k].index])
                if found is not None:
                    poses[k], costs[k] = inside_limits(found.pose[None])[0], found.cost
                    thumbs[k] = found.inner[THUMB]
                advance(1)
        return poses, thumbs, costs

    def costs_by_index(self, costs: FloatArray) -> dict[int, float]:
        """Return the finite ones of the costs (F,) of the first frames, by frame index."""
        return {
            frame.index: cost
            for frame, cost in zip(self._frames, costs.tolist(), strict=False)
            if np.isfinite(cost)
        }

    def chosen(self, costs: FloatArray) -> IntArray:
        """Return the indices of well-fitted frames.

        Raises:
            RecordingError: too few of them.
        """
        limit = (
            _MAX_COST_RATIO * float(np.median(costs[np.isfinite(costs)])) if np.isfinite(costs).any() else 0.0
        )
        good = np.flatnonzero(costs <= limit)
        least = min(_MIN_FRAMES, len(self._frames))
        if good.size < least:
            raise RecordingError(
                "no trackable hand",
                where=self._recording.path,
                found=f"{good.size} of {len(costs)} frames",
                expected=f"{least} or more",
                hint="use a recording of one clearly visible hand, open and with its fingers bent",
            )
        return good

    def adjust(self, chosen: IntArray, poses: FloatArray, thumbs: FloatArray, shape: HandShape) -> Bundle:
        """Adjust shape and poses to the frames."""
        with phase(f"adjusting the shape to {len(chosen)} frames", "view") as advance:
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
    """Return the residual weights with the configured clamp."""
    return Terms()._replace(
        clamp_mm=config.observation.clamp_mm, unread_weight=config.observation.unread_weight
    )


def write_hand_file(path: Path, calibration: Calibration, mesh: str | None, source: str) -> None:
    """Write a TOML file for ``--shape`` and ``--config``.

    Args:
        path: output file.
        calibration: side and shape.
        mesh: GLB file of the hand, None for the average hand.
        source: name of the recording, for the comment.

    Raises:
        ResultError: the file cannot be written.
    """
    with whole_or_nothing(path) as part:
        write_output(part, hand_text(calibration, mesh, source, path.parent).encode())


def hand_text(calibration: Calibration, mesh: str | None, source: str, folder: Path) -> str:
    """Return the content of a hand file; a mesh inside its folder gets a relative path."""
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
