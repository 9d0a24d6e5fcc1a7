"""A head's smoothed track: exact where heads move linearly, bridged where they are lost, robust to faces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.filtering.model import (
    Dynamics,
    Gaussian,
    constant_velocity,
    kalman_predict,
    kalman_smooth,
)
from posetrack_cli.geometry.rotations import angle_between, conjugate, exponential, logarithm, multiply
from posetrack_cli.head.actions import displacement
from posetrack_cli.head.config import HeadSmoothingSettings, HeadStereoConfig
from posetrack_cli.head.face.points import BROWS, MEAN_SHAPE, POINT_COUNT, HeadPose
from posetrack_cli.head.multilinear.face_model import load_face_model
from posetrack_cli.head.smoothing import fits as head_fits
from posetrack_cli.head.smoothing import frames as track
from posetrack_cli.head.smoothing.fits import (
    SKIN_SD,
    SLOPE_REGULARISATION,
    UNKNOWN_SPEED,
    HeadFits,
    local_line,
)
from posetrack_cli.head.smoothing.frames import GapLimit, HeadFrame, HeadMemory, Link, chained, with_speeds
from posetrack_cli.head.subject import MONO_TRACK, STEREO_TRACK, head_subject
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.smoothing import STATUSES
from support.kalman import kalman_update

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
"""A head that looks at the camera: y up is the camera's -y."""
FRAME_NS, COMPONENTS = 40_000_000, 2
SUBJECT = head_subject("left", COMPONENTS)
REACH = GapLimit(0.2)


def frame(index: int, position: FloatArray, lost: bool = False, **changes: object) -> HeadFrame:
    pose = HeadPose(np.asarray(position, dtype=float), UPRIGHT)
    made = HeadFrame(
        index,
        index * FRAME_NS,
        STATUSES.index(Status.LOST if lost else Status.TRACKING),
        0.0 if lost else 0.9,
        0,
        pose.position,
        pose.quaternion,
        pose.points(MEAN_SHAPE),
        np.ones(POINT_COUNT),
        MEAN_SHAPE,
        np.zeros((POINT_COUNT, 3, COMPONENTS)),
        np.zeros(COMPONENTS),
    )
    return replace(made, **changes)


class Written:
    """Takes the smoothed track, as a result's writer does."""

    def __init__(self) -> None:
        self.estimates: list[Estimate] = []

    def write_smoothed(self, estimate: Estimate, vertices: None = None, subject: int = 0) -> None:
        self.estimates.append(estimate)


def smoothed(tmp_path, frames: Iterable[HeadFrame]) -> list[Estimate]:
    written = Written()
    with HeadMemory(tmp_path / "frames", HeadStereoConfig(), SUBJECT, 2, np.zeros(COMPONENTS)) as memory:
        for one in frames:
            memory._spool.append(one.record)
        memory.finish(written)
    assert not list(tmp_path.iterdir())
    return written.estimates


# Where heads move linearly, against Rauch, Tung and Striebel


CLOSE = 1e-4
"""mm, and radians: turns are held near 0 by points that only move along, to the square of what is left."""


def memory_of(one: HeadFrame) -> dict[str, object]:
    pose = np.concatenate([one.position, one.quaternion])
    face = {"neutral": one.mean, "basis": one.basis, "deviations": one.deviations}
    seen = {**face, "seen": int(not one.is_lost)}
    tracked = {"tracked": pose, "beside": one.beside, "skin_share": one.skin_share}
    return {**tracked, "points": one.points, "weights": one.weights, **seen}


def exactly(frames: list[HeadFrame]) -> list[Gaussian]:
    """Positions, turns from upright and their velocities, backwards in time as the smoother goes."""
    fits, settings = HeadFits(STEREO_TRACK, 2), HeadSmoothingSettings()
    wandering = np.square(np.repeat([settings.velocity_mm, settings.velocity_rad], 3))
    dt = FRAME_NS * 1e-9
    F, Q = constant_velocity(Dynamics(np.zeros(6), wandering).over(dt), dt)
    beliefs: list[Gaussian] = []
    for one in frames[::-1]:
        seen = np.concatenate([one.position, np.zeros(3)])
        noise = np.linalg.inv(fits.known(memory_of(one)).information[0])
        if beliefs:
            expected = kalman_predict(beliefs[-1], F, Q)
            beliefs.append(kalman_update(expected, seen, np.eye(6, 12), noise)[0])
            continue
        covariance = np.zeros((12, 12))
        covariance[:6, :6], covariance[6:, 6:] = noise, np.diag(np.square(UNKNOWN_SPEED))
        beliefs.append(Gaussian(np.concatenate([seen, np.zeros(6)]), covariance))
    way = [beliefs[-1]]
    for one in beliefs[-2::-1]:
        way.append(kalman_smooth(one, way[-1], F, Q))
    return way


def test_heads_that_move_along_are_smoothed_exactly(tmp_path, monkeypatch) -> None:
    """Where nothing is doubted, and the noise is the same everywhere."""
    monkeypatch.setattr(head_fits, "FREEDOM", 1e6)
    monkeypatch.setattr(track, "with_speeds", lambda links: links)
    rng = np.random.default_rng(2)
    places = np.array([3.0, -2.0, 700.0]) + np.cumsum(rng.normal(0.0, 1.0, (12, 3)), axis=0)
    frames = [frame(index, place, lost=index in (5, 6)) for index, place in enumerate(places)]
    found = smoothed(tmp_path, frames)
    for one, expected in zip(found, exactly(frames), strict=True):
        np.testing.assert_allclose(one.position, expected.mean[:3], atol=CLOSE)
        np.testing.assert_allclose(one.pose_variance[:6], np.diag(expected.covariance)[:6], rtol=0.01)
        turned = logarithm(multiply(conjugate(UPRIGHT), one.quaternion))
        np.testing.assert_allclose(turned, expected.mean[3:6], atol=CLOSE)
    assert [one.status for one in found].count(Status.LOST) == 2
    assert [one.frame_index for one in found] == list(range(12))


# What is robust


def test_a_raised_brow_does_not_turn_the_head(monkeypatch) -> None:
    """As the filter's model would have it: the brows weigh as much as the eyes, and a turn explains them."""
    moved = MEAN_SHAPE.copy()
    moved[BROWS, 1] += 5.0
    pose = HeadPose(np.array([0.0, 0.0, 700.0]), UPRIGHT)
    raised = frame(0, pose.position, points=pose.points(moved))
    stiff = STEREO_TRACK.expression_mm.copy()
    stiff[BROWS] = 0.3
    turns = []
    for model, freedom in (
        (STEREO_TRACK, head_fits.FREEDOM),
        (replace(STEREO_TRACK, expression_mm=stiff), 1e6),
    ):
        monkeypatch.setattr(head_fits, "FREEDOM", freedom)
        fit = HeadFits(model, 1).known(memory_of(raised))
        turns.append(float(np.degrees(angle_between(UPRIGHT, fit.poses[0][3:7]))))
    assert turns[0] < 1.0
    assert turns[1] > 3.0 * turns[0]


@pytest.mark.parametrize("cameras", [1, 2])
def test_points_of_a_rigid_face_give_their_pose(cameras: int) -> None:
    turned = multiply(exponential(np.array([0.1, 0.3, -0.2])), UPRIGHT)
    true = HeadPose(np.array([20.0, -10.0, 650.0]), turned)
    one = frame(0, true.position + 5.0, points=true.points(MEAN_SHAPE))
    fit = HeadFits(STEREO_TRACK, cameras).known(memory_of(one))
    np.testing.assert_allclose(fit.poses[0][:3], true.position, atol=0.01)
    assert np.degrees(angle_between(true.quaternion, fit.poses[0][3:7])) < 0.01


@pytest.mark.parametrize("share", [0.25, 0.9, 1.0])
def test_a_fit_lies_between_points_and_skin_as_what_was_stated_did(share: float) -> None:
    """The filter had the points elsewhere; where the skin is both say alike. All turns are about one axis."""
    one = frame(0, np.array([20.0, -10.0, 650.0]))
    fits = HeadFits(MONO_TRACK, 1)
    fit = HeadPose(*np.split(fits.known(memory_of(one)).poses[0], [3]))
    by_filter = fit.moved(np.array([0.5, 0.2, -3.0, 0.0, 0.02, 0.0]))
    by_skin = fit.moved(np.array([1.0, -2.0, 4.0, 0.0, -0.05, 0.0]))
    beside = share * by_filter.difference(by_skin)
    stated = by_filter.moved(beside)
    told = {"position": stated.position, "quaternion": stated.quaternion}
    points = replace(one, **told, beside=beside, skin_share=share)
    found = HeadPose(*np.split(fits.known(memory_of(points)).poses[0], [3]))
    np.testing.assert_allclose(fit.difference(found), share * fit.difference(by_skin), atol=CLOSE)


def test_what_the_skin_tells_counts_beside_the_points() -> None:
    """In full where the pose is the skin's alone, in proportion where it is in part."""
    one = frame(0, np.array([20.0, -10.0, 650.0]))
    fits = HeadFits(MONO_TRACK, 1)
    alone, part, whole = (
        fits.known(memory_of(replace(one, skin_share=share))).information[0] for share in (0.0, 0.25, 1.0)
    )
    np.testing.assert_allclose(whole - alone, np.diag(SKIN_SD**-2), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(part - alone, 0.25 * (whole - alone), rtol=1e-9, atol=1e-9)


def test_a_head_that_turns_fast_is_followed_by_its_skin(tmp_path) -> None:
    """By 20 degrees to the side and back within .4 s: by points alone it is rounded off more."""
    yaw = np.radians(20.0) * np.exp(-0.5 * ((np.arange(25) - 12.0) / 2.5) ** 2)
    poses = [multiply(exponential(np.array([0.0, angle, 0.0])), UPRIGHT) for angle in yaw]
    away = []
    for share in (0.0, 1.0):
        frames = []
        for index, quaternion in enumerate(poses):
            true = HeadPose(np.array([0.0, 0.0, 700.0]), quaternion)
            made = frame(index, true.position, points=true.points(MEAN_SHAPE))
            frames.append(replace(made, quaternion=quaternion, skin_share=share))
        found = smoothed(tmp_path, frames)
        away.append([angle_between(q, one.quaternion) for q, one in zip(poses, found, strict=True)])
    assert max(away[1]) < max(away[0]) and np.mean(away[1]) < np.mean(away[0])


def test_one_wild_frame_is_not_believed(tmp_path) -> None:
    rng = np.random.default_rng(4)
    places = np.array([0.0, 0.0, 700.0]) + np.outer(np.arange(15), [1.0, 0.5, 0.0])
    seen = places + rng.normal(0.0, 0.1, places.shape)
    seen[7] += [15.0, 0.0, 0.0]
    found = smoothed(tmp_path, [frame(index, place) for index, place in enumerate(seen)])
    errors = np.linalg.norm([one.position - place for one, place in zip(found, places, strict=True)], axis=1)
    assert errors.max() < 1.0


def test_what_the_whole_track_is_wrong_by_stays_in_its_variances(tmp_path) -> None:
    unknown = np.array([9.0, 9.0, 400.0, 0.0, 0.01, 0.0])
    stated = []
    for more in (0.0, 1.0):
        frames = [frame(index, HERE, systematic=more * unknown) for index in range(5)]
        stated.append(smoothed(tmp_path, frames)[2].pose_variance[:6])
    np.testing.assert_allclose(stated[1] - stated[0], unknown, rtol=1e-6, atol=1e-12)


def test_frames_that_no_run_wrote_are_refused(tmp_path) -> None:
    wrong = replace(frame(1, np.zeros(3)), quaternion=np.zeros(4))
    with pytest.raises(ResultError, match="spool cannot be used, found 'quaternion' has vectors"):
        smoothed(tmp_path, [frame(0, np.zeros(3) + 700.0), wrong])


def test_a_mouth_that_goes_aside_turns_no_head() -> None:
    """A known deformation is integrated out; left out, it was taken for a turn where points count closely."""
    model = load_face_model()
    person = model.of_person(model.identity_mean)
    moved = person.mean + 0.7 * displacement("mouth_left")
    face = {"mean": person.mean, "basis": person.basis, "deviations": person.deviations}
    aside = frame(0, HERE, points=HeadPose(HERE, UPRIGHT).points(moved), **face)
    turned = []
    for tracker in (MONO_TRACK, replace(MONO_TRACK, deformation=0.0)):
        fit = HeadFits(tracker, 1).known(memory_of(aside))
        best = exponential(np.linalg.solve(fit.information[0], fit.gradients[0])[3:])
        turned.append(float(np.degrees(angle_between(multiply(best, fit.poses[0, 3:7]), UPRIGHT))))
    assert turned[0] < 1.0 < 3.0 < turned[1]


# Which frames are of one chain


def begins(frames: list[HeadFrame]) -> list[bool]:
    """Whether a chain ends at a frame, in the order of time."""
    return [link.begins for link in chained(frames[::-1], REACH)][::-1]


HERE = np.array([0.0, 0.0, 700.0])


def test_short_losses_are_bridged_and_long_ones_are_not() -> None:
    lost = {2, 3, 6, 7, 8, 9, 10, 11, 12}
    frames = [frame(index, HERE, lost=index in lost) for index in range(16)]
    assert begins(frames) == [index == 5 or 6 <= index <= 12 or index == 15 for index in range(16)]


def test_losses_at_either_end_belong_to_no_chain() -> None:
    frames = [frame(index, HERE, lost=index not in (2, 3, 4)) for index in range(7)]
    assert begins(frames) == [True, True, False, False, True, True, True]


def test_another_person_and_a_jump_begin_another_chain() -> None:
    another = [frame(index, HERE, person=index // 2) for index in range(4)]
    assert begins(another) == [False, True, False, True]
    jump = [frame(index, HERE + (200.0 if index > 1 else 0.0)) for index in range(4)]  # 5 m/s
    assert begins(jump) == [False, True, False, True]


def test_what_is_lost_for_long_stays_where_the_tracker_left_it(tmp_path) -> None:
    frames = [frame(index, HERE + index, lost=index > 4) for index in range(12)]
    found = smoothed(tmp_path, frames)
    for one, kept in zip(found[5:], frames[5:], strict=True):
        np.testing.assert_allclose(one.position, kept.position, atol=1e-9)
        np.testing.assert_allclose(one.points, kept.points, atol=1e-9)
        assert one.pose_variance[0] > 1e4


def test_speed_is_that_of_the_frames_around() -> None:
    frames = [frame(index, HERE + np.array([2.0 * index, 0.0, 0.0])) for index in range(12)]
    frames[5] = frame(5, HERE + 30.0)
    links = list(with_speeds(Link(one, begins=one.frame_index in (3, 11)) for one in frames[::-1]))[::-1]
    speeds = np.array([link.speed[0] for link in links])
    np.testing.assert_allclose(speeds[[0, 1, 4, 6, 7, 9, 10, 11]], 50.0)
    assert [link.frame.frame_index for link in links] == list(range(12))


# Places


def test_lines_stay_lines_and_one_frame_stays_where_it_is() -> None:
    times = np.array([-0.1, -0.03, 0.0, 0.05, 0.07])
    lines = np.array([[1.0, 2.0, 3.0], [0.0, -4.0, 5.0]])
    values = lines + times[:, None, None] * 10.0
    value, slope = local_line(times, values, np.full((5, 2), 0.5), 0.05)
    np.testing.assert_allclose(value, lines, atol=0.01)  # the slope's share that is missing, times .04 s
    np.testing.assert_allclose(slope, 10.0, rtol=3.0 * SLOPE_REGULARISATION)
    alone, flat = local_line(np.zeros(1), lines[None], np.ones((1, 2)), 0.05)
    np.testing.assert_allclose(flat, 0.0, atol=1e-9)
    np.testing.assert_allclose(alone, lines)


def test_a_mouth_that_moves_is_followed_and_its_noise_is_not(tmp_path) -> None:
    rng, frames = np.random.default_rng(6), []
    opened = 8.0 * np.sin(np.arange(40) / 6.0)
    for index, wide in enumerate(opened):
        shape = MEAN_SHAPE + rng.normal(0.0, 0.3, MEAN_SHAPE.shape)
        shape[4:6, 0] += [-wide, wide]
        frames.append(frame(index, HERE, points=HeadPose(HERE, UPRIGHT).points(shape)))
    basis = np.zeros((POINT_COUNT, 3, COMPONENTS))
    basis[4, 0, 0], basis[5, 0, 0] = -np.sqrt(0.5), np.sqrt(0.5)
    frames = [replace(one, basis=basis, deviations=np.array([5.0, 0.0])) for one in frames]
    found = smoothed(tmp_path, frames)
    mouths = np.array([one.points[5, 0] - one.points[4, 0] for one in found]) / 2.0
    np.testing.assert_allclose(mouths[3:-3], MEAN_SHAPE[5, 0] + opened[3:-3], atol=1.0)
    coefficients = np.array([one.shape for one in found])
    np.testing.assert_allclose(coefficients[3:-3, 0], np.sqrt(2.0) * opened[3:-3], atol=1.5)
    assert not coefficients[:, 1].any()
    raw = np.array([one.points[0] for one in frames])
    still = np.array([one.points[0] for one in found])
    assert np.std(np.diff(still, axis=0)) < 0.3 * np.std(np.diff(raw, axis=0))
