"""The hands that are shipped are built as they should be: modes, joints, a template laid on a skin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import (
    HandAnatomy,
    HandShape,
    Population,
    make_anatomy,
    population,
    reshaped_anatomy,
    reshaped_skin,
)
from posetrack_cli.hand.model.hand import hand_mesh
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.npz import read_npz
from posetrack_cli.rendering.mesh import SkinnedMesh, closest_points, is_closed, smoothing
from research.hand_model import build
from research.hand_model.build import BONE_WEIGHT, modes_of, with_tips_in_the_skin
from research.hand_model.people import RIG_LENGTH_MM, anatomical_joints, rows
from research.hand_model.registration import Skin, Template
from research.hand_model.template import SEGMENTS, adult, cage_of
from support.glb import write_hand
from support.hand import REST, enclosed_volume

SIZE = 671  # numbers of a hand
BONES = slice(-50, -20)
LAST_SEGMENTS = np.arange(SIZE - 33, SIZE - 20, 3)


# Modes


def drawn_hands(count: int) -> tuple[FloatArray, FloatArray]:
    """Hands (N, 671) of a mean of zeros, and three ways (3, 671) in which they differ by one each."""
    rng = np.random.default_rng(2)
    ways = rng.standard_normal((3, SIZE))
    counted = np.ones(SIZE)
    counted[BONES] = BONE_WEIGHT
    ways = np.linalg.qr((ways * counted).T)[0].T / counted * np.array([[90.0], [50.0], [20.0]])
    return rng.standard_normal((count, 3)) @ ways + 0.01 * rng.standard_normal((count, SIZE)), ways


def test_modes_are_those_that_hands_were_drawn_with() -> None:
    hands, ways = drawn_hands(1500)
    mean, modes = modes_of(hands + 5.0, 4)
    few = 5.0 / np.sqrt(len(hands))  # of a standard deviation: five standard errors
    np.testing.assert_allclose(mean, 5.0, atol=few * np.abs(ways).max())
    for way, mode in zip(ways, modes, strict=False):
        alike = way @ mode / np.linalg.norm(way) / np.linalg.norm(mode)
        assert abs(alike) > 0.99
        assert np.linalg.norm(mode) == pytest.approx(np.linalg.norm(way), rel=few)
        assert mode[np.abs(mode).argmax()] > 0.0  # the sign is fixed
    assert np.linalg.norm(modes[3]) < 0.1  # nothing is left but the noise


# Joints


def rig(anatomy: HandAnatomy) -> FloatArray:
    """Joints (21, 3) of a hand at rest."""
    return joint_positions(anatomy, REST[None])[0]


def test_a_knuckle_at_the_web_is_moved_back_and_the_rest_divided() -> None:
    joints = rig(adult())
    shifted = joints.copy()
    for finger in range(1, 5):
        knuckle, pip = joints[1 + 4 * finger], joints[2 + 4 * finger]
        shifted[1 + 4 * finger] = knuckle + 0.35 * (pip - knuckle)  # as rigs have it, at the web
    placed = anatomical_joints(shifted, None)
    for finger in range(1, 5):
        chain = placed[1 + 4 * finger : 5 + 4 * finger]
        first, second, third = np.linalg.norm(np.diff(chain, axis=0), axis=1)
        whole = first + second + third
        np.testing.assert_allclose(
            np.array([first, second, third]) / whole, SEGMENTS[finger] / SEGMENTS[finger].sum(), atol=1e-9
        )
        back = np.linalg.norm(placed[1 + 4 * finger] - joints[1 + 4 * finger])
        assert back < 0.35 * np.linalg.norm(joints[2 + 4 * finger] - joints[1 + 4 * finger])


def test_where_joints_are_placed_turns_with_the_hand() -> None:
    joints = rig(reshaped_anatomy(adult(), "right", HandShape(0.9, (1.0, 1.2, 0.9, 1.1, 1.0))))
    turn, offset = rotations.exponential(np.array([0.4, -1.0, 0.7])), np.array([30.0, -20.0, 500.0])
    moved = anatomical_joints(rotations.rotate(turn, joints) + offset, None)
    np.testing.assert_allclose(moved, rotations.rotate(turn, anatomical_joints(joints, None)) + offset)


# The template


def template() -> tuple[Template, SkinnedMesh]:
    """The template, and its surface on the tables' hand."""
    cage = cage_of(adult())
    surface = smoothing(cage.triangles, 1)
    skin = SkinnedMesh(surface.through @ cage.vertices, surface.blend @ cage.weights, surface.triangles)
    return Template(surface.triangles, surface.through), skin


def off_skin(points: FloatArray, skin: SkinnedMesh) -> FloatArray:
    """Distances (N,) of points from a skin, mm."""
    corners = skin.vertices[skin.triangles]
    triangle, shares = closest_points(points, corners)
    return np.linalg.norm(np.einsum("nc,ncx->nx", shares, corners[triangle]) - points, axis=1)


A_TIE = 2
"""Triangles: of two diagonals of a quad that are equally long, the processor's rounding chooses."""


def test_the_template_is_a_hand() -> None:
    cage, (_, skin) = cage_of(adult()), template()
    assert is_closed(cage.triangles) and len(cage.triangles) == 410
    others = (cage.triangles != population().triangles).any(axis=1)
    assert others.sum() <= A_TIE
    np.testing.assert_allclose(cage.weights, population().weights, atol=1e-6)
    assert 230e3 < enclosed_volume(skin.vertices, skin.triangles) < 400e3
    for factor in (0.8, 1.25):  # of any hand the triangles are the same
        other = reshaped_anatomy(adult(), "right", HandShape(1.0, (factor,) * 5, (1.0 / factor,) * 5))
        np.testing.assert_array_equal(cage_of(other).triangles, cage.triangles)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_template_is_laid_on_a_hand_like_it(seed: int) -> None:
    """Its own skin in another shape, of other triangles: a finer surface."""
    laid, skin = template()
    factors = np.exp(np.random.default_rng(seed).normal(0.0, 0.06, 16))
    other = reshaped_skin(skin, adult(), "right", HandShape.of_factors(factors))
    fine = smoothing(skin.triangles, 1)
    wanted = SkinnedMesh(fine.through @ other.vertices, fine.blend @ other.weights, fine.triangles)
    found = laid.laid(skin.vertices, Skin(wanted))
    before, after = off_skin(skin.vertices, wanted), off_skin(found, wanted)
    assert before.max() > 3.0
    assert after.mean() < 0.2 * before.mean() and np.percentile(after, 95) < 0.5
    # and nothing of the skin is left out, tips included
    missed = off_skin(wanted.vertices, replace(skin, vertices=found))
    assert missed.mean() < 0.4 and missed.max() < 4.0
    volumes = [enclosed_volume(v, skin.triangles) for v in (found, other.vertices)]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.02)  # smoothing does not shrink it


# Tips


def stretched(sizes: FloatArray) -> Population:
    """The hands that are shipped, whose skin's ends (5,) differ by a last mode, mm, and joints do not."""
    people = population()
    cage = np.zeros((len(people.weights), 3))
    for finger, frame in enumerate(make_anatomy().base_rotations):
        outer = people.weights[:, 2 + 3 * finger : 4 + 3 * finger].sum(axis=1) > 0.5
        cage[outer] -= sizes[finger] * frame[:, 1]
    mode = np.zeros(SIZE)
    mode[: cage.size] = cage.ravel()
    return replace(people, modes=np.vstack([people.modes[:2], mode]))


def test_tips_end_with_the_skin() -> None:
    """In a mode that moves the ends of all fingers, tips go along; nothing else is changed."""
    sizes = 0.1 * np.array([1.0, 0.8, 0.6, -0.5, -1.0])  # so small that the outermost vertex remains it
    before = stretched(sizes)
    shifted = before.mean.copy()
    shifted[LAST_SEGMENTS] += 3.0
    after = with_tips_in_the_skin(replace(before, mean=shifted))
    np.testing.assert_allclose(after.mean, before.mean, atol=1e-5)  # as what is shipped was made
    np.testing.assert_allclose(after.modes[2, LAST_SEGMENTS], sizes, rtol=1e-3)
    others = np.setdiff1d(np.arange(SIZE), LAST_SEGMENTS)
    np.testing.assert_array_equal(after.modes[:, others], before.modes[:, others])


# All of it


def test_a_population_is_built_of_files_and_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of people that are one hand in five sizes nothing is left but what is drawn of joints and factors."""
    for k, scale in enumerate((0.9, 0.95, 1.0, 1.05, 1.1)):
        write_hand(tmp_path / f"{k}-right.glb", make_anatomy("right", scale), REST)
    made = tmp_path / "population.npz"
    monkeypatch.setattr(build, "COEFFICIENTS", 3)
    printed = CliRunner().invoke(build.main, [str(tmp_path), "-o", str(made)], catch_exceptions=False)
    assert printed.exit_code == 0 and f"{made}: 5 hands, 3 modes leave" in printed.output
    with made.open("rb") as stream:
        arrays = read_npz(stream)
    assert arrays["mean"].shape == (SIZE,) and arrays["modes"].shape == (3, SIZE)
    hands = np.array(list(rows(sorted(tmp_path.glob("*.glb")))))
    others = np.setdiff1d(np.arange(SIZE), LAST_SEGMENTS)  # tips are moved to where the skin ends
    np.testing.assert_allclose(arrays["mean"][others], hands.mean(axis=0)[others], atol=1e-5)  # drawn alike
    ends = np.cumsum([3 * len(population().weights), 15, 15])
    for hand in hands:
        _, bases, segments, _ = np.split(hand, ends)
        length = np.linalg.norm(bases.reshape(5, 3)[2]) + segments.reshape(5, 3)[2].sum()
        assert length == pytest.approx(RIG_LENGTH_MM)
    cage = arrays["mean"][: ends[0]].reshape(-1, 3)
    assert is_closed(arrays["triangles"]) and cage[:, 1].max() == pytest.approx(13.0)
    # the skin that was put in, in lengths of a hand
    surface = smoothing(cage_of(adult()).triangles, 1)
    volume = enclosed_volume(surface.through @ cage, surface.triangles)
    given = hand_mesh(make_anatomy(), "medium")
    assert volume == pytest.approx(enclosed_volume(given.vertices, given.triangles), rel=0.1)
