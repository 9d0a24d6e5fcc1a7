"""Poses of a whole recording fitted together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.fit_smoothing import FitSmoother
from posetrack_cli.filtering.model import Dynamics
from posetrack_cli.filtering.modes import LikelihoodModes, scaled
from posetrack_cli.filtering.smoothing import Memory, Smoothed, StateGaussian
from posetrack_cli.geometry.least_squares import back_substituted
from posetrack_cli.geometry.rigid import in_camera, in_object
from posetrack_cli.geometry.rotations import cross_matrices, matrices_from_quaternions
from posetrack_cli.head.config import HeadSmoothingSettings
from posetrack_cli.head.face.points import POSE_SIZE, HeadPose
from posetrack_cli.head.subject import TrackModel
from posetrack_cli.head.tracker.head_tracker import UNKNOWN_SD
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.smoothing import FrameFacts
from posetrack_cli.tracking.velocity import BodySpace, pose_rates
from posetrack_cli.units import NS_PER_S

# Where a face's points are in a smoothed head, and which deformation that is **[ours]**.
#
# A point that was found in a frame is where it was found, whatever pose the head had: in the smoothed head it
# has another place, m_k + d_k. Of one camera it lies on its ray, as deep as the neutral face has it. These
# displacements move faster than the head, so each is smoothed by itself: at a frame it is the value of the
# line, by weighted least squares, through its neighbours (local linear regression; Cleveland 1979), weighted
# by how well the point was seen and by a Gaussian of the time between. Its slope is the displacement's rate.
#
# The deformation's coefficients are those that come nearest to the places:
#
#     a = argmin |V a - d|^2 / n^2 + sum_b (a_b / mu_b)^2


WINDOW_S = 0.05
"""Standard deviation of the Gaussian: places in the face are smoothed over so long."""
REACH = 3.0
"""Times the Gaussian's standard deviation: frames farther away do not count."""
LEAST_SHARE = 1e-3
"""Of the weight of a point that is not seen: alone it stays where the tracker left it."""
SLOPE_REGULARISATION = 0.01
"""Of the Gaussian's variance, added to that of the times: a frame without neighbours has a flat line."""


class PosedFrame(NamedTuple):
    """A frame whose pose is smoothed, and whose points are yet to be.

    Attributes:
        facts: what its estimate says of it.
        pose: (7,), with
        variance: (6,), and
        velocity: (6,), with
        velocity_variance: (6,).
        displacements: (K, 3) mm, d in the head's frame.
        weights: (K,) how much each counts.
        memory: the frame's, with the face.
    """

    facts: FrameFacts
    pose: FloatArray
    variance: FloatArray
    velocity: FloatArray
    velocity_variance: FloatArray
    displacements: FloatArray
    weights: FloatArray
    memory: Memory


def posed_frame(smoothed: Smoothed, facts: FrameFacts, memory: Memory, cameras: int) -> PosedFrame:
    """Return a frame with its smoothed pose; as its chain was gone through backwards, so are velocities."""
    pose, neutral = smoothed.pose, memory["neutral"]
    points = memory["points"]
    if cameras == 1:
        depths = in_camera(neutral, pose[:3], pose[3:7])[:, 2:]
        points = points * (depths / points[:, 2:])
    weights = np.maximum(memory["weights"] if memory["seen"] else 0.0, LEAST_SHARE) * np.ones(len(neutral))
    return PosedFrame(
        facts,
        pose,
        smoothed.pose_variance + memory["systematic"],
        -smoothed.velocity,
        smoothed.velocity_variance,
        in_object(points, pose[:3], pose[3:7]) - neutral,
        weights,
        memory,
    )


def with_smoothed_points(frames: Iterable[PosedFrame], origin: FloatArray) -> Iterator[Estimate]:
    """Yield the estimates of frames whose points are smoothed.

    Args:
        frames: in the order of time; those of other chains are no neighbours.
        origin: (B,) what the coefficients of the neutral face are called in results.
    """
    window, done = list[PosedFrame](), 0
    reach = REACH * WINDOW_S
    for frame in frames:
        if window and window[-1].memory["chain"] != frame.memory["chain"]:
            yield from (_estimate(window, index, origin) for index in range(done, len(window)))
            window, done = [], 0
        window.append(frame)
        while _seconds(window[done], frame) > reach:
            yield _estimate(window, done, origin)
            done += 1
        while _seconds(window[0], window[done]) > reach:
            window, done = window[1:], done - 1
    yield from (_estimate(window, index, origin) for index in range(done, len(window)))


def _seconds(earlier: PosedFrame, later: PosedFrame) -> float:
    return (later.facts.stamp_ns - earlier.facts.stamp_ns) / NS_PER_S


def _estimate(window: list[PosedFrame], index: int, origin: FloatArray) -> Estimate:
    """The estimate of one frame among its neighbours."""
    frame = window[index]
    displacements, rates = local_line(
        np.array([_seconds(frame, one) for one in window]),
        np.array([one.displacements for one in window]),
        np.array([one.weights for one in window]),
        WINDOW_S,
    )
    coefficients, coefficient_rates, variance = _deformation(frame.memory, displacements, rates)
    twist = np.concatenate([frame.velocity, coefficient_rates])
    pose = np.concatenate([frame.pose, origin + coefficients])
    places = frame.memory["neutral"] + displacements
    return Estimate(
        **frame.facts._asdict(),
        position=pose[:3],
        quaternion=pose[3:7],
        shape=pose[7:],
        pose_rate=pose_rates(pose, twist),
        twist=twist,
        pose_variance=np.concatenate([frame.variance, variance]),
        twist_variance=np.concatenate([frame.velocity_variance, variance / WINDOW_S**2]),
        points=in_camera(places, pose[:3], pose[3:7]),
        effective_sample_size=None,
        resampled=False,
    )


def local_line(
    times: FloatArray, values: FloatArray, weights: FloatArray, width: float
) -> tuple[FloatArray, FloatArray]:
    """Return value and slope at time 0 of the lines through K points' values, each (K, D).

    Args:
        times: (N,) s.
        values: (N, K, D).
        weights: (N, K), above 0 for some frame of each point.
        width: of the Gaussian of times, s, one standard deviation.
    """
    shares = weights * np.exp(-0.5 * np.square(times / width))[:, None]
    zeroth, first = shares.sum(axis=0)[:, None], (times @ shares)[:, None]
    second = (np.square(times) @ shares)[:, None] + SLOPE_REGULARISATION * width**2 * zeroth
    sums = np.einsum("nk,nkd->kd", shares, values)
    moments = np.einsum("n,nk,nkd->kd", times, shares, values)
    determinant = zeroth * second - first**2
    return (second * sums - first * moments) / determinant, (zeroth * moments - first * sums) / determinant


def _deformation(
    memory: Memory, displacements: FloatArray, rates: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the coefficients (B,) of displacements (K, 3), their rates and their variances."""
    basis = memory["basis"].reshape(displacements.size, -1)
    precision = np.maximum(memory["deviations"], LEAST_DEVIATION_MM) ** -2
    information = basis.T @ basis / NOISE_MM**2 + np.diag(precision)
    covariance = np.linalg.inv(information)
    onto = covariance @ basis.T / NOISE_MM**2
    return onto @ displacements.ravel(), onto @ rates.ravel(), np.diag(covariance).copy()


# What the points of one frame say of a head's pose, for a smoother **[ours]**.
#
# The tracker's own fit takes what a face does for what its model knows, and what the model does not know for
# a turn of the head. Here each point lies about the neutral face beside that,
#
#     p_k = R (m_k + V_k a + d_k) + t + e_k,    a ~ N(0, mu^2),    d_k ~ N(0, s_k^2),
#     e_k ~ N(0, n^2 (1 - r r^T) + l^2 r r^T)
#
# with s_k as far as points of its kind move in expressions, r the ray to the point, n the noise across it and
# l that along it; of one camera l is without end. The deformation is integrated out of the pose's normal
# equations; of several cameras, where it was learned from few frames, mu is 0 and s_k larger: measured, that
# is nearer. Integrated over d_k the precision of a point is
#
#     P_k = (1 - r r^T) / (s_k^2 + n^2) + r r^T / (s_k^2 + l^2)
#
# and what it leaves is Student-t, so that a raised brow or a closed eye counts less the farther it goes: w_k
# = (nu + D) / (nu + e^T P e), D = 3, or 2 of one camera. m is the face as the whole recording knows it in the
# end: a face that is still being learnt would turn the head a little at each step.
#
# Errors of neighbouring frames are alike, as expressions last and templates slide; so a frame's say is
# lowered to ``INDEPENDENT_SHARE``.


SPACE = BodySpace()
GROUPS = (np.arange(3), np.arange(3, POSE_SIZE))
"""Position and rotation are doubted apart: a blink moves a head without turning it."""
_POSE, _DEFORMATION = slice(0, POSE_SIZE), slice(POSE_SIZE, None)
UNKNOWN_SPEED = np.repeat([500.0, 3.0], 3)
"""(6,) mm/s and rad/s, standard deviations at the end of a chain."""
STEPS, CONVERGED = 8, 1e-4
"""Gauss-Newton steps at most, and mm or rad that end them."""
LEAST_DEVIATION_MM = 1e-6
"""Of a component of the deformation: what is not known yet stays at 0."""
SKIN_SD = np.array([2.0, 2.0, 8.0, *np.radians([1.0, 1.0, 1.0])])
"""(6,) mm and rad, by how much a pose by the skin errs otherwise than those about it; chosen on twelve
rendered heads and three real ones. What all err by alike no smoothing takes away."""
NOISE_MM, DEPTH_NOISE_MM = 0.25, 0.5
"""n and l: of the points found, across the ray and, where several cameras see them, along it."""
FREEDOM = 4.0
"""nu, of the Student-t density of errors: the smaller, the more outliers."""
INDEPENDENT_SHARE = 0.1
"""What a frame says counts by so much: errors of its neighbours are like its own."""
LEAST_WEIGHT = 0.02
"""Of a point that is hardly seen: ten of them still say where the head is."""


class HeadFits:
    """The fits of frames (``filtering.fit_smoothing.FrameFits``).

    A frame's memory has the pose that was ``tracked`` (7,), ``points`` (K, 3), ``weights`` (K,), the
    ``neutral`` face (K, 3), the ``basis`` (K, 3, B) of its deformations with their ``deviations`` (B,), how
    far ``beside`` the pose of its points (6,) what it states is, by the skin, what ``skin_share`` of it is
    the skin's, and whether the head was ``seen``; where not, it says hardly more than nothing.

    Args:
        model: how faces move.
        cameras: how many see the head.
    """

    def __init__(self, model: TrackModel, cameras: int) -> None:
        self._deformation = model.deformation
        self._directions = 2 if cameras == 1 else 3
        self._moved = np.square(model.expression_mm)

    def known(self, frame: Memory) -> LikelihoodModes:
        """Return the fit that is found from the tracker's pose."""
        return self._fit(frame, frame["tracked"])

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        """Return the fit that is found from the pose that all other frames expect."""
        return self._fit(frame, belief.pose) if frame["seen"] else known

    def belief(self, frame: Memory) -> StateGaussian:
        """Return what a frame alone says: the end of a chain."""
        fit = self.known(frame)
        covariance = np.zeros((2 * POSE_SIZE, 2 * POSE_SIZE))
        covariance[:POSE_SIZE, :POSE_SIZE] = np.linalg.inv(fit.information[0])
        covariance[POSE_SIZE:, POSE_SIZE:] = np.diag(np.square(UNKNOWN_SPEED))
        return StateGaussian(fit.poses[0], np.zeros(POSE_SIZE), covariance)

    def _fit(self, frame: Memory, start: FloatArray) -> LikelihoodModes:
        vague = np.diag(UNKNOWN_SD**-2)
        if not frame["seen"]:
            return _mode(frame["tracked"], np.zeros(POSE_SIZE), vague)
        pose, deformation = start, np.zeros(frame["basis"].shape[-1])
        gradient, information = np.zeros(POSE_SIZE), vague
        for _ in range(STEPS):
            matrix, vector = self._normal_equations(frame, pose, deformation)
            across = matrix[_POSE, _DEFORMATION]  # integrated out: the Schur complement
            onto = np.linalg.solve(matrix[_DEFORMATION, _DEFORMATION], across.T).T
            gradient = vector[_POSE] - onto @ vector[_DEFORMATION]
            information = matrix[_POSE, _POSE] - onto @ across.T
            step = np.asarray(np.linalg.solve(information + vague, gradient), dtype=np.float64)
            deformation = deformation + back_substituted(matrix, vector, _POSE, _DEFORMATION, step)
            if np.abs(step).max() < CONVERGED:
                break
            pose = SPACE.retract(pose[None], step[None])[0]
        posed = _with_skin(pose, frame)
        by_points = scaled(_mode(posed, gradient, information + vague), INDEPENDENT_SHARE)
        by_skin = frame["skin_share"] * np.diag(SKIN_SD**-2)
        return replace(by_points, information=by_points.information + by_skin)

    def _normal_equations(
        self, frame: Memory, pose: FloatArray, deformation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what the points say about a pose and a deformation (B,) together, each point reweighted.

        Information (6 + B, 6 + B) and gradient (6 + B,) of the log-likelihood times the deformation's prior.
        """
        rotation, directions = matrices_from_quaternions(pose[3:7]), frame["basis"]
        shape = frame["neutral"] + directions @ deformation
        left = frame["points"] - shape @ rotation.T - pose[:3]
        jacobian = np.zeros((*shape.shape, POSE_SIZE + len(deformation)))
        jacobian[:, :, :3] = np.eye(3)
        jacobian[:, :, 3:POSE_SIZE] = -rotation @ cross_matrices(shape)
        jacobian[:, :, POSE_SIZE:] = rotation @ directions
        precision = self._precisions(frame["points"])
        squared = np.einsum("ki,kij,kj->k", left, precision, left)
        weights = np.maximum(frame["weights"], LEAST_WEIGHT)
        weights = weights * (FREEDOM + self._directions) / (FREEDOM + squared)
        says = np.einsum("k,kji,kjl->kil", weights, jacobian, precision)
        gradient, information = np.einsum("kij,kj->i", says, left), np.einsum("kij,kjl->il", says, jacobian)
        usual = np.maximum(self._deformation * frame["deviations"], LEAST_DEVIATION_MM) ** -2
        gradient[POSE_SIZE:] -= usual * deformation
        information[POSE_SIZE:, POSE_SIZE:] += np.diag(usual)
        return information, gradient

    def _precisions(self, points: FloatArray) -> FloatArray:
        """Return P_k, (K, 3, 3), of points (K, 3)."""
        rays = points / np.linalg.norm(points, axis=1, keepdims=True)
        along = rays[:, :, None] * rays[:, None, :]
        across = (np.eye(3) - along) / (self._moved + NOISE_MM**2)[:, None, None]
        if self._directions == 2:
            return np.asarray(across)
        precisions: FloatArray = across + along / (self._moved + DEPTH_NOISE_MM**2)[:, None, None]
        return precisions


def make_head_smoother(settings: HeadSmoothingSettings, fits: HeadFits) -> FitSmoother:
    """Return the smoother of poses: velocities wander, and fits that contradict all others are doubted.

    A head that moves fast also changes its velocity fast: with the frame's ``speed`` (2,), mm/s and rad/s,

        sd(velocity) = sqrt(least^2 + speed^2)    per square root of a second
    """
    least = np.array([settings.velocity_mm, settings.velocity_rad])

    def dynamics(frame: Memory) -> Dynamics:
        wandering = np.square(least) + np.square(frame["speed"])
        return Dynamics(np.zeros(POSE_SIZE), np.repeat(wandering, 3))

    return FitSmoother(dynamics, SPACE, fits, GROUPS, FREEDOM)


def _with_skin(pose: FloatArray, frame: Memory) -> FloatArray:
    """Return a pose (7,) between a fit of the points and the skin, as the one that the tracker stated is.

    Without skin it is the fit's, bit by bit.

    With s the skin's share, p the tracker's pose of the points, q the one it stated: q + (1 - s) (pose - p).
    """
    if not frame["beside"].any():
        return pose
    stated = HeadPose(frame["tracked"][:3], frame["tracked"][3:])
    by_points = stated.moved(-frame["beside"])
    apart = by_points.difference(HeadPose(pose[:3], pose[3:]))
    posed = stated.moved((1.0 - frame["skin_share"]) * apart)
    return np.concatenate([posed.position, posed.quaternion])


def _mode(pose: FloatArray, gradient: FloatArray, information: FloatArray) -> LikelihoodModes:
    symmetric = 0.5 * (information + information.T)
    return LikelihoodModes(pose[None], gradient[None], symmetric[None], np.zeros(1))
