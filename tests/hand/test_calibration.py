"""A hand's shape from a recording: derivatives, the adjustment's algebra, and hands that are found again."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.configuration import load_settings
from posetrack_cli.errors import RecordingError
from posetrack_cli.hand import shape_bundle
from posetrack_cli.hand.autodetect import FRAME_STRIDE, SIDES, SideAndScaleSearch, calibrate, search_recording
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.fitter import nearest_pixels
from posetrack_cli.hand.fit.skeleton import NO_THUMB
from posetrack_cli.hand.fit.terms import Terms, Tile
from posetrack_cli.hand.model.anatomy import (
    HAND_LENGTH_MM,
    POPULATION_SD,
    SHAPE_NAMES,
    FactorSpace,
    HandAnatomy,
    HandShape,
    PopulationSpace,
    make_anatomy,
    random_shape,
)
from posetrack_cli.hand.model.hand import HandModel, average_hand
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.search import Acquisition
from posetrack_cli.hand.shape_bundle import (
    FRAME_SIZE,
    FRAME_STEPS,
    MIN_SHARE,
    WRIST_PART,
    FrameRows,
    vertex_moves,
    wrist_shares,
)
from posetrack_cli.hand.shape_fit import (
    FIRST_FRAMES,
    MAX_ROUNDS,
    MEASURES,
    ROUNDS,
    SAMPLED_FRAMES,
    Calibration,
    CalibrationOptions,
    _Calibrator,
    baseline_cost,
    hand_text,
    measured,
    measures_of,
    shape_of,
    write_hand_file,
)
from posetrack_cli.hand.start import rest_pose
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.port import RenderingDevice, Window
from posetrack_cli.rendering.raster import View
from posetrack_cli.synthesis.hand.frames import write_synthetic
from posetrack_cli.synthesis.hand.options import SynthOptions, hand_of_seed
from posetrack_cli.synthesis.hand.shapes import SHAPES
from posetrack_cli.tracking.velocity import BodySpace
from support.calibrations import calibration_of
from support.hand import KINECT

TILE = 96
HALF_A_STEP = 0.077  # 1.16^(1/2) - 1, of the sizes that are tried
MOST_OFF_MM = 7.5
"""A length of a hand of which nine perfect images are given: where in it a knuckle lies they hardly tell."""
FEW = {"fitted": 16, "refined": 2, "scattered": 4}
"""Hypotheses of a search; ten hands are searched for, and the one hand in the image is easily found."""
SPACE = PopulationSpace()
SIZE = len(SPACE.names)
OTHER = random_shape(np.random.default_rng(11))


def poses_of(hand: HandModel, count: int) -> FloatArray:
    """Gestures, seen from the front and turned to both sides."""
    names = list(SHAPES)
    poses = np.tile(rest_pose(hand.anatomy, np.array([0.0, 0.0, 600.0])), (count, 1))
    turns = np.zeros((count, 21))
    turns[:, 4] = [(-0.7, 0.0, 0.7)[k % 3] for k in range(count)]
    poses = BodySpace().retract(poses, turns)
    poses[:, 7:] = [SHAPES[names[k % len(names)]] for k in range(count)]
    return poses


class Views:
    """Tiles of a hand in poses, as a perfect sensor sees it before an empty wall."""

    def __init__(
        self, device: RenderingDevice, hand: HandModel, poses: FloatArray, thumbs: FloatArray = NO_THUMB
    ) -> None:
        self.window = Window.around(np.array([KINECT.cx, KINECT.cy]), TILE, 2)
        renderer = device.depth_renderer(hand.smooth, (TILE, TILE), 1)
        view = View(*self.window.tile_projection(KINECT))
        self.tiles = []
        for transforms in skinning_transforms(hand.anatomy, poses, thumbs):
            drawn = renderer.depth(transforms[None], KINECT, self.window)[0]
            image = np.where(drawn > 0, drawn, -2000.0).astype(np.float64)
            self.tiles.append(Tile(image, nearest_pixels(image > 0), int((image > 0).sum()), view))

    def __call__(self, frame: int, pose: FloatArray, thumb: FloatArray, hand: HandModel) -> Tile:
        return self.tiles[frame]


def varied(shape: HandShape) -> list[HandModel]:
    theta = SPACE.theta(shape)
    return [average_hand("right", SPACE.shape(theta + step)) for step in np.diag(SPACE.steps)]


def moves_of(pose: FloatArray, hand: HandModel, shape: HandShape, thumb: FloatArray = NO_THUMB) -> FloatArray:
    return next(vertex_moves(pose[None], thumb[None], hand, varied(shape), SPACE.steps))


def test_moves_are_those_of_the_vertices() -> None:
    hand = average_hand("right", OTHER)
    pose = poses_of(hand, 3)[2]
    thumb = np.array([0.3, -0.2])
    moves = moves_of(pose, hand, OTHER, thumb)
    rng = np.random.default_rng(3)
    delta = np.concatenate([FRAME_STEPS, SPACE.steps]) * rng.uniform(-1, 1, FRAME_SIZE + SIZE)
    there = average_hand("right", SPACE.shape(SPACE.theta(OTHER) + delta[FRAME_SIZE:]))
    moved = BodySpace().retract(pose[None], delta[None, :21])
    posed = [
        model.smooth.posed(skinning_transforms(model.anatomy, p, angles).astype(np.float64))[0]
        for model, p, angles in ((hand, pose[None], thumb), (there, moved, thumb + delta[21:FRAME_SIZE]))
    ]
    found = np.einsum("vkc,k->vc", moves, delta)
    second_order_mm = 0.15  # steps of 1 % and 5 mrad at 200 mm, squared, and float32 transforms
    assert np.abs(found - (posed[1] - posed[0])).max() < second_order_mm
    assert np.abs(posed[1] - posed[0]).max() > 10 * second_order_mm


def test_surface_rows_predict_how_residuals_change(device: RenderingDevice) -> None:
    hand = average_hand("right", OTHER)
    pose = poses_of(hand, 1)[0]
    tile = Views(device, hand, pose[None]).tiles[0]
    rows, moves = FrameRows(Terms(), TILE), moves_of(pose, hand, OTHER)
    at = rows.rows(tile, pose, NO_THUMB, hand, moves)
    # at the truth: no residual but for what a rasteriser decides at edges
    weighted = float((at.weights * at.residuals**2).sum() / at.weights.sum())
    assert np.sqrt(weighted) < 0.3
    # off the truth along the optical axis the residuals are that offset, and one step takes it back
    off = BodySpace().retract(pose[None], np.eye(21)[2:3] * 4.0)[0]
    moves = moves_of(off, hand, OTHER)
    matrix, vector = rows.rows(tile, off, NO_THUMB, hand, moves).normal(1.0)
    ridge = np.diag(np.concatenate([np.full(3, 1e-3), np.full(FRAME_SIZE - 3, 1e3), np.full(SIZE, 1e6)]))
    step = np.linalg.solve(matrix + ridge, vector)
    assert step[2] == pytest.approx(-4.0, abs=0.6)


class Padded(PopulationSpace):
    """Hands whose skin stands out by no less than so many mm."""

    low = np.append(PopulationSpace.low[:-1], 2.0)


class AllPadded(PopulationSpace):
    """Hands whose skin stands out by just as much."""

    names = PopulationSpace.names[:-1]
    sd, low, high, steps = (
        values[:-1]
        for values in (PopulationSpace.sd, PopulationSpace.low, PopulationSpace.high, PopulationSpace.steps)
    )

    def shape(self, theta: FloatArray) -> HandShape:
        return super().shape(np.append(theta, Padded.low[-1]))

    def theta(self, shape: HandShape) -> FloatArray:
        return super().theta(shape)[:-1]


def test_a_number_at_its_bound_is_as_if_it_were_known(device: RenderingDevice) -> None:
    """Images of a hand whose skin does not stand out: its poses are the likeliest for the skin that is drawn.

    They once were those for the skin that the images ask for, which lies farther in, at every step anew. Four
    steps show that (4 mm); eight, which do not converge, carry the rounding of two solvers to 1e-5 on some
    processors, four to 1e-11.
    """
    hand = average_hand("right", OTHER)
    poses = poses_of(hand, 6)
    views = Views(device, hand, poses)
    begun, thumbs = started(poses, seed=1), np.zeros((6, 2))
    start = HandShape(padding_mm=float(Padded.low[-1]))
    bounded, known = (
        shape_bundle.adjusted(average_hand, space, "right", start, begun, thumbs, views, TILE, iterations=4)
        for space in (Padded(), AllPadded())
    )
    assert bounded.shape.padding_mm == Padded.low[-1]
    np.testing.assert_allclose(bounded.shape.coefficients, known.shape.coefficients, atol=1e-6)
    np.testing.assert_allclose(bounded.poses, known.poses, atol=1e-6)


def started(poses: FloatArray, seed: int) -> FloatArray:
    """The poses as a search may find them."""
    noise = np.random.default_rng(seed).standard_normal((len(poses), 21))
    return BodySpace().retract(poses, noise * np.repeat([4.0, 0.04, 0.08], [3, 3, 15]))


def test_a_hand_of_the_population_is_found_again_from_perfect_images(device: RenderingDevice) -> None:
    """Its lengths in a few millimetres, and no farther off than is stated."""
    hand = average_hand("right", OTHER)
    poses = poses_of(hand, 9)
    true_thumbs = 0.15 * np.random.default_rng(5).standard_normal((9, 2))
    views = Views(device, hand, poses, true_thumbs)
    begun, thumbs = started(poses, seed=1), np.zeros((9, 2))
    found = shape_bundle.adjusted(
        average_hand, SPACE, "right", HandShape(), begun, thumbs, views, TILE, iterations=20
    )
    numbers = measured(average_hand, SPACE, "right", found.shape, found.covariance)
    average, true, got = (
        measures_of(average_hand("right", shape).anatomy) for shape in (HandShape(), OTHER, found.shape)
    )
    lengths = slice(0, MEASURES.index("thumb_radius"))
    before, after = (np.abs(other - true)[lengths].max() for other in (average, got))
    assert before > MOST_OFF_MM + 3.0 and after < MOST_OFF_MM
    assert numbers.values["padding"] == found.shape.padding_mm < 0.5  # perfect images smear nothing
    in_sd = (got - true) / [numbers.sd[name] for name in MEASURES]
    assert np.sqrt((in_sd**2).mean()) < 2.0 and np.abs(in_sd).max() < 4.0
    made = average_hand("right", found.shape)
    joints = [
        joint_positions(model.anatomy, p, angles)
        for model, p, angles in ((made, found.poses, found.thumbs), (hand, poses, true_thumbs))
    ]
    assert np.median(np.linalg.norm(joints[0] - joints[1], axis=2)) < 4.0
    # never less sure than before, of the scale and of the strongest modes far surer, though the thumb's inner
    # angles leave more open than a thumb without them
    sd = np.sqrt(np.diag(found.covariance))
    assert (sd < SPACE.sd + 1e-12).all() and (sd[:3] < 0.55 * SPACE.sd[:3]).all()


def test_a_file_s_hand_is_found_again_by_its_factors(device: RenderingDevice) -> None:
    shape = HandShape(
        1.08, (1.0, 1.08, 0.95, 1.0, 1.05), (1.05, 0.95, 1.0, 1.05, 1.0), 1.05, 1.03, 0.95, 0.95, 1.1
    )
    hand = average_hand("right", shape)
    poses = poses_of(hand, 6)
    views = Views(device, hand, poses)
    begun, thumbs = started(poses, seed=1), np.zeros((6, 2))
    found = shape_bundle.adjusted(
        average_hand, FactorSpace(), "right", HandShape(), begun, thumbs, views, TILE, iterations=15
    )
    hands = [average_hand("right", shape) for shape in (HandShape(), found.shape)]
    before, after = (np.abs(model.anatomy.segments - hand.anatomy.segments).max() for model in hands)
    assert before > 4.0 and after < before / 3.0  # mm; the prior holds what the images leave open
    sd = np.sqrt(np.diag(found.covariance))
    assert not found.shape.coefficients
    assert (sd < POPULATION_SD + 1e-12).all() and sd[0] < 0.5 * POPULATION_SD[0]


def test_without_images_the_population_is_the_answer() -> None:
    theta = SPACE.sd * np.linspace(-1.0, 1.0, SIZE)
    matrix, vector = shape_bundle._shape_equations([], np.diag(1.0 / SPACE.sd**2), theta)
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(matrix))), SPACE.sd)
    np.testing.assert_allclose(np.linalg.solve(matrix, vector), -theta)


# What is measured


def test_measures_are_what_a_ruler_says() -> None:
    anatomy = average_hand("left", HandShape(1.1)).anatomy
    numbers = dict(zip(MEASURES, measures_of(anatomy), strict=True))
    pose = np.concatenate([np.zeros(6), [1.0], np.zeros(15)])
    joints = joint_positions(anatomy, pose[None])[0]
    chains = np.linalg.norm(np.diff(joints[1:].reshape(5, 4, 3), axis=1), axis=2)
    palm = float(np.linalg.norm(joints[9] - joints[0]))
    assert numbers["palm_length"] == pytest.approx(palm)
    assert numbers["hand_length"] == pytest.approx(palm + chains[2].sum())
    assert numbers["hand_length"] == pytest.approx(1.1 * HAND_LENGTH_MM, abs=0.5)
    assert numbers["palm_width"] == pytest.approx(float(np.linalg.norm(joints[5] - joints[17])))
    assert numbers["little_length"] == pytest.approx(chains[4].sum())
    assert numbers["thumb_length"] == pytest.approx(chains[0, 1:].sum())


def test_deviations_of_measures_are_those_of_hands() -> None:
    """The prior's, to first order, against hands drawn from it."""
    numbers = measured(average_hand, SPACE, "right", HandShape(), np.diag((0.5 * SPACE.sd) ** 2))
    rng = np.random.default_rng(0)
    drawn = [make_drawn(SPACE.sd * rng.standard_normal(SIZE)) for _ in range(400)]
    spread = dict(zip(MEASURES, np.std(drawn, axis=0), strict=True))
    for name in MEASURES:
        # a standard deviation of 400 is known to 1 / sqrt(800), four of these; a scale's square adds a little
        assert numbers.prior_sd[name] == pytest.approx(spread[name], rel=0.15 + 0.02)
        assert numbers.sd[name] == pytest.approx(0.5 * numbers.prior_sd[name])


def make_drawn(theta: FloatArray) -> FloatArray:
    shape = SPACE.shape(theta)
    return measures_of(make_anatomy("right", shape.scale, coefficients=shape.coefficients))


# Which frames


class Shown:
    """A recording of frames of which each is told how much of fingers it shows."""

    path, cameras, pixels = Path("shown.mcap"), (KINECT,), (None,)

    def __init__(self, areas: Sequence[float], counted: bool = True) -> None:
        self._areas, self.frame_count = areas, len(areas) if counted else None

    def frames(self, start: int, end: int | None, stride: int) -> Iterator[Frame]:
        for k in range(start, len(self._areas) if end is None else min(end, len(self._areas)), stride):
            yield Frame(k, k, (np.full((1, 1), k, np.float32),))

    def detected(self, depth: ImageArray) -> list[SimpleNamespace]:
        area = self._areas[int(depth[0, 0])]
        return [SimpleNamespace(fingers_mm2=part) for part in (0.3 * area, area) if area > 0.0]


def chosen_of(
    recording: Shown, options: CalibrationOptions, monkeypatch: pytest.MonkeyPatch
) -> tuple[list[int], int]:
    """The frames that a shape is estimated from, and how many were looked at."""
    monkeypatch.setattr(Acquisition, "detect", lambda finder, depth: recording.detected(depth))
    calibrator = _Calibrator(recording, HandConfig(), options)  # type: ignore[arg-type]
    return [frame.index for frame in calibrator._frames], calibrator.seen


def test_frames_that_show_most_of_fingers_are_chosen_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    areas = np.zeros(40)
    areas[[3, 30, 12, 25]] = [500.0, 900.0, 700.0, 600.0]
    options = CalibrationOptions("right", frames=3)
    assert chosen_of(Shown(areas), options, monkeypatch) == ([12, 25, 30], 40)
    later = CalibrationOptions("right", frames=3, start=13)
    assert chosen_of(Shown(areas), later, monkeypatch) == ([13, 25, 30], 27)  # of equal ones the first


def test_frames_of_the_first_round_come_from_all_parts_and_before_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both rounds are in the recording's order."""
    count = 3 * FIRST_FRAMES
    shown = Shown(np.arange(float(count)) + 1.0)  # later frames show more
    frames, _ = chosen_of(shown, CalibrationOptions("right", frames=FIRST_FRAMES + 4), monkeypatch)
    last_of_each_part = [*range(2, count, 3)]
    assert frames == [*last_of_each_part, count - 6, count - 5, count - 3, count - 2]


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_a_recording_is_looked_at_evenly_all_over(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    frames, seen = chosen_of(Shown(np.ones(count)), CalibrationOptions("right", frames=200), monkeypatch)
    frames = sorted(frames)
    assert frames[0] == 0 and len(set(np.diff(frames))) == 1
    assert min(count, SAMPLED_FRAMES) <= seen == len(frames) < 2 * SAMPLED_FRAMES + 1
    assert count - frames[-1] <= np.diff(frames)[0]


def test_frames_that_nobody_counted_are_looked_at_alike_from_any_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    apart = []
    for start in (0, 1000):
        shown = Shown(np.ones(start + 200), counted=False)
        frames, _ = chosen_of(shown, CalibrationOptions("right", start=start), monkeypatch)
        assert frames[0] == start
        apart.append(set(np.diff(frames)))
    assert apart[0] == apart[1] and len(apart[0]) == 1


def test_frames_that_fit_badly_are_left_out_and_too_few_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Acquisition, "detect", lambda finder, depth: [])
    shown, options = Shown(np.ones(9)), CalibrationOptions("right")
    calibrator = _Calibrator(shown, HandConfig(), options)  # type: ignore[arg-type]
    costs = np.array([2.0, 1.0, 2.2, 9.0, np.inf, 2.1, 2.3, 3.0, 1.5])
    assert calibrator.chosen(costs).tolist() == [0, 1, 2, 5, 6, 8]  # median 2.15
    for costs in (np.full(9, np.inf), np.where(np.arange(9) < 3, 2.0, np.inf)):
        with pytest.raises(RecordingError, match=r"shown\.mcap: no trackable hand, found \d of 9"):
            calibrator.chosen(costs)


def test_a_recording_without_frames_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RecordingError, match=r"shown\.mcap: recording has no frame"):
        chosen_of(Shown([]), CalibrationOptions("right"), monkeypatch)


@pytest.mark.parametrize(
    ("medians", "rounds"),
    [
        ((5.0, 4.0), ROUNDS),
        ((5.9, 6.0, 3.4), MAX_ROUNDS),
        ((3.46, 3.64, 3.53, 3.36), MAX_ROUNDS),
        ((5.0, 5.0, 6.0, 5.5), MAX_ROUNDS),
    ],
    ids=["better", "worse and then better", "better at last, as person 732", "never better"],
)
def test_a_hand_that_fits_no_better_is_adjusted_once_more(
    monkeypatch: pytest.MonkeyPatch, medians: tuple[float, ...], rounds: int
) -> None:
    """Each round finds the hand that the one before adjusted; the last adjustment is what is believed.

    It is not given up for what the shape before it costs: what the last one gave is found, too.
    The first round looks at few frames, and rounds are compared by these alone.
    """
    monkeypatch.setattr(Acquisition, "detect", lambda finder, depth: [])
    found_with: list[float] = []
    searched: list[int] = []

    told: list[str] = []

    def find(
        calibrator: _Calibrator, shape: HandShape, most: int, again: str, known: dict[int, FloatArray]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        assert bool(known) == bool(found_with)
        found_with.append(shape.scale)
        searched.append(most)
        told.append(again)
        costs = np.full(most, medians[len(found_with) - 1])
        costs[FIRST_FRAMES:] = 1.0
        return np.zeros((most, 22)), np.zeros((most, 2)), costs

    def adjust(
        calibrator: _Calibrator, chosen: object, poses: FloatArray, thumbs: object, shape: HandShape
    ) -> shape_bundle.Bundle:
        covariance = np.diag(PopulationSpace.sd**2)
        nothing = np.zeros(0)
        larger = replace(shape, scale=shape.scale + 0.1)
        return shape_bundle.Bundle(larger, poses, nothing, covariance, 2.0, 3)

    monkeypatch.setattr(_Calibrator, "find", find)
    monkeypatch.setattr(_Calibrator, "adjust", adjust)
    config = load_settings(HandConfig, None, {"hand.side": "right"})
    options = CalibrationOptions("right", frames=2 * FIRST_FRAMES)
    found = shape_of(Shown(np.ones(40)), config, options)  # type: ignore[arg-type]
    np.testing.assert_allclose(found_with, 1.0 + 0.1 * np.arange(len(medians)))
    judged = [FIRST_FRAMES] * (len(medians) - rounds)
    assert searched == [FIRST_FRAMES] + [2 * FIRST_FRAMES] * (rounds - 1) + judged
    assert found.shape.scale == pytest.approx(1.0 + 0.1 * rounds)
    assert found.costs_mm == (medians[0], medians[-1])
    assert len(told) == len(medians)
    assert ("extra round" in told) == (rounds == MAX_ROUNDS)


# Side and size, of all that there is


def trial_of(
    shown: Shown,
    monkeypatch: pytest.MonkeyPatch,
    length: float = 0.86,
    others: Callable[[int, HandAnatomy], float] = lambda index, anatomy: 0.0,
) -> SideAndScaleSearch:
    """What a right hand of a size tells that no hand explains well, and a left one less.

    Frames may add to the cost of a hand.
    """

    def appraise(
        finder: Acquisition, depth: ImageArray, places: list[object], told: object, below_mm: float
    ) -> object:
        anatomy = finder.observer.anatomy
        more = others(int(depth[0, 0]), anatomy)
        return 5.0 + anatomy.is_left + 20.0 * abs(np.log(anatomy.scale / length)) + more, places

    monkeypatch.setattr(Acquisition, "detect", lambda finder, depth, **_: shown.detected(depth))
    monkeypatch.setattr(Acquisition, "appraise", appraise)
    config = HandConfig.model_validate({"init": {"shape": "given"}, "filter": {"kind": "pso"}})
    return search_recording(shown, config, 0, SIDES)  # type: ignore[arg-type]


def test_of_a_few_images_all_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those after some that show no hand; sizes are tried however a run is configured."""
    trial = trial_of(Shown([0.0, 0.0, *[900.0] * 6]), monkeypatch)
    assert (
        trial.frame_count == 4
    )  # 1 mm each, of which 0.9 are a unit of log odds, and four of these are asked for
    assert trial.side == "right" and trial.is_sure_of_side
    assert trial.scale("right") == pytest.approx(0.86, rel=HALF_A_STEP)


@pytest.mark.parametrize(
    "others",
    [
        pytest.param(lambda index, anatomy: 9.0 * (index == 2 and not anatomy.is_left), id="side"),
        pytest.param(lambda index, anatomy: 14.0 * (index == 2 and anatomy.scale < 0.9), id="size"),
    ],
)
def test_one_frame_that_contradicts_the_others_leaves_the_size(
    monkeypatch: pytest.MonkeyPatch, others: Callable[[int, HandAnatomy], float]
) -> None:
    """There the other side fits so much better that only it is tried in other sizes; or another size does."""
    trial = trial_of(Shown([900.0] * 16), monkeypatch, 0.743, others)
    assert trial.frame_count > 3
    assert trial.scale("right") == pytest.approx(0.743, rel=HALF_A_STEP)


@pytest.mark.parametrize("counted", [True, False])
def test_a_hand_that_shows_itself_late_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, *, counted: bool
) -> None:
    late = [0.0] * (30 * FRAME_STRIDE)
    assert trial_of(Shown([*late, *[900.0] * (4 * FRAME_STRIDE)], counted), monkeypatch).frame_count == 4


def test_where_no_hand_is_seen_it_is_of_the_size_that_is_configured(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = trial_of(Shown([0.0] * 9), monkeypatch)
    assert trial.frame_count == 0 and trial.scale("right") == 1.0


# From end to end


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A left hand of the population, as a Kinect sees it, at four times the usual speed."""
    path = tmp_path_factory.mktemp("calibration") / "other.mcap"
    write_synthetic(SynthOptions(frames=12, seed=9, side="left", speed=4.0, **asdict(hand_of_seed(9))), path)
    return path


@pytest.fixture(scope="module")
def calibration(recording: Path) -> Calibration:
    config = HandConfig.model_validate({"acquisition": FEW})
    return calibrate(open_recording(recording), config, CalibrationOptions(frames=8))


def test_side_size_and_proportions_are_found_without_truth(recording: Path, calibration: Calibration) -> None:
    true, found = hand_of_seed(9), calibration.shape
    assert calibration.side == "left"
    hands = [average_hand("left", shape).anatomy for shape in (true, found, HandShape())]
    lengths = [np.concatenate([a.segments.ravel(), np.linalg.norm(a.base_positions, axis=1)]) for a in hands]
    off = [np.sqrt(np.mean((values - lengths[0]) ** 2)) for values in lengths[1:]]
    assert off[1] > 3.0  # mm, of the average hand
    assert off[0] < 0.6 * off[1]
    stamps = [frame.stamp_ns for frame in open_recording(recording).frames()]
    assert calibration.frames_seen == len(stamps)
    assert 4 <= calibration.frames_used <= 8
    before, after = calibration.costs_mm
    assert after < before
    assert 0.0 < calibration.baseline_cost_mm <= after
    assert calibration.length_mm == calibration.measured.values["hand_length"]


class Altered:
    """A recording as a sensor would have taken it that smears edges, or tells another unit than mm."""

    def __init__(self, recording: Recording, smeared_px: int = 0, unit: float = 1.0) -> None:
        self._recording, self._unit = recording, unit
        self._around = np.ones((2 * smeared_px + 1,) * 2, np.uint8)
        self.path, self.cameras, self.pixels = recording.path, recording.cameras, recording.pixels
        self.frame_count = recording.frame_count

    def frames(self, **chosen: int | None) -> Iterator[Frame]:
        for frame in self._recording.frames(**chosen):  # type: ignore[arg-type]
            far = np.where(frame.depth > 0.0, frame.depth, np.float32(1e6))
            nearest = cv2.erode(far, self._around)
            depth = np.where(nearest < 1e6, self._unit * nearest, 0.0).astype(np.float32)
            yield replace(frame, images=(depth,))


def calibrated_on(altered: Altered) -> Calibration:
    """With the whole search: with fewer hypotheses last bits decide whether a size is 0.3 or 5.2 % off."""
    return calibrate(altered, HandConfig(), CalibrationOptions("left", frames=12))  # type: ignore[arg-type]


TRUE_LENGTH_MM = float(measures_of(average_hand("left", hand_of_seed(9)).anatomy)[0])
LENGTH_ERROR = 0.05
"""Of a hand's length: twelve frames tell it with a standard deviation of 3 to 6 per cent."""


def test_a_sensor_that_smears_edges_makes_no_hand_larger(recording: Path, calibration: Calibration) -> None:
    """Two pixels of 1.6 to 2 mm on each side are the skin's padding; unsmeared there is next to none."""
    smeared = calibrated_on(Altered(open_recording(recording), smeared_px=2))
    assert calibration.shape.padding_mm < 1.0
    assert 2.5 < smeared.shape.padding_mm < 7.0
    assert smeared.measured.values["padding"] == smeared.shape.padding_mm
    # two standard deviations: which way it falls within them differs from processor to processor
    assert smeared.length_mm == pytest.approx(TRUE_LENGTH_MM, rel=2.0 * LENGTH_ERROR)


@pytest.mark.parametrize("unit", [0.55, 1.7])
def test_depth_in_another_unit_makes_another_size(recording: Path, unit: float) -> None:
    found = calibrated_on(Altered(open_recording(recording), unit=unit))
    assert found.length_mm == pytest.approx(unit * TRUE_LENGTH_MM, rel=LENGTH_ERROR)


def test_the_file_is_a_configuration(tmp_path: Path) -> None:
    path, calibration = tmp_path / "hand.toml", calibration_of(OTHER, side="left")
    write_hand_file(path, calibration, None, 'a "quoted" name')
    config = load_settings(HandConfig, [path], {})
    assert config.hand.side == "left"
    np.testing.assert_allclose(SPACE.theta(config.hand.shape), SPACE.theta(OTHER), atol=1e-4)
    assert config.filter == HandConfig().filter
    assert config.hand.shape == HandConfig.model_validate({"hand": calibration.settings}).hand.shape


def test_the_file_says_what_was_measured_beside_it() -> None:
    calibration = calibration_of(OTHER)
    text = hand_text(calibration, None, "r.mcap", Path())
    assert text.startswith('# Calibrated from "r.mcap": 9 frames, residual 1.23 mm.\n')
    for name, value in calibration.measured.values.items():
        assert f"# {name.replace('_', ' ')} {value:.1f} +- {calibration.measured.sd[name]:.1f}\n" in text
    assert set(tomllib.loads(text)["hand"]) == {"side", "scale", "coefficients", "padding_mm"}


def test_the_file_names_its_mesh_from_where_it_lies(tmp_path: Path) -> None:
    calibration = calibration_of(HandShape(1.1))
    beside, elsewhere = tmp_path / "a" / "hand.glb", tmp_path / "hand.glb"
    texts = [hand_text(calibration, str(mesh), "r", tmp_path / "a") for mesh in (beside, elsewhere)]
    assert [tomllib.loads(text)["hand"]["mesh"] for text in texts] == ["hand.glb", str(elsewhere.resolve())]


def test_every_factor_of_a_file_s_hand_is_in_the_file(tmp_path: Path) -> None:
    factors = np.linspace(0.9, 1.1, len(SHAPE_NAMES))
    path = tmp_path / "hand.toml"
    write_hand_file(path, calibration_of(HandShape.of_factors(factors)), str(tmp_path / "hand.glb"), "r")
    hand = load_settings(HandConfig, [path], {}).hand
    np.testing.assert_allclose(hand.shape.factors, factors, atol=1e-4)
    assert hand.mesh == str(tmp_path / "hand.glb") and not hand.coefficients


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("missing", [0, 4, 12])
def test_frames_in_which_no_hand_is_found_tell_nothing_of_what_good_fits_cost(missing: int) -> None:
    costs = np.concatenate([np.arange(16.0 - missing), np.full(missing, np.inf)])
    assert baseline_cost(costs[::-1]) == 3.0


@pytest.mark.parametrize(("begun", "another"), [(1.0, False), (0.85, False), (0.75, True), (1.3, True)])
def test_a_size_is_another_one_beside_the_hand_that_it_was_begun_with(begun: float, another: bool) -> None:
    """A quarter more or less, of whatever hand that was: a mesh of any length is of its own size."""
    found = calibration_of(HandShape(1.0), begun_scale=begun)
    assert found.is_of_another_size == another
    assert found.likely_scale == pytest.approx(1.0)
    mesh = replace(found, begun_scale=1.0, begun_mm=found.length_mm)
    assert not mesh.is_of_another_size and mesh.likely_scale == 1.0


def test_a_recording_without_a_hand_is_told(tmp_path: Path) -> None:
    from posetrack_cli.recording.image_files import encode_png

    source = tmp_path / "wall"
    source.mkdir()
    for k in range(6):
        (source / f"{k:06d}.png").write_bytes(encode_png(np.full((424, 512), 2500, np.uint16), 1))
    (source / "camera.toml").write_text("fx = 365.0\nfy = 365.0\ncx = 255.5\ncy = 211.5\n")
    with pytest.raises(RecordingError, match=r"no trackable hand.*0 of 6 frames"):
        calibrate(open_recording(source, fps=30.0), HandConfig(), CalibrationOptions())


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_skin_counts_less_towards_the_wrist_alone(side: str) -> None:
    hand = average_hand(side, OTHER)
    shares, along = wrist_shares(hand), -hand.smooth.vertices[:, 1]
    palm = hand.smooth.weights[:, 0] > 0.5
    knuckles = -hand.anatomy.base_positions[1:, 1].mean()
    end, before = palm & (along <= along.min() + 3.0), along >= WRIST_PART * knuckles
    assert (shares >= MIN_SHARE).all() and (shares[end] < 0.4).all()
    assert before.any() and (shares[before] == 1.0).all() and (shares[~palm] == 1.0).all()
    between = palm & ~before
    order = np.argsort(along[between])
    assert between.any() and (np.diff(shares[between][order]) >= 0.0).all()
