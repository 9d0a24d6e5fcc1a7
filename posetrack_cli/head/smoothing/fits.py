"""What the points of one frame say of a head's pose, for a smoother **[ours]**.

The tracker's own fit takes what a face does for what its model knows, and what the model does not know for a
turn of the head. Here each point lies about the neutral face beside that,

    p_k = R (m_k + V_k a + d_k) + t + e_k,    a ~ N(0, mu^2),    d_k ~ N(0, s_k^2),
    e_k ~ N(0, n^2 (1 - r r^T) + l^2 r r^T)

with s_k as far as points of its kind move in expressions, r the ray to the point, n the noise across it and l
that along it; of one camera l is without end. The deformation is integrated out of the pose's normal
equations; of several cameras, where it was learned from few frames, mu is 0 and s_k larger: measured, that is
nearer. Integrated over d_k the precision of a point is

    P_k = (1 - r r^T) / (s_k^2 + n^2) + r r^T / (s_k^2 + l^2)

and what it leaves is Student-t, so that a raised brow or a closed eye counts less the farther it goes:
w_k = (nu + D) / (nu + e^T P e), D = 3, or 2 of one camera. m is the face as the whole recording knows it in
the end: a face that is still being learnt would turn the head a little at each step.

Errors of neighbouring frames are alike, as expressions last and templates slide; so a frame's say is
lowered to ``SHARE``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.fit_smoothing import FitSmoother
from posetrack_cli.filtering.gaussian_smoothing import StateGaussian
from posetrack_cli.filtering.model import Dynamics
from posetrack_cli.filtering.modes import LikelihoodModes, scaled
from posetrack_cli.filtering.smoothing import Memory
from posetrack_cli.geometry.rotations import cross_matrices, matrices_from_quaternions
from posetrack_cli.head.config import HeadSmoothingSettings
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.tracker.estimates import UNKNOWN_SD
from posetrack_cli.head.tracks import TrackModel
from posetrack_cli.tracking.body_space import BodySpace

SPACE = BodySpace()
GROUPS = (np.arange(3), np.arange(3, POSE_SIZE))
"""Position and rotation are doubted apart: a blink moves a head without turning it."""
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
SHARE = 0.1
"""What a frame says counts by so much: errors of its neighbours are like its own."""
LEAST_WEIGHT = 0.02
"""Of a point that is hardly seen: ten of them still say where the head is."""


class NormalEquations(NamedTuple):
    """Of pose and deformation together.

    Attributes:
        gradient: (6 + B,) of the log-likelihood times the deformation's prior.
        information: (6 + B, 6 + B).
    """

    gradient: FloatArray
    information: FloatArray

    @property
    def without_deformation(self) -> tuple[FloatArray, FloatArray]:
        """Gradient (6,) and information (6, 6) of the pose, the deformation integrated out.

        g - H_pa H_aa^-1 g_a and H_pp - H_pa H_aa^-1 H_ap: the Schur complement.
        """
        first, rest = slice(POSE_SIZE), slice(POSE_SIZE, None)
        across = self.information[first, rest]
        onto = np.linalg.solve(self.information[rest, rest], across.T).T
        gradient: FloatArray = self.gradient[first] - onto @ self.gradient[rest]
        return gradient, self.information[first, first] - onto @ across.T

    def deformation_step(self, pose_step: FloatArray) -> FloatArray:
        """The step (B,) of the deformation that goes with one of the pose (6,)."""
        first, rest = slice(POSE_SIZE), slice(POSE_SIZE, None)
        left = self.gradient[rest] - self.information[rest, first] @ pose_step
        return np.asarray(np.linalg.solve(self.information[rest, rest], left), dtype=np.float64)


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
            joint = self._normal_equations(frame, pose, deformation)
            gradient, information = joint.without_deformation
            step = np.asarray(np.linalg.solve(information + vague, gradient), dtype=np.float64)
            deformation = deformation + joint.deformation_step(step)
            if np.abs(step).max() < CONVERGED:
                break
            pose = SPACE.retract(pose[None], step[None])[0]
        posed = _with_skin(pose, frame)
        by_points = scaled(_mode(posed, gradient, information + vague), SHARE)
        by_skin = frame["skin_share"] * np.diag(SKIN_SD**-2)
        return replace(by_points, information=by_points.information + by_skin)

    def _normal_equations(self, frame: Memory, pose: FloatArray, deformation: FloatArray) -> NormalEquations:
        """Return what the points say about a pose and a deformation (B,), each point reweighted."""
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
        return NormalEquations(gradient, information)

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
