"""The forearm: its skin, its derivatives, and that a hand before it is where its fingers say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.least_squares import eliminated
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.fit.fitter import HandFitter, PosePrior
from posetrack_cli.hand.fit.gauss_newton import (
    ABDUCTION_SD,
    FREE_BEND,
    FREE_THUMB,
    GIRTH_SD,
    IP_SD,
    SWING_SD,
    add_inner_prior,
    empty_fit,
)
from posetrack_cli.hand.fit.local_fits import MARGINAL_THUMB_SHARE, marginalise_inner
from posetrack_cli.hand.fit.normal_equations import ROW, UNKNOWNS, add_row, empty_equations, gather
from posetrack_cli.hand.fit.skeleton import ARM, NO_THUMB, Posed, empty_posed, point_row, pose_bones, skin_of
from posetrack_cli.hand.model.anatomy import ARM_BONE, random_shape
from posetrack_cli.hand.model.forearm import SEEN_MM, transforms_with_forearm
from posetrack_cli.hand.model.hand import HandModel, average_hand, hand_maker
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.observe.observation import IGNORED, Observation, window_around
from posetrack_cli.rendering.mesh import SkinnedMesh, is_closed
from posetrack_cli.rendering.raster import View, draw, empty_drawing
from posetrack_cli.tracking.velocity import BodySpace
from support.fitting import HANDS, RIGHT, TILE_PX, WALL_MM
from support.hand import KINECT, bent, random_poses

FLOAT32 = 2e-3
"""mm: of transforms that go to a renderer, at coordinates below 2 m."""
FREE = 1.0 / np.square(np.repeat([60.0, 0.8, 0.7], [3, 3, 15]))
"""(21,) a prior that holds next to nothing."""
DOWN = np.array([0.0, 1.0, 0.0])
NO_ARM = np.zeros(4)
each_hand = pytest.mark.parametrize("name", list(HANDS))


def arm_towards(direction: FloatArray, log_girth: float = 0.0) -> FloatArray:
    return np.append(direction / np.linalg.norm(direction), log_girth)


def with_arm(arm: FloatArray) -> FloatArray:
    """Inner numbers (6,) of a forearm (4,) and a thumb as the pose has it."""
    return np.concatenate([arm, NO_THUMB])


def posed(pose: FloatArray, arm: FloatArray, name: str = "right") -> Posed:
    fitter_hand, out = HANDS[name], empty_posed()
    pose_bones(HandFitter(fitter_hand, KINECT, TILE_PX).hand.skeleton, pose, with_arm(arm), out)
    return out


def seen(fitter: HandFitter, pose: FloatArray, arm: FloatArray, elbow_mm: float) -> Observation:
    """What a perfect sensor sees of hand and arm before a wall; none counts ``elbow_mm`` behind the wrist."""
    window = window_around(joint_positions(RIGHT.anatomy, pose[None])[0], KINECT, ObservationSettings())
    view, out = View(*window.tile_projection(KINECT)), posed(pose, arm)
    drawing = empty_drawing(fitter.hand.skin.mesh, TILE_PX, TILE_PX)
    assert draw(fitter.hand.skin.mesh, out.bones, view, drawing)
    z = np.divide(1.0, drawing.inverse, out=np.full((TILE_PX, TILE_PX), np.inf), where=drawing.inverse > 0)
    image = np.where(np.isfinite(z), z, -WALL_MM)
    rows, columns = np.mgrid[:TILE_PX, :TILE_PX] + 0.5
    points = np.stack([(columns - view.b) / view.a * z, (rows - view.d) / view.c * z, z], axis=2)
    with np.errstate(invalid="ignore"):
        beyond = (points - pose[:3]) @ arm[:3] > elbow_mm
    image[np.isfinite(z) & beyond] = IGNORED
    return Observation(window, image.astype(np.float32), int(np.count_nonzero(image > 0)), with_arm(arm))


INSCRIBED = 1.0 - np.cos(np.pi / 10.0)
"""By how much a tube of ten sides is narrower than its ellipse, at most."""


@pytest.mark.parametrize("seed", range(8))
def test_all_levels_of_detail_have_one_forearm(seed: int) -> None:
    """What particles are weighed by is where the fits have it, however few vertices a skin's end has."""
    hand = hand_maker(None)("right" if seed % 2 else "left", random_shape(np.random.default_rng(seed)))
    lean = hand.lean_with_arm.vertices[len(hand.lean.vertices) :]
    smooth = hand.smooth_with_arm.vertices[len(hand.smooth.vertices) :]
    assert np.ptp(lean[:, 1]) == pytest.approx(np.ptp(smooth[:, 1]))
    for axis in (0, 2):
        assert np.ptp(lean[:, axis]) == pytest.approx(np.ptp(smooth[:, axis]), rel=INSCRIBED)


@each_hand
def test_a_tube_goes_on_where_the_hand_ends_and_faces_outwards(name: str) -> None:
    hand = HANDS[name]
    for mesh, bare in ((hand.lean_with_arm, hand.lean), (hand.smooth_with_arm, hand.smooth)):
        first = len(bare.vertices)
        np.testing.assert_array_equal(mesh.vertices[:first], bare.vertices)
        tube, weights = mesh.vertices[first:], mesh.weights[first:]
        np.testing.assert_array_equal(weights.sum(axis=1), 1.0)
        # what moves with the palm lies inside the hand, the other from the wrist's joint on
        np.testing.assert_array_equal(weights[:, 0] == 1.0, tube[:, 1] < 0.0)
        np.testing.assert_array_equal(weights[:, ARM_BONE] == 1.0, tube[:, 1] >= 0.0)
        assert tube[:, 1].max() > SEEN_MM + 60.0
        # the wall of the tube encloses a volume that is positive if it faces outwards; its near end is open
        faces = mesh.triangles[mesh.triangles[:, 0] >= first] - first
        a, b, c = (tube[faces[:, k]] - [0.0, tube[:, 1].min(), 0.0] for k in range(3))
        volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
        assert 0.5 < volume / (np.pi * 25.0 * 35.0 * np.ptp(tube[:, 1])) < 1.5
        assert is_closed(bare.triangles)


@pytest.mark.parametrize("bend", [-0.8, -0.4, 0.0, 0.4, 0.8])
@pytest.mark.parametrize("seed", [None, 1, 2])
def test_a_bent_wrist_leaves_no_gap_before_it(bend: float, seed: int | None) -> None:
    """Of the average hand, and of others of the population: their skin reaches into the tube."""
    shape = None if seed is None else random_shape(np.random.default_rng(seed))
    assert_no_gap(average_hand("right", shape), bend)


@pytest.mark.parametrize("bend", [-0.8, -0.4, 0.0, 0.4, 0.8])
@pytest.mark.parametrize("end_mm", [8.0, 0.0, -6.0])
def test_a_bent_wrist_of_a_skin_that_ends_at_the_joint_leaves_none_either(end_mm: float, bend: float) -> None:
    """As the skin of a hand from a file may: the people's own meshes end between -7 and 3 mm behind it."""
    average = average_hand("right")

    def ended(mesh: SkinnedMesh) -> SkinnedMesh:
        vertices = mesh.vertices.copy()
        vertices[:, 1] = np.minimum(vertices[:, 1], end_mm)
        return replace(mesh, vertices=vertices)

    assert_no_gap(replace(average, lean=ended(average.lean), smooth=ended(average.smooth)), bend)


def assert_no_gap(hand: HandModel, bend: float) -> None:
    """Its skin is drawn over the middle of the limb, and nowhere behind that: one sees into no wrist."""
    pose = bent()
    pose[:3] = 0.0, 0.0, 600.0
    arm = arm_towards(np.array([0.0, np.cos(bend), np.sin(bend)]))
    out, fitter = empty_posed(), HandFitter(hand, KINECT, TILE_PX)
    pose_bones(fitter.hand.skeleton, pose, with_arm(arm), out)
    window = window_around(joint_positions(hand.anatomy, pose[None])[0], KINECT, ObservationSettings())
    drawing = empty_drawing(fitter.hand.skin.mesh, TILE_PX, TILE_PX)
    assert draw(fitter.hand.skin.mesh, out.bones, View(*window.tile_projection(KINECT)), drawing)
    # the limb's middle, from the palm past the wrist joint to where the forearm is
    along = np.linspace(-40.0, 30.0, 100)[:, None]
    middle = pose[:3] + np.where(along < 0.0, along * DOWN, along * arm[:3])
    pixels = KINECT.pixels_from_points(middle)[0]
    columns = np.rint((pixels[:, 0] - window.left) / window.step).astype(int)
    rows = np.rint((pixels[:, 1] - window.top) / window.step).astype(int)
    inside = rows < TILE_PX
    assert inside.sum() > 50
    assert (drawing.inverse[rows[inside], columns[inside]] > 1.0 / middle[inside, 2]).all()


@each_hand
def test_many_hands_are_posed_as_arrays_pose_them_and_a_forearm_behind_each(name: str) -> None:
    rng, poses, anatomy = np.random.default_rng(3), random_poses(20, 7), HANDS[name].anatomy
    for direction in np.concatenate([rng.standard_normal((5, 3)), np.eye(3)]):
        thumb, arm = 0.1 * rng.standard_normal(2), arm_towards(direction, 0.2 * rng.standard_normal())
        found = transforms_with_forearm(anatomy, poses, np.concatenate([arm, thumb]))
        np.testing.assert_allclose(
            found[:, :ARM_BONE], skinning_transforms(anatomy, poses, thumb), atol=FLOAT32
        )
        turns = found[:, ARM_BONE, :, :3].astype(np.float64)
        girth = np.broadcast_to(np.exp([arm[3], 0.0, arm[3]]), (len(poses), 3))
        np.testing.assert_allclose(np.linalg.norm(turns, axis=1), girth, rtol=1e-5)
        assert (np.linalg.det(turns) > 0.0).all()
        np.testing.assert_allclose(turns[:, :, 1], np.broadcast_to(arm[:3], (len(poses), 3)), atol=1e-6)
        np.testing.assert_allclose(found[:, ARM_BONE, :, 3], poses[:, :3], atol=FLOAT32)


def test_without_one_nothing_of_it_is_drawn() -> None:
    pose = random_poses(1, 1)[0]
    bones = transforms_with_forearm(RIGHT.anatomy, pose[None], with_arm(NO_ARM))
    np.testing.assert_array_equal(bones[0, ARM_BONE, :, :3], 0.0)
    mesh = RIGHT.smooth_with_arm
    arm = mesh.posed(bones.astype(np.float64))[0, mesh.weights[:, ARM_BONE] == 1.0]
    np.testing.assert_allclose(arm, np.broadcast_to(pose[:3], arm.shape), atol=FLOAT32)


@pytest.mark.parametrize("seed", range(6))
def test_what_of_a_forearm_is_in_the_hand_is_not_seen(seed: int) -> None:
    """Whatever shape and pose: hands without an arm are drawn as if there was no forearm to draw."""
    hand = average_hand("left" if seed % 2 else "right", random_shape(np.random.default_rng(seed)))
    pose = random_poses(1, seed)[0]
    pose[:3] = [0.0, 40.0, 650.0]
    skeleton, out = HandFitter(hand, KINECT, TILE_PX).hand.skeleton, empty_posed()
    pose_bones(skeleton, pose, with_arm(NO_ARM), out)
    window = window_around(joint_positions(hand.anatomy, pose[None])[0], KINECT, ObservationSettings())
    view = View(*window.tile_projection(KINECT))
    for bare, mesh in ((hand.lean, hand.lean_with_arm), (hand.smooth, hand.smooth_with_arm)):
        drawings = [empty_drawing(skin_of(m).mesh, TILE_PX, TILE_PX) for m in (bare, mesh)]
        for skin, drawing in zip((bare, mesh), drawings, strict=True):
            assert draw(skin_of(skin).mesh, out.bones, view, drawing)
        np.testing.assert_allclose(drawings[1].inverse, drawings[0].inverse, rtol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_rows_of_its_points_are_central_differences(seed: int) -> None:
    """By the hand's position, which carries it, by both swings and by the girth."""
    rng, step = np.random.default_rng(seed), 1e-6
    pose = random_poses(1, seed)[0]
    arm = arm_towards(rng.standard_normal(3), 0.1)
    out, rest = posed(pose, arm), 40.0 * rng.standard_normal(3)
    way = rng.standard_normal(3)
    axes = out.axes[ARM].copy()

    def at(delta: FloatArray) -> FloatArray:
        there = pose.copy()
        there[:3] += delta[:3]
        bone = posed(there, arm).bones[ARM_BONE].copy()
        turn = rotations.matrices_from_quaternions(
            rotations.exponential(delta[3] * axes[0] + delta[4] * axes[1])[None]
        )[0]
        bone[:, :3] = turn @ bone[:, :3]
        bone[:, [0, 2]] *= np.exp(delta[5])
        return bone[:, :3] @ rest + bone[:, 3]

    expected = [way @ (at(d) - at(-d)) / (2.0 * step) for d in step * np.eye(6)]
    row, point = np.zeros(ROW), at(np.zeros(6))
    point_row(out, ARM, np.zeros((1, 3)), 0, *point, *way, row)
    np.testing.assert_allclose(row[[0, 1, 2, 6, 7, 8]], expected, rtol=1e-6, atol=1e-5)
    np.testing.assert_array_equal(row[3:6], 0.0)  # it keeps its direction where the palm turns


def test_a_hand_that_slid_along_its_arm_comes_back_to_its_fingers() -> None:
    """25 mm towards the elbow, seen from the back: what a cut at the wrist would take for the truth."""
    fitter = HandFitter(RIGHT, KINECT, TILE_PX)
    truth = bent(index_mcp_flexion=0.3, middle_mcp_flexion=0.2, thumb_mcp_flexion=0.3)
    truth[:3], truth[3:7] = [0.0, 40.0, 650.0], [0.0, 1.0, 0.0, 0.0]
    arm = arm_towards(np.array([0.2, 1.0, 0.1]))
    tile = fitter.tile(seen(fitter, truth, arm, SEEN_MM))
    slid = truth.copy()
    slid[:3] += 25.0 * arm[:3]
    expected = arm_towards(np.array([0.1, 1.0, 0.0]), 0.1)  # neither direction nor girth are known exactly
    expected_inner = with_arm(expected)
    tile = tile._replace(inner=expected_inner, expected=expected_inner)
    found = fitter.descend(tile, slid[None], [PosePrior(slid, FREE)], 20)[0]
    joints = joint_positions(RIGHT.anatomy, np.stack([truth, found.pose]))
    assert np.linalg.norm(joints[0] - joints[1], axis=1).mean() < 2.0
    assert np.degrees(np.arccos(found.inner[:3] @ arm[:3])) < 2.0
    assert abs(found.inner[3]) < 0.05
    assert found.cost[0] < 1.0


@pytest.mark.parametrize("bend_deg", [0.0, 55.0, 80.0, 120.0])
def test_a_wrist_is_turned_back_from_where_it_cannot_bend_to(bend_deg: float) -> None:
    """Nothing pulls up to 60 degrees; beyond, hand and forearm are turned back by the excess."""
    pose, bend = bent(), np.deg2rad(bend_deg)
    arm = arm_towards(np.array([0.0, np.cos(bend), np.sin(bend)]))
    equations = empty_equations()
    add_inner_prior(with_arm(arm), with_arm(arm), FREE_THUMB.precision, posed(pose, arm), equations)
    step = np.zeros(UNKNOWNS)
    step[[3, 4, 5, 21, 22]] = np.linalg.pinv(equations.matrix[:, [3, 4, 5, 21, 22]]) @ equations.vector
    turned = BodySpace().retract(pose[None], step[None, :21])[0]
    axes = posed(pose, arm).axes[ARM]
    swung = rotations.matrices_from_quaternions(
        rotations.exponential(step[21] * axes[0] + step[22] * axes[1])[None]
    )[0]
    palm = rotations.matrices_from_quaternions(turned[None, 3:7])[0, :, 1]
    left = np.arccos(np.clip(palm @ swung @ arm[:3], -1.0, 1.0))
    expected = min(bend, FREE_BEND)
    assert left == pytest.approx(expected, abs=1e-6)
    assert equations.vector.any() == (bend > FREE_BEND)


def test_inner_numbers_are_integrated_out_of_what_a_fit_tells() -> None:
    rng, equations = np.random.default_rng(2), empty_equations()
    for _ in range(200):
        add_row(equations, int(rng.integers(-1, 6)), rng.standard_normal(ROW), 1.0)
    gather(equations)
    fit = empty_fit()._replace(data=equations, pose=random_poses(1, 4)[0])
    fit.inner[:] = *arm_towards(DOWN, 0.1), 0.2, -0.1
    expected = np.array([0.05, 0.1])
    gradient, information = marginalise_inner(fit, 0.7, empty_equations(), expected)
    H, g = 0.7 * equations.matrix, 0.7 * equations.vector
    left = MARGINAL_THUMB_SHARE * np.array([IP_SD, ABDUCTION_SD])
    H[range(21, 26), range(21, 26)] += np.array([SWING_SD, SWING_SD, GIRTH_SD, *left]) ** -2.0
    g[24:] += 0.7 * np.array([IP_SD, ABDUCTION_SD]) ** -2.0 * (expected - fit.inner[4:])
    wanted, vector = eliminated(H, g, slice(0, 21), slice(21, 26))
    np.testing.assert_allclose(information, wanted, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(gradient, vector, atol=1e-9 * np.abs(vector).max())


def test_fits_of_a_hand_alone_do_not_depend_on_the_tube() -> None:
    """A skin that has a forearm, with none in the image, gives the costs of one that has none."""
    fitter = HandFitter(RIGHT, KINECT, TILE_PX)
    pose = bent(index_mcp_flexion=0.4)
    pose[:3] = [0.0, 40.0, 650.0]
    observation = seen(fitter, pose, NO_ARM, np.inf)
    tile = fitter.tile(observation)
    bare = empty_drawing(skin_of(RIGHT.smooth).mesh, TILE_PX, TILE_PX)
    assert draw(skin_of(RIGHT.smooth).mesh, posed(pose, NO_ARM).bones, tile.projection, bare)
    alone = np.divide(1.0, bare.inverse, out=np.full_like(bare.inverse, -WALL_MM), where=bare.inverse > 0)
    np.testing.assert_allclose(observation.image, alone, rtol=1e-6)
    sd = 0.1 * np.random.default_rng(1).standard_normal((8, 21))
    others = BodySpace().retract(np.tile(pose, (8, 1)), sd)
    for fit in fitter.descend(tile, others, [PosePrior(other, FREE) for other in others], 3):
        np.testing.assert_array_equal(fit.inner[:4], NO_ARM)
        assert not fit.data.matrix[21:24].any()
