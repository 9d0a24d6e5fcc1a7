"""Refits of single frames, and smoothing of the points in a smoothed head."""

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

# Points and deformation in a smoothed head **[ours]**.
#
# Detected points keep their place in space, so they have other coordinates m_k + d_k in the smoothed head.
# With one camera a point lies on its ray at the neutral face's depth. The displacements change faster than
# the pose and are smoothed individually by local linear regression (Cleveland 1979), weighted by visibility
# and a Gaussian of the time difference. The slope is the displacement's rate.
#
# The deformation coefficients fit the displacements:
#
#     a = argmin |V a - d|^2 / n^2 + sum_b (a_b / mu_b)^2


WINDOW_S = 0.05
"""Standard deviation of the Gaussian in time."""
REACH = 3.0
"""Support of the Gaussian, in standard deviations."""
LEAST_SHARE = 1e-3
"""Weight of a hidden point: without visible neighbours it keeps the tracker's place."""
SLOPE_REGULARISATION = 0.01
"""Added to the variance of the times, relative to the Gaussian's: without neighbours the slope is 0."""


class PosedFrame(NamedTuple):
    """A frame with a smoothed pose, before its points are smoothed.

    Attributes:
        facts: of its estimate.
        pose: (7,).
        variance: (6,) of the pose.
        velocity: (6,).
        velocity_variance: (6,).
        displacements: (K, 3) mm, d in the head's frame.
        weights: (K,) of the points.
        memory: stored data of the frame, with the face.
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
    """Return a frame with its smoothed pose; velocities are reversed, as is the chain."""
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
    """Yield the estimates of frames with smoothed points.

    Args:
        frames: in the order of time; frames of other chains are not neighbours.
        origin: (B,) coefficients of the neutral face in results.
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
    """Return the estimate of one frame, given its neighbours."""
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
        weights: (N, K), above 0 in at least one frame of each point.
        width: standard deviation of the Gaussian in time, s.
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


# Fit of a single frame, as input of the smoother **[ours]**.
#
# The tracker's own fit attributes deformations that the model lacks to rotations of the head. Here each point
# also deviates individually from the model:
#
#     p_k = R (m_k + V_k a + d_k) + t + e_k,    a ~ N(0, mu^2),    d_k ~ N(0, s_k^2),
#     e_k ~ N(0, n^2 (1 - r r^T) + l^2 r r^T)
#
# with s_k the motion of its kind of point in expressions, r the ray to the point, n the noise across it and l
# that along it, infinite with one camera. The deformation is marginalised out of the pose's normal equations.
# With several cameras, where it was learned from few frames, mu is 0 and s_k larger, which is more accurate.
# Marginalised over d_k, the precision of a point is
#
#     P_k = (1 - r r^T) / (s_k^2 + n^2) + r r^T / (s_k^2 + l^2)
#
# and the residual is Student-t, which down-weights a raised brow or a closed eye:
# w_k = (nu + D) / (nu + e^T P e), D = 3, or 2 with one camera. m is the face learned by the end of the
# recording; a face still being learned would rotate the head slightly with each update.
#
# Errors of neighbouring frames are correlated, because expressions last and templates slide, so the
# information of a frame is scaled by ``INDEPENDENT_SHARE``.

SPACE = BodySpace()
GROUPS = (np.arange(3), np.arange(3, POSE_SIZE))
"""Position and rotation are down-weighted separately: a blink shifts a head without rotating it."""
_POSE, _DEFORMATION = slice(0, POSE_SIZE), slice(POSE_SIZE, None)
UNKNOWN_SPEED = np.repeat([500.0, 3.0], 3)
"""(6,) mm/s and rad/s, standard deviations at the end of a chain."""
STEPS, CONVERGED = 8, 1e-4
"""Maximum number of Gauss-Newton steps, and convergence threshold, mm or rad."""
LEAST_DEVIATION_MM = 1e-6
"""Of a deformation component: unknown components stay at 0."""
SKIN_SD = np.array([2.0, 2.0, 8.0, *np.radians([1.0, 1.0, 1.0])])
"""(6,) mm and rad, frame-to-frame errors of a pose from skin; smoothing does not reduce common errors."""
NOISE_MM, DEPTH_NOISE_MM = 0.25, 0.5
"""n and l: noise of the points across the ray and, with several cameras, along it."""
FREEDOM = 4.0
"""nu, of the Student-t density of errors; smaller values allow more outliers."""
INDEPENDENT_SHARE = 0.1
"""Factor on the information of a frame, because errors of neighbouring frames are correlated."""
LEAST_WEIGHT = 0.02
"""Of a hardly visible point: ten of them still determine the pose."""


class HeadFits:
    """Fits of frames (``filtering.fit_smoothing.FrameFits``).

    A frame's memory contains the ``tracked`` pose (7,), ``points`` (K, 3), ``weights`` (K,), the ``neutral``
    face (K, 3), the ``basis`` (K, 3, B) of its deformations with their ``deviations`` (B,), the tangent
    vector ``beside`` (6,) from the pose of the points to the reported one, the ``skin_share`` of the latter,
    and whether the head was ``seen``; an unseen frame has almost no information.

    Args:
        model: motion model of the tracker.
        cameras: number of cameras.
    """

    def __init__(self, model: TrackModel, cameras: int) -> None:
        self._deformation = model.deformation
        self._directions = 2 if cameras == 1 else 3
        self._moved = np.square(model.expression_mm)

    def known(self, frame: Memory) -> LikelihoodModes:
        """Return the fit that starts from the tracker's pose."""
        return self._fit(frame, frame["tracked"])

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        """Return the fit that starts from the prediction of all other frames."""
        return self._fit(frame, belief.pose) if frame["seen"] else known

    def belief(self, frame: Memory) -> StateGaussian:
        """Return the state from a frame alone, at the end of a chain."""
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
            across = matrix[_POSE, _DEFORMATION]  # marginalised by the Schur complement
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
        """Return the equations of pose and deformation (B,), with each point reweighted.

        Information (6 + B, 6 + B) and gradient (6 + B,) of the log-likelihood and the deformation's
        log-prior.
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
    """Return the pose smoother, with random-walk velocities and robust fits.

    Fast heads also accelerate more: with the frame's ``speed`` (2,), mm/s and rad/s,

        sd(velocity) = sqrt(least^2 + speed^2)    per square root of a second
    """
    least = np.array([settings.velocity_mm, settings.velocity_rad])

    def dynamics(frame: Memory) -> Dynamics:
        wandering = np.square(least) + np.square(frame["speed"])
        return Dynamics(np.zeros(POSE_SIZE), np.repeat(wandering, 3))

    return FitSmoother(dynamics, SPACE, fits, GROUPS, FREEDOM)


def _with_skin(pose: FloatArray, frame: Memory) -> FloatArray:
    """Combine a fit (7,) of the points with the skin, like the reported pose of the tracker.

    Without skin the fit is returned unchanged, bit by bit.

    With s the skin's share, p the tracker's pose of the points, q the reported one: q + (1 - s) (pose - p).
    """
    if not frame["beside"].any():
        return pose
    reported = HeadPose(frame["tracked"][:3], frame["tracked"][3:])
    by_points = reported.moved(-frame["beside"])
    apart = by_points.difference(HeadPose(pose[:3], pose[3:]))
    posed = reported.moved((1.0 - frame["skin_share"]) * apart)
    return np.concatenate([posed.position, posed.quaternion])


def _mode(pose: FloatArray, gradient: FloatArray, information: FloatArray) -> LikelihoodModes:
    symmetric = 0.5 * (information + information.T)
    return LikelihoodModes(pose[None], gradient[None], symmetric[None], np.zeros(1))
