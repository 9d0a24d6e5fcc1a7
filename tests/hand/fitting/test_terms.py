"""Residuals of an image against the same written once more with numpy, and derived by differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.fit.fitter import HandFitter, nearest_pixels
from posetrack_cli.hand.fit.likelihood import RenderedCosts
from posetrack_cli.hand.fit.normal_equations import (
    RESIDUAL,
    ROW,
    THUMB_PART,
    THUMB_PLACE,
    UNKNOWNS,
    NormalEquations,
    add_row,
    clear,
    empty_equations,
    gather,
)
from posetrack_cli.hand.fit.skeleton import (
    ARM,
    NO_INNER,
    PALM,
    THUMB,
    THUMB_ROW,
    Skeleton,
    Skin,
    empty_posed,
    pose_bones,
    skeleton_of,
    skin_of,
)
from posetrack_cli.hand.fit.terms import Terms, Tile, add_terms, empty_buffers, union_cost
from posetrack_cli.hand.model.hand import HandModel, inside_limits
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import Observation, window_around
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.rendering.raster import View, draw, empty_drawing
from posetrack_cli.tracking.velocity import BodySpace
from support.fitting import HANDS, TILE_PX, WALL_MM, drawn_depth
from support.hand import KINECT, random_poses

SPACE = BodySpace()
SETTINGS = Terms()
MOVED = [*range(21), THUMB_PLACE, THUMB_PLACE + 1]
"""All unknowns but the forearm's."""
each_hand = pytest.mark.parametrize("name", list(HANDS))


def test_blocks_are_gathered_like_whole_rows() -> None:
    rng, equations = np.random.default_rng(0), empty_equations()
    rows, weights = np.zeros((300, UNKNOWNS + 1)), rng.uniform(0.1, 2.0, 300)
    for k in range(300):
        finger, row = int(rng.integers(PALM, ARM + 1)), rng.standard_normal(ROW)
        if finger == PALM:
            row[6:9] = 0.0
        else:
            rows[k, 6 + 3 * finger : 9 + 3 * finger] = row[6:9]
        if finger == THUMB_ROW:
            rows[k, THUMB_PLACE:UNKNOWNS] = row[THUMB_PART : THUMB_PART + 2]
        rows[k, :6], rows[k, UNKNOWNS] = row[:6], row[RESIDUAL]
        add_row(equations, finger, row, weights[k])
    gather(equations)
    J, r = rows[:, :UNKNOWNS], rows[:, UNKNOWNS]
    np.testing.assert_allclose(equations.matrix, (weights[:, None] * J).T @ J, atol=1e-11)
    np.testing.assert_allclose(equations.vector, (weights * r) @ J, atol=1e-11)
    before = equations.vector.copy()
    gather(equations)  # the blocks are empty now
    np.testing.assert_array_equal(equations.vector, before)
    clear(equations)
    assert not any(array.any() for array in equations)


def rigid_pieces(mesh: SkinnedMesh) -> SkinnedMesh:
    """Every triangle held by its heaviest bone alone: its motion is known exactly."""
    bone = mesh.weights[mesh.triangles].sum(axis=1).argmax(axis=1)
    count = len(mesh.triangles)
    weights = np.zeros((3 * count, mesh.weights.shape[1]))
    weights[np.arange(3 * count), np.repeat(bone, 3)] = 1.0
    vertices = mesh.vertices[mesh.triangles].reshape(-1, 3)
    return SkinnedMesh(vertices, weights, np.arange(3 * count).reshape(-1, 3))


@dataclass(frozen=True, eq=False)
class Scene:
    """A hand drawn at one pose over an observation of another."""

    skeleton: Skeleton
    skin: Skin
    bones: IntArray  # of a vertex
    pose: FloatArray
    tile: Tile
    depth: FloatArray  # of the drawn hand, infinite where there is none
    triangle: IntArray
    normals: FloatArray
    vertices: FloatArray
    facing: IntArray


def scene(name: str, seed: int) -> Scene:
    """A bent hand seen 25 mm aside, with fingers elsewhere, unread pixels and something in front of it."""
    hand, rng = HANDS[name], np.random.default_rng(seed)
    mesh = rigid_pieces(hand.smooth)
    skin, skeleton = skin_of(mesh), skeleton_of(hand.anatomy)
    pose = random_poses(1, seed)[0]
    delta = np.concatenate([[20.0, -15.0, 12.0], 0.2 * rng.standard_normal(3), 0.5 * rng.standard_normal(15)])
    other = inside_limits(SPACE.retract(pose[None], delta[None]))[0]
    window = window_around(joint_positions(hand.anatomy, pose[None])[0], KINECT, ObservationSettings())
    view = View(*window.tile_projection(KINECT))
    seen = drawn_depth(skeleton, skin, other, view)
    image = np.where(np.isfinite(seen), seen, -WALL_MM)
    image[:, :: TILE_PX // 6] = 0.0
    image[5:25, 35:45] = -300.0
    image[40:50, 10:50] += np.where(image[40:50, 10:50] > 0, 60.0, 0.0)  # beyond the gate
    inner = NO_INNER.copy()
    inner[THUMB] = 0.3 * rng.standard_normal(2)
    tile = Tile(image, nearest_pixels(image > 0), int(np.count_nonzero(image > 0)), view, inner)
    posed, out = empty_posed(), empty_drawing(skin.mesh, TILE_PX, TILE_PX)
    pose_bones(skeleton, pose, inner, posed)
    assert draw(skin.mesh, posed.bones, view, out)
    depth = np.divide(1.0, out.inverse, out=np.full((TILE_PX, TILE_PX), np.inf), where=out.inverse > 0)
    facing = np.flatnonzero(out.facing)
    return Scene(
        skeleton,
        skin,
        mesh.weights.argmax(axis=1),
        pose,
        tile,
        depth,
        out.triangle,
        out.normals,
        out.vertices,
        facing,
    )


@dataclass(frozen=True, eq=False)
class Residuals:
    """Points on bones that should be elsewhere: r_k = d_k . (target_k - p_k), or of the projections."""

    bones: IntArray
    points: FloatArray
    targets: FloatArray
    directions: FloatArray
    weights: FloatArray
    on_image: bool = False

    def values(self, points: FloatArray) -> FloatArray:
        targets, at = self.targets, points
        if self.on_image:  # seen from where the point was drawn, mm at that depth
            z = self.points[:, 2:]
            targets, at = z * targets / targets[:, 2:], z * points / points[:, 2:]
        values: FloatArray = ((targets - at) * self.directions).sum(axis=1)
        return values


def robust(e: FloatArray, tau: float) -> FloatArray:
    return 1.0 / (1.0 + (e / tau) ** 2) ** 2


def expected_residuals(s: Scene, widening: float) -> dict[str, Residuals]:
    """The terms of hand-findings.md, pixel by pixel."""
    view, image, t = s.tile.projection, s.tile.image, SETTINGS
    rows, columns = np.mgrid[:TILE_PX, :TILE_PX]
    ray = np.stack(
        [(columns + 0.5 - view.b) / view.a, (rows + 0.5 - view.d) / view.c, np.ones_like(image)], axis=2
    )
    shown, drawn = image > 0, np.isfinite(s.depth)
    z = np.where(drawn, s.depth, 0.0)
    dz = image - z
    bone = s.bones[s.skin.mesh.triangles[s.triangle, 0]]
    ahead = np.array([0.0, 0.0, 1.0])

    def of(mask, targets, directions, weights, **more) -> Residuals:  # type: ignore[no-untyped-def]
        return Residuals(bone[mask], (z[..., None] * ray)[mask], targets, directions, weights, **more)

    near = drawn & shown & (np.abs(dz) < t.gate_mm)
    normals, readings = s.normals[s.triangle[near]], (image[..., None] * ray)[near]
    off = ((readings - (z[..., None] * ray)[near]) * normals).sum(axis=1)
    surface = of(near, readings, normals, robust(off, widening * t.surface_tau_mm) / t.sigma_mm**2)
    pushed = drawn & shown & (dz >= t.gate_mm)
    towards = (z[..., None] * ray)[pushed] + t.gate_mm * ahead
    push = of(pushed, towards, np.tile(ahead, (pushed.sum(), 1)), np.full(pushed.sum(), t.push))

    missing = drawn & (image < 0) & (-image > z - t.explained_mm)
    column, row = (s.tile.nearest[k][missing] for k in range(2))
    to = np.stack(
        [(column + 0.5 - view.b) / view.a, (row + 0.5 - view.d) / view.c, np.ones_like(row)], axis=1
    )
    aside = z[missing][:, None] * (to - ray[missing])
    length = np.linalg.norm(aside, axis=1)
    weights = robust(length, widening * t.silhouette_tau_mm) / t.sigma_mm**2
    outline = of(missing, to, aside / length[:, None], weights, on_image=True)

    points = (image[..., None] * ray)[shown & (~drawn | (np.abs(dz) > t.explained_mm))]
    stride = -(-len(points) // t.most_unexplained)
    points, skin_points = points[::stride], s.vertices[s.facing]
    nearest = np.linalg.norm(points[:, None] - skin_points[None], axis=2).argmin(axis=1)
    offset = points - skin_points[nearest]
    length = np.linalg.norm(offset, axis=1)
    weights = stride * robust(length, widening * t.closest_tau_mm) / t.closest_mm**2
    closest = Residuals(
        s.bones[s.facing[nearest]], skin_points[nearest], points, offset / length[:, None], weights
    )
    return {"surface": surface, "push": push, "outline": outline, "closest": closest}


def derivatives(s: Scene, residuals: Residuals, step: float = 1e-5) -> FloatArray:
    """-dr/de (M, 23) by central differences of the pose and the thumb's inner angles."""
    posed = empty_posed()

    def bones_at(pose: FloatArray, inner: FloatArray) -> FloatArray:
        pose_bones(s.skeleton, pose, inner, posed)
        return posed.bones.copy()

    here = bones_at(s.pose, s.tile.inner)[residuals.bones]
    rest = np.einsum("kji,kj->ki", here[:, :, :3], residuals.points - here[:, :, 3])

    def values(delta: FloatArray) -> FloatArray:
        inner = s.tile.inner.copy()
        inner[THUMB] += delta[21:]
        bones = bones_at(SPACE.retract(s.pose[None], delta[None, :21])[0], inner)[residuals.bones]
        return residuals.values(np.einsum("kij,kj->ki", bones[:, :, :3], rest) + bones[:, :, 3])

    return np.stack([values(-d) - values(d) for d in step * np.eye(23)], axis=1) / (2.0 * step)


def added(s: Scene, widening: float, terms: Terms = SETTINGS) -> tuple[NormalEquations, float]:
    posed, drawing = empty_posed(), empty_drawing(s.skin.mesh, TILE_PX, TILE_PX)
    pose_bones(s.skeleton, s.pose, s.tile.inner, posed)
    assert draw(s.skin.mesh, posed.bones, s.tile.projection, drawing)
    equations, room = empty_equations(), empty_buffers(s.skin, TILE_PX, TILE_PX)
    cost = add_terms(s.tile, posed, s.skin, drawing, terms, widening, 1, room, equations)
    gather(equations)
    arm = slice(21, THUMB_PLACE)
    assert not equations.matrix[arm].any() and not equations.vector[arm].any()  # no forearm is drawn
    matrix, vector = equations.matrix[np.ix_(MOVED, MOVED)], equations.vector[MOVED]
    return equations._replace(matrix=matrix, vector=vector), cost


@each_hand
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_equations_are_those_of_independent_residuals(name: str, seed: int) -> None:
    s, widening = scene(name, seed), 1.7
    matrix, vector = np.zeros((23, 23)), np.zeros(23)
    for kind, residuals in expected_residuals(s, widening).items():
        assert len(residuals.points) > 5, kind
        J, w = derivatives(s, residuals), residuals.weights
        matrix += (w[:, None] * J).T @ J
        vector += (w * residuals.values(residuals.points)) @ J
    found, _ = added(s, widening)
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0.0] = 1.0  # what cannot be seen at all
    # relative to the largest there can be; differences over 1e-5 have errors of 1e-7 of a coordinate
    np.testing.assert_allclose(
        found.matrix / np.outer(scale, scale), matrix / np.outer(scale, scale), atol=1e-5
    )
    np.testing.assert_allclose(found.vector / scale, vector / scale, atol=1e-5 * np.abs(vector / scale).max())
    moved = np.abs(vector / scale) > 1e-3 * np.abs(vector / scale).max()
    assert moved.sum() > 12  # most components have something to say in a scene


@each_hand
def test_the_cost_is_the_union_s(name: str) -> None:
    """D of hand.md written down with masks."""
    for seed in range(4):
        s = scene(name, seed)
        image, t = s.tile.image, SETTINGS
        drawn, shown = np.isfinite(s.depth), image > 0
        error = np.minimum(np.abs(image - np.where(drawn, s.depth, 0.0)), t.clamp_mm)[drawn & shown].sum()
        beside = drawn & (image < 0) & (-image > s.depth - t.explained_mm)
        disagree = beside.sum() + t.unread_weight * (drawn & (image == 0)).sum() + (shown & ~drawn).sum()
        expected = (error + t.clamp_mm * disagree) / ((drawn & shown).sum() + disagree)
        assert added(s, 1.0)[1] == pytest.approx(expected, rel=1e-12)
        posed, drawing = empty_posed(), empty_drawing(s.skin.mesh, TILE_PX, TILE_PX)
        pose_bones(s.skeleton, s.pose, s.tile.inner, posed)
        draw(s.skin.mesh, posed.bones, s.tile.projection, drawing)
        assert union_cost(s.tile, drawing, SETTINGS) == pytest.approx(expected, rel=1e-12)


def test_the_cost_is_the_renderer_s_where_nothing_hides_the_hand(device: RenderingDevice) -> None:
    hand = HANDS["right"]
    settings = ObservationSettings(cost="union")
    model = HandModel(hand.anatomy, hand.smooth, hand.smooth)
    scorer = RenderedCosts(device, model, KINECT, settings, 1)
    fitter = HandFitter(hand, KINECT, TILE_PX)
    for pose, other in zip(random_poses(8, 1), random_poses(8, 2), strict=True):
        other[:3], other[3:7] = pose[:3] + np.array([10.0, 5.0, -8.0]), pose[3:7]
        window = window_around(joint_positions(hand.anatomy, pose[None])[0], KINECT, settings)
        depth = drawn_depth(
            fitter.hand.skeleton, fitter.hand.skin, other, View(*window.tile_projection(KINECT))
        )
        image = np.where(np.isfinite(depth), depth, -WALL_MM).astype(np.float32)
        image[::7] = 0.0
        observation = Observation(window, image, int(np.count_nonzero(image > 0)))
        found = fitter.costs(fitter.tile(observation), pose[None])
        # a pixel on an edge may be drawn by one alone: 40 mm of some 800 pixels
        assert found == pytest.approx(scorer.costs(pose[None], observation), abs=3 * 40.0 / 800.0)


def test_a_perfect_observation_pulls_nowhere() -> None:
    s = scene("right", 3)
    image = np.where(np.isfinite(s.depth), s.depth, -WALL_MM)
    tile = s.tile._replace(image=image, nearest=nearest_pixels(image > 0), observed=int((image > 0).sum()))
    still = Scene(**{**vars(s), "tile": tile})
    equations, cost = added(still, 1.0)
    assert cost == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(equations.vector, 0.0, atol=1e-6)
    assert np.linalg.eigvalsh(equations.matrix)[0] > -1e-6


def test_what_is_hidden_or_unread_says_nothing() -> None:
    """A reading in front hides the hand wholly; missing ones cost a share, and pull nowhere."""
    s = scene("right", 4)
    for value, expected in ((-300.0, SETTINGS.clamp_mm), (0.0, SETTINGS.clamp_mm)):
        image = np.full((TILE_PX, TILE_PX), value)
        tile = Tile(image, nearest_pixels(image > 0), 0, s.tile.projection)
        equations, cost = added(Scene(**{**vars(s), "tile": tile}), 1.0)
        assert cost == expected
        assert not equations.matrix.any()
        assert not equations.vector.any()


@pytest.mark.parametrize("seed", range(5))
def test_nearest_pixels_are_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = np.zeros((40, 48), dtype=bool)
    mask[rng.integers(40, size=1 + 8 * seed), rng.integers(48, size=1 + 8 * seed)] = True
    column, row = nearest_pixels(mask)
    rows, columns = np.mgrid[:40, :48]
    at = np.argwhere(mask)
    exact = np.linalg.norm(np.stack([rows, columns], -1)[:, :, None] - at, axis=3).min(axis=2)
    assert mask[row.astype(int), column.astype(int)].all()
    found = np.hypot(row - rows, column - columns)
    # distances of the 5 x 5 chamfer mask are right to 2 %: so a pixel at most 4 % farther is taken
    assert (found <= 1.04 * exact + 1e-9).all()
    np.testing.assert_array_equal(found[mask], 0.0)


def test_without_a_hand_every_pixel_is_its_own_nearest() -> None:
    column, row = nearest_pixels(np.zeros((3, 4), dtype=bool))
    np.testing.assert_array_equal(column, np.tile(np.arange(4), (3, 1)))
    np.testing.assert_array_equal(row, np.tile(np.arange(3)[:, None], (1, 4)))
