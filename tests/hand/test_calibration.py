"""A hand's shape from a recording: derivatives, the adjustment's algebra, and hands that are found again."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.configuration import load_settings
from posetrack_cli.errors import RecordingError
from posetrack_cli.hand.calibration import bundle
from posetrack_cli.hand.calibration.calibrate import (
    Calibration,
    CalibrationOptions,
    calibrate,
    hand_text,
    spread,
    write_hand_file,
)
from posetrack_cli.hand.calibration.residuals import (
    LEAST_SHARE,
    POSE_STEPS,
    WRIST_PART,
    FrameRows,
    vertex_moves,
    wrist_shares,
)
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fitting.fitter import nearest_pixels
from posetrack_cli.hand.fitting.terms import Terms, Tile
from posetrack_cli.hand.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.model import HandModel, average_hand
from posetrack_cli.hand.shape import POPULATION_SD, SHAPE_NAMES, SHAPE_SIZE, HandShape
from posetrack_cli.hand.space import HandSpace
from posetrack_cli.hand.start import rest_pose
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.rendering.raster import View
from posetrack_cli.rendering.window import Window
from posetrack_cli.synthesis.hand.options import SynthOptions, hand_of_seed
from posetrack_cli.synthesis.hand.shapes import SHAPES
from posetrack_cli.synthesis.hand.writing import write_synthetic
from support.hand import KINECT

TILE = 96
SECONDS = 0.2
"""Of a recording that is a little longer."""
FEW = {"fitted": 16, "refined": 2, "scattered": 4}
"""Hypotheses of a search; ten hands are searched for, and the one hand in the image is easily found."""
OTHER = HandShape(
    1.08, (1.0, 1.08, 0.95, 1.0, 1.05), (1.05, 0.95, 1.0, 1.05, 1.0), 1.05, 1.03, 0.95, 0.95, 1.1
)


def poses_of(hand: HandModel, count: int) -> FloatArray:
    """Gestures, seen from the front and turned to both sides."""
    names = list(SHAPES)
    poses = np.tile(rest_pose(hand.anatomy, np.array([0.0, 0.0, 600.0])), (count, 1))
    turns = np.zeros((count, 21))
    turns[:, 4] = [(-0.7, 0.0, 0.7)[k % 3] for k in range(count)]
    poses = HandSpace().retract(poses, turns)
    poses[:, 7:] = [SHAPES[names[k % len(names)]] for k in range(count)]
    return poses


class Views:
    """Tiles of a hand in poses, as a perfect sensor sees it before an empty wall."""

    def __init__(self, device: RenderingDevice, hand: HandModel, poses: FloatArray) -> None:
        self.window = Window.around(np.array([KINECT.cx, KINECT.cy]), TILE, 2)
        renderer = device.depth_renderer(hand.smooth, (TILE, TILE), 1)
        view = View(*self.window.tile_projection(KINECT))
        self.tiles = []
        for pose in poses:
            drawn = renderer.depth(skinning_transforms(hand.anatomy, pose[None]), KINECT, self.window)[0]
            image = np.where(drawn > 0, drawn, -2000.0).astype(np.float64)
            self.tiles.append(Tile(image, nearest_pixels(image > 0), int((image > 0).sum()), view))

    def __call__(self, frame: int, pose: FloatArray, hand: HandModel) -> Tile:
        return self.tiles[frame]


def varied(shape: HandShape, step: float) -> list[HandModel]:
    theta = np.log(shape.factors)
    return [average_hand("right", HandShape.of_factors(np.exp(theta + step * e))) for e in np.eye(SHAPE_SIZE)]


def test_moves_are_those_of_the_vertices() -> None:
    hand = average_hand("right", OTHER)
    pose = poses_of(hand, 3)[2]
    moves = next(vertex_moves(pose[None], hand, varied(OTHER, 0.01), 0.01))
    rng = np.random.default_rng(3)
    delta = np.concatenate([POSE_STEPS * rng.uniform(-1, 1, 21), 0.01 * rng.uniform(-1, 1, SHAPE_SIZE)])
    there = average_hand("right", HandShape.of_factors(OTHER.factors * np.exp(delta[21:])))
    moved = HandSpace().retract(pose[None], delta[None, :21])
    posed = [
        model.smooth.posed(skinning_transforms(model.anatomy, p).astype(np.float64))[0]
        for model, p in ((hand, pose[None]), (there, moved))
    ]
    found = np.einsum("vkc,k->vc", moves, delta)
    second_order_mm = 0.15  # steps of 1 % and 5 mrad at 200 mm, squared, and float32 transforms
    assert np.abs(found - (posed[1] - posed[0])).max() < second_order_mm
    assert np.abs(posed[1] - posed[0]).max() > 10 * second_order_mm


def test_surface_rows_predict_how_residuals_change(device: RenderingDevice) -> None:
    hand = average_hand("right", OTHER)
    pose = poses_of(hand, 1)[0]
    tile = Views(device, hand, pose[None]).tiles[0]
    rows, moves = FrameRows(Terms(), TILE), next(vertex_moves(pose[None], hand, varied(OTHER, 0.01), 0.01))
    at = rows.rows(tile, pose, hand, moves)
    # at the truth: no residual but for what a rasteriser decides at edges
    weighted = float((at.weights * at.residuals**2).sum() / at.weights.sum())
    assert np.sqrt(weighted) < 0.3
    # off the truth along the optical axis the residuals are that offset, and one step takes it back
    off = HandSpace().retract(pose[None], np.eye(21)[2:3] * 4.0)[0]
    moves = next(vertex_moves(off[None], hand, varied(OTHER, 0.01), 0.01))
    matrix, vector = rows.rows(tile, off, hand, moves).normal(1.0)
    ridge = np.diag(np.concatenate([np.full(3, 1e-3), np.full(18, 1e3), np.full(SHAPE_SIZE, 1e6)]))
    step = np.linalg.solve(matrix + ridge, vector)
    assert step[2] == pytest.approx(-4.0, abs=0.6)


def test_eliminating_the_poses_is_solving_everything_at_once() -> None:
    rng = np.random.default_rng(0)
    equations = []
    for _ in range(3):
        a = rng.standard_normal((90, 21 + SHAPE_SIZE))
        equations.append((a.T @ a, a.T @ rng.standard_normal(90)))
    theta = 0.1 * rng.standard_normal(SHAPE_SIZE)
    matrix, vector = bundle._reduced(equations, theta)
    step = np.linalg.solve(matrix, vector)
    whole = np.zeros((63 + SHAPE_SIZE, 63 + SHAPE_SIZE))
    right = np.zeros(63 + SHAPE_SIZE)
    for f, (h, g) in enumerate(equations):
        index = np.r_[21 * f : 21 * f + 21, 63 : 63 + SHAPE_SIZE]
        whole[np.ix_(index, index)] += h
        right[index] += g
    shape = np.r_[63 : 63 + SHAPE_SIZE]
    whole[shape, shape] += 1.0 / POPULATION_SD**2
    right[shape] -= theta / POPULATION_SD**2
    solution = np.linalg.solve(whole, right)
    np.testing.assert_allclose(step, solution[shape], rtol=1e-8)
    np.testing.assert_allclose(np.linalg.inv(matrix), np.linalg.inv(whole)[np.ix_(shape, shape)], rtol=1e-6)
    for f, equation in enumerate(equations):
        np.testing.assert_allclose(
            bundle._pose_step(equation, step), solution[21 * f : 21 * f + 21], rtol=1e-6, atol=1e-9
        )


def test_a_shape_is_found_again_from_perfect_images(device: RenderingDevice) -> None:
    hand = average_hand("right", OTHER)
    poses = poses_of(hand, 9)
    views = Views(device, hand, poses)
    noise = np.random.default_rng(1).standard_normal((len(poses), 21)) * np.repeat(
        [4.0, 0.04, 0.08], [3, 3, 15]
    )
    start = HandSpace().retract(poses, noise)
    found = bundle.adjusted(average_hand, "right", HandShape(), start, views, TILE, iterations=15)
    hands = [average_hand("right", shape) for shape in (HandShape(), found.shape)]
    before, after = (np.abs(model.anatomy.segments - hand.anatomy.segments).max() for model in hands)
    assert before > 4.0 and after < 1.5  # mm; the population's prior holds what the images leave open
    joints = [joint_positions(model.anatomy, p) for model, p in ((hands[1], found.poses), (hand, poses))]
    assert np.median(np.linalg.norm(joints[0] - joints[1], axis=2)) < 2.0
    sd = np.sqrt(np.diag(found.covariance))
    assert (sd < POPULATION_SD + 1e-12).all() and sd[1] < 0.7 * POPULATION_SD[1]


def test_without_images_the_population_is_the_answer() -> None:
    matrix, vector = bundle._reduced([], np.zeros(SHAPE_SIZE))
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(matrix))), POPULATION_SD)
    assert not vector.any()


def test_frames_that_differ_are_chosen() -> None:
    hand = average_hand()
    poses = poses_of(hand, 3)[[0, 0, 0, 1, 1, 2, 2, 2]]
    assert spread(poses, 3).tolist() == [0, 3, 5]
    assert spread(poses[:2], 5).tolist() == [0]  # the same pose twice is one
    turned = poses[:2].copy()
    turned[1, 3:7] *= -1.0  # the same rotation
    assert spread(turned, 2).tolist() == [0]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A left hand of other size and proportions, as a Kinect sees it, at four times the usual speed."""
    path = tmp_path_factory.mktemp("calibration") / "other.mcap"
    write_synthetic(SynthOptions(frames=10, seed=6, side="left", speed=4.0, **asdict(hand_of_seed(6))), path)
    return path


@pytest.fixture(scope="module")
def calibration(recording: Path) -> Iterator[Calibration]:
    config = HandConfig.model_validate({"acquisition": FEW})
    yield calibrate(open_recording(recording), config, CalibrationOptions(seconds=SECONDS, frames=4))


def test_side_size_and_proportions_are_found_without_truth(recording: Path, calibration: Calibration) -> None:
    true, found = hand_of_seed(6), calibration.shape
    assert calibration.side == "left"
    hands = [average_hand("left", shape).anatomy for shape in (true, found, HandShape())]
    lengths = [np.concatenate([a.segments.ravel(), np.linalg.norm(a.base_positions, axis=1)]) for a in hands]
    off = [np.sqrt(np.mean((values - lengths[0]) ** 2)) for values in lengths[1:]]
    assert off[1] > 3.0  # mm, of the average hand
    assert off[0] < 0.6 * off[1]
    stamps = [frame.stamp_ns for frame in open_recording(recording).frames()]
    assert calibration.frames_seen == sum(stamp - stamps[0] <= SECONDS * 1e9 for stamp in stamps)
    assert calibration.frames_used == 4
    assert calibration.sd.shape == (SHAPE_SIZE,) and (calibration.sd > 0).all()


def test_the_file_is_a_configuration(tmp_path: Path, calibration: Calibration) -> None:
    path = tmp_path / "hand.toml"
    write_hand_file(path, calibration, None, 'a "quoted" name')
    config = load_settings(HandConfig, [path], {})
    assert config.hand.side == calibration.side
    np.testing.assert_allclose(config.hand.shape.factors, calibration.shape.factors, atol=1e-4)
    assert config.filter == HandConfig().filter


def test_the_file_names_its_mesh_from_where_it_lies(tmp_path: Path, calibration: Calibration) -> None:
    beside, elsewhere = tmp_path / "a" / "hand.glb", tmp_path / "hand.glb"
    texts = [hand_text(calibration, str(mesh), "r", tmp_path / "a") for mesh in (beside, elsewhere)]
    assert [tomllib.loads(text)["hand"]["mesh"] for text in texts] == ["hand.glb", str(elsewhere.resolve())]


def test_every_factor_is_in_the_file(calibration: Calibration) -> None:
    table = tomllib.loads(hand_text(calibration, None, "r", Path()))["hand"]
    written = [table["scale"], *table["finger_lengths"], *table["finger_widths"]]
    written += [table[name] for name in SHAPE_NAMES[11:]]
    np.testing.assert_allclose(written, calibration.shape.factors, atol=1e-4)


def test_a_recording_without_a_hand_is_told(tmp_path: Path) -> None:
    from posetrack_cli.recording.image_files import encode_png

    source = tmp_path / "wall"
    source.mkdir()
    for k in range(6):
        (source / f"{k:06d}.png").write_bytes(encode_png(np.full((424, 512), 2500, np.uint16), 1))
    (source / "camera.toml").write_text("fx = 365.0\nfy = 365.0\ncx = 255.5\ncy = 211.5\n")
    with pytest.raises(RecordingError, match=r"no hand that can be tracked.*0 of 6 frames"):
        calibrate(open_recording(source, fps=30.0), HandConfig(), CalibrationOptions())


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_skin_counts_less_towards_the_wrist_alone(side: str) -> None:
    hand = average_hand(side, OTHER)
    shares, along = wrist_shares(hand), -hand.smooth.vertices[:, 1]
    palm = hand.smooth.weights[:, 0] > 0.5
    knuckles = -hand.anatomy.base_positions[1:, 1].mean()
    behind, before = palm & (along <= 0.0), along >= WRIST_PART * knuckles
    assert behind.any() and (shares[behind] == LEAST_SHARE).all()
    assert before.any() and (shares[before] == 1.0).all() and (shares[~palm] == 1.0).all()
    between = palm & ~behind & ~before
    order = np.argsort(along[between])
    assert between.any() and (np.diff(shares[between][order]) >= 0.0).all()
