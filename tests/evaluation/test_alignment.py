"""The constant offset of a model's frame: planted ones come back, found ones are the best there are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.reading.alignment import common_factor, remove_constant_offset
from posetrack_cli.evaluation.reading.tracks import Pairs, Track
from posetrack_cli.geometry import rotations
from support.metrics import all_pairs
from support.tracks import random_hand, random_head

FRAMES = 40
ROUNDING = 1e-9
"""Poses of some 1000 mm, a hundred operations each: eps * 1000 * 100 is 2e-11."""
seeds = st.integers(0, 10_000)


def of(array: Any) -> FloatArray:
    assert array is not None
    return np.asarray(array)


def offset_by(track: Track, turn: Rotation, shift: FloatArray) -> Track:
    """The same motion told by a model whose frame sits elsewhere, by scipy; its velocity is left as it is."""
    poses = Rotation.from_quat(of(track.quaternion))
    return replace(
        track,
        position=of(track.position) + poses.apply(shift),
        quaternion=rotations.canonical((poses * turn).as_quat()),
    )


def shaken(track: Track, seed: int, sd_mm: float = 8.0, sd_rad: float = 0.2) -> Track:
    """The track with noise on its poses and points."""
    rng = np.random.default_rng(seed)
    noise = Rotation.from_rotvec(sd_rad * rng.standard_normal((len(track), 3)))
    return replace(
        track,
        position=of(track.position) + sd_mm * rng.standard_normal((len(track), 3)),
        quaternion=rotations.canonical((Rotation.from_quat(of(track.quaternion)) * noise).as_quat()),
        points=of(track.points) + sd_mm * rng.standard_normal(of(track.points).shape),
    )


def planted(seed: int) -> tuple[Rotation, FloatArray]:
    rng = np.random.default_rng(seed)
    return Rotation.random(random_state=rng), 30.0 * rng.standard_normal(3)


def in_object(track: Track) -> FloatArray:
    """Points in the object's frame, one frame at a time."""
    poses = zip(of(track.points), of(track.position), of(track.quaternion), strict=True)
    return np.array([Rotation.from_quat(q).inv().apply(p - t) for p, t, q in poses])


def cost(estimate: Track, truth: Track) -> tuple[float, float]:
    """What is minimised: summed squares of translations (mm^2), and of rotation matrices' differences."""
    mine, theirs = (Rotation.from_quat(of(t.quaternion)).as_matrix() for t in (estimate, truth))
    translation = ((of(estimate.position) - of(truth.position)) ** 2).sum()
    return float(translation), float(((mine - theirs) ** 2).sum())


@settings(deadline=None, max_examples=40)
@given(seeds)
def test_a_planted_offset_comes_back_exactly(seed: int) -> None:
    truth = random_head(FRAMES, seed)
    estimate = offset_by(truth, *planted(seed))
    aligned, _ = remove_constant_offset(estimate, truth, all_pairs(FRAMES))
    np.testing.assert_allclose(of(aligned.position), of(truth.position), atol=ROUNDING)
    assert rotations.angle_between(of(aligned.quaternion), of(truth.quaternion)).max() < ROUNDING
    np.testing.assert_allclose(in_object(aligned), in_object(truth), atol=ROUNDING)


@settings(deadline=None, max_examples=10)
@given(seeds)
def test_no_other_offset_is_better(seed: int) -> None:
    """scipy's minimiser, started at the found offset, finds nothing below it: to 1e-6 of the sum."""
    truth = random_head(12, seed)
    estimate = shaken(truth, seed)
    best = cost(remove_constant_offset(estimate, truth, all_pairs(12))[0], truth)

    def translation(shift: FloatArray) -> float:
        return cost(offset_by(estimate, Rotation.identity(), shift), truth)[0]

    def rotation(vector: FloatArray) -> float:
        return cost(offset_by(estimate, Rotation.from_rotvec(vector), np.zeros(3)), truth)[1]

    assert best[0] <= minimize(translation, np.zeros(3)).fun * (1 + 1e-6)
    assert best[1] <= minimize(rotation, np.zeros(3)).fun * (1 + 1e-6)


@settings(deadline=None, max_examples=40)
@given(seeds)
def test_errors_never_grow(seed: int) -> None:
    truth = random_head(FRAMES, seed)
    estimate = shaken(truth, seed)
    before = cost(estimate, truth)
    aligned, _ = remove_constant_offset(estimate, truth, all_pairs(FRAMES))
    after = cost(aligned, truth)
    assert after[0] <= before[0] * (1 + ROUNDING) and after[1] <= before[1] * (1 + ROUNDING)
    with_points, _ = remove_constant_offset(estimate, truth, all_pairs(FRAMES), points=True)
    squares = [((in_object(track) - in_object(truth)) ** 2).sum() for track in (aligned, with_points)]
    assert squares[1] <= squares[0] * (1 + ROUNDING)


@settings(deadline=None, max_examples=40)
@given(seeds)
def test_aligning_twice_changes_nothing_more(seed: int) -> None:
    truth = random_head(FRAMES, seed)
    once, _ = remove_constant_offset(shaken(truth, seed), truth, all_pairs(FRAMES), points=True)
    twice, note = remove_constant_offset(once, truth, all_pairs(FRAMES), points=True)
    np.testing.assert_allclose(of(twice.position), of(once.position), atol=ROUNDING)
    np.testing.assert_allclose(of(twice.points), of(once.points), atol=ROUNDING)
    removed, of_points = note.split("; ")
    assert removed == "removed constant rigid offset: 0.0 0.0 0.0 mm, 0.0 deg"
    assert of_points == "removed constant offset of each point: up to 0.0 mm"


def test_the_note_tells_the_offset() -> None:
    truth = random_head(FRAMES)
    turn = Rotation.from_rotvec(np.radians([0.0, 2.3, 0.0]))
    # the estimate's frame is truth * X^-1, so what is removed is X
    shift = np.array([1.2, -0.4, 3.1])
    estimate = offset_by(truth, turn.inv(), -turn.inv().apply(shift))
    _, note = remove_constant_offset(estimate, truth, all_pairs(FRAMES))
    assert note == "removed constant rigid offset: 1.2 -0.4 3.1 mm, 2.3 deg"


def test_points_stay_in_the_camera_and_move_in_the_head() -> None:
    truth = random_head(FRAMES)
    turn, shift = planted(1)
    estimate = offset_by(truth, turn, shift)
    aligned, _ = remove_constant_offset(estimate, truth, all_pairs(FRAMES))
    np.testing.assert_array_equal(of(aligned.points), of(estimate.points))
    own = in_object(estimate).reshape(-1, 3)
    # what is removed is the inverse of what was planted: X^-1 m = R m + s
    np.testing.assert_allclose(in_object(aligned).reshape(-1, 3), turn.apply(own) + shift, atol=ROUNDING)


@settings(deadline=None, max_examples=40)
@given(seeds)
def test_each_point_s_own_offset_is_removed(seed: int) -> None:
    truth = random_head(FRAMES, seed)
    marked = 5.0 * np.random.default_rng(seed).standard_normal((len(truth.point_names), 3))
    turned = Rotation.from_quat(np.repeat(of(truth.quaternion), len(marked), axis=0))
    moved = turned.apply(np.tile(marked, (FRAMES, 1))).reshape(FRAMES, -1, 3)
    estimate = replace(offset_by(truth, *planted(seed)), points=of(truth.points) + moved)
    aligned, note = remove_constant_offset(estimate, truth, all_pairs(FRAMES), points=True)
    np.testing.assert_allclose(of(aligned.points), of(truth.points), atol=ROUNDING)
    largest = np.linalg.norm(marked, axis=1).max()
    assert note.endswith(f"; removed constant offset of each point: up to {largest:.1f} mm")


def motion(seconds: FloatArray) -> tuple[Rotation, FloatArray]:
    """A smooth motion of a body: its rotation and position."""
    s = seconds
    turn = Rotation.from_euler("xyz", np.stack([0.4 * np.sin(s), 0.7 * s, np.cos(2 * s)], axis=1))
    return turn, np.stack([100 * np.sin(s), 50 * np.cos(3 * s), 700 + 20 * s], axis=1)


def moving(seconds: FloatArray, turn: Rotation, shift: FloatArray) -> Track:
    """That motion told by another frame of the same body; velocities by central differences."""
    h = 1e-5

    def pose(s: FloatArray) -> tuple[Rotation, FloatArray]:
        body_turn, position = motion(s)
        return body_turn * turn, position + body_turn.apply(shift)

    (before, p), (now, q), (after, r) = (pose(seconds + d) for d in (-h, 0.0, h))
    twist = np.hstack([(r - p) / (2 * h), (before.inv() * after).as_rotvec() / (2 * h)])
    return Track(
        "moving",
        "head",
        (),
        (),
        (),
        stamp_ns=(1e9 * seconds).astype(np.int64),
        position=q,
        quaternion=rotations.canonical(now.as_quat()),
        twist=twist,
    )


@pytest.mark.parametrize("seed", range(5))
def test_velocities_are_those_of_the_new_frame(seed: int) -> None:
    """Central differences of 1e-5 s: errors h^2 x third derivatives (some 1e4) and eps x 1000 / h, 1e-5."""
    seconds = np.linspace(0.0, 3.0, FRAMES)
    truth = moving(seconds, Rotation.identity(), np.zeros(3))
    estimate = moving(seconds, *planted(seed))
    aligned, _ = remove_constant_offset(estimate, truth, all_pairs(FRAMES))
    np.testing.assert_allclose(of(aligned.twist), of(truth.twist), atol=1e-5)
    assert np.abs(of(estimate.twist) - of(truth.twist)).max() > 10.0


def test_shape_rates_and_unknown_velocities_stay() -> None:
    truth = random_hand(FRAMES)
    twist = of(truth.twist).copy()
    twist[3] = np.nan
    estimate = replace(offset_by(truth, *planted(2)), twist=twist)
    aligned, _ = remove_constant_offset(estimate, truth, all_pairs(FRAMES))
    np.testing.assert_array_equal(of(aligned.twist)[:, 6:], twist[:, 6:])
    assert np.isnan(of(aligned.twist)).all(axis=1).tolist() == [i == 3 for i in range(FRAMES)]
    assert remove_constant_offset(replace(estimate, twist=None), truth, all_pairs(FRAMES))[0].twist is None


@pytest.mark.parametrize("field", ["pose_variance", "twist_variance"])
def test_variances_are_those_of_perturbed_poses(field: str) -> None:
    """Against the map of tangent vectors, numerically: new = J old, var new = diag(J diag(var) J^T)."""
    truth = random_head(FRAMES)
    turn, shift = planted(3)
    estimate = offset_by(truth, turn.inv(), -turn.inv().apply(shift))
    aligned, _ = remove_constant_offset(estimate, truth, all_pairs(FRAMES))
    h = 1e-6
    for row in range(0, FRAMES, 7):
        pose = Rotation.from_quat(of(estimate.quaternion)[row])
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = np.eye(3)
        for axis in range(3):
            small = Rotation.from_rotvec(h * np.eye(3)[axis])
            jacobian[:3, 3 + axis] = ((pose * small).apply(shift) - pose.apply(shift)) / h
            jacobian[3:, 3 + axis] = ((pose * turn).inv() * (pose * small * turn)).as_rotvec() / h
        variance = of(getattr(estimate, field))[row]
        expected = np.diag(jacobian @ np.diag(variance[:6]) @ jacobian.T)
        # one-sided differences: h x second derivative, 1e-6 relative
        np.testing.assert_allclose(of(getattr(aligned, field))[row, :6], expected, rtol=1e-4)
        np.testing.assert_array_equal(of(getattr(aligned, field))[row, 6:], variance[6:])


def test_the_estimate_itself_is_left_as_it_is() -> None:
    track, truth = random_head(5, 1), random_head(5, 2)
    fields = ("position", "quaternion", "twist", "pose_variance", "twist_variance", "points")
    before = {name: of(getattr(track, name)).copy() for name in fields}
    remove_constant_offset(track, truth, all_pairs(5), points=True)
    for name in fields:
        np.testing.assert_array_equal(getattr(track, name), before[name])


def test_only_the_pairs_count() -> None:
    truth = random_head(FRAMES)
    estimate = offset_by(truth, *planted(4))
    wild = of(estimate.position).copy()
    wild[10:] += 500.0
    rows = np.arange(10, dtype=np.int64)
    aligned, _ = remove_constant_offset(replace(estimate, position=wild), truth, Pairs(rows, rows))
    np.testing.assert_allclose(of(aligned.position)[:10], of(truth.position)[:10], atol=ROUNDING)


def test_lost_frames_say_nothing_about_the_offset_but_are_aligned_too() -> None:
    truth = random_head(FRAMES)
    estimate = offset_by(truth, *planted(5))
    lost = np.arange(FRAMES) >= 30
    wild = of(estimate.position) + 500.0 * lost[:, None]
    aligned, _ = remove_constant_offset(replace(estimate, position=wild, lost=lost), truth, all_pairs(FRAMES))
    np.testing.assert_allclose(
        of(aligned.position) - 500.0 * lost[:, None], of(truth.position), atol=ROUNDING
    )
    everything_lost = replace(estimate, lost=np.ones(FRAMES, dtype=np.bool_))
    aligned, _ = remove_constant_offset(everything_lost, truth, all_pairs(FRAMES))
    np.testing.assert_allclose(of(aligned.position), of(truth.position), atol=ROUNDING)


def test_without_a_pair_nothing_is_removed() -> None:
    truth = random_head(FRAMES)
    estimate = offset_by(truth, *planted(6))
    nothing = np.empty(0, dtype=np.int64)
    aligned, note = remove_constant_offset(estimate, truth, Pairs(nothing, nothing), points=True)
    assert aligned is estimate and note == "no constant offset removed: no frame has ground truth"


@pytest.mark.parametrize(
    ("lacking", "points", "message"),
    [
        (
            ("position", "quaternion"),
            False,
            "csv: cannot align: the ground truth has no position and no quaternion",
        ),
        (("quaternion",), False, "csv: cannot align: the ground truth has no quaternion; omit --align"),
        (("points",), True, "csv: cannot align: the ground truth has no points"),
    ],
)
def test_what_is_needed_is_named(lacking: tuple[str, ...], points: bool, message: str) -> None:
    whole: Any = random_head(FRAMES)
    truth = replace(whole, name="csv", **dict.fromkeys(lacking))
    with pytest.raises(UsageError, match=message):
        remove_constant_offset(whole, truth, all_pairs(FRAMES), points=points)


def test_points_of_other_names_cannot_be_aligned() -> None:
    head = random_head(FRAMES)
    other = replace(head, point_names=("a", "b", "c", "d"))
    with pytest.raises(UsageError, match="different points"):
        remove_constant_offset(head, other, all_pairs(FRAMES), points=True)
    remove_constant_offset(head, other, all_pairs(FRAMES))


def enlarged(track: Track, factor: float) -> Track:
    """The same head, so many times as large and as far away: one camera sees the same."""
    return replace(track, position=factor * of(track.position), points=factor * of(track.points))


@settings(deadline=None, max_examples=20)
@given(seeds, st.floats(0.5, 2.0))
def test_a_planted_scale_comes_back_exactly(seed: int, factor: float) -> None:
    truth = random_head(FRAMES, seed)
    turn, shift = planted(seed)
    estimate = enlarged(offset_by(truth, turn, shift), factor)
    aligned, note = remove_constant_offset(estimate, truth, all_pairs(FRAMES), scale=True)
    np.testing.assert_allclose(of(aligned.position), of(truth.position), atol=1e3 * ROUNDING)
    np.testing.assert_allclose(in_object(aligned), in_object(truth), atol=1e3 * ROUNDING)
    assert note.startswith(f"removed scale factor: {1.0 / factor:.4f}; removed constant rigid offset: ")


def test_no_other_scale_is_better() -> None:
    truth = random_head(12)
    estimate = shaken(enlarged(truth, 1.1), 5)
    best = cost(remove_constant_offset(estimate, truth, all_pairs(12), scale=True)[0], truth)[0]

    def translation(unknowns: FloatArray) -> float:
        return cost(offset_by(enlarged(estimate, unknowns[0]), Rotation.identity(), unknowns[1:]), truth)[0]

    assert best <= minimize(translation, [1.0, 0.0, 0.0, 0.0]).fun * (1 + 1e-6)


def test_what_hardly_moves_tells_no_scale() -> None:
    truth = random_head(FRAMES)
    still = replace(
        truth,
        position=np.tile(of(truth.position)[:1], (FRAMES, 1)),
        quaternion=np.tile(of(truth.quaternion)[:1], (FRAMES, 1)),
    )
    aligned, note = remove_constant_offset(enlarged(still, 1.1), still, all_pairs(FRAMES), scale=True)
    assert note.startswith("no scale removed: the object hardly moves; ")
    np.testing.assert_allclose(of(aligned.position), of(still.position), atol=ROUNDING)


def test_a_factor_that_explains_the_errors_is_remarked_and_others_are_not() -> None:
    truth = random_head(FRAMES)
    told = common_factor(shaken(enlarged(truth, 1.1), 1, sd_mm=1.0, sd_rad=0.0), truth, all_pairs(FRAMES))
    assert told.startswith("a scale factor of 0.909 would reduce") and "--align similarity" in told
    for other in (shaken(truth, 1), enlarged(truth, 1.01), shaken(enlarged(truth, 1.1), 1, sd_mm=200.0)):
        assert common_factor(other, truth, all_pairs(FRAMES)) == ""
