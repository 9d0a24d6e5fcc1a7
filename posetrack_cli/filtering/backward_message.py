"""What later frames say about a state: the backward half of a two-filter smoother, in information form.

The smoothed density of a frame is its prediction from the past times p(y_t, y_t+1, .. | x_t), and the latter
goes from frame to frame without a prior (Mayne 1966; Fraser and Potter 1969):

    log p(y_t+1, .. | x_t (+) e)  =  b . e - e^T L e / 2  + const.

L may be singular: one later frame says nothing about velocities. For linear-Gaussian models the product is
what the smoother of Rauch, Tung and Striebel (1965) yields; but here what all *other* frames expect of a
frame is at hand before its own likelihood is taken in, which may so be looked at again from there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.gaussian_smoothing import StateGaussian
from posetrack_cli.filtering.kalman import constant_velocity
from posetrack_cli.filtering.model import Dynamics, StateSpace
from posetrack_cli.filtering.modes import LikelihoodModes


@dataclass(frozen=True, eq=False)
class BackwardMessage:
    """A quadratic in (pose, velocity), the pose in the tangent space of a reference.

    Attributes:
        reference: (S,) pose.
        information: (2D, 2D) L, symmetric, positive semi-definite.
        vector: (2D,) b.
    """

    reference: FloatArray
    information: FloatArray
    vector: FloatArray


def no_message(reference: FloatArray, dimension: int) -> BackwardMessage:
    """Return what no later frame says about a state of D pose components."""
    return BackwardMessage(reference, np.zeros((2 * dimension, 2 * dimension)), np.zeros(2 * dimension))


def recentred(message: BackwardMessage, reference: FloatArray, space: StateSpace) -> BackwardMessage:
    """Return the message in another pose's tangent space.

    The spaces are taken to differ by a shift, which neglects terms of the order of the angle between them.
    """
    shift = np.zeros_like(message.vector)
    shift[: len(shift) // 2] = space.local(message.reference, reference)
    return BackwardMessage(reference, message.information, message.vector - message.information @ shift)


def before(message: BackwardMessage, dt: float, dynamics: Dynamics) -> BackwardMessage:
    """Return what the message says about the state dt seconds earlier; at dt = 0 the same.

    F^T (1 + L Q)^-1 L F and F^T (1 + L Q)^-1 b.
    """
    if dt <= 0.0:
        return message
    noise = dynamics.pose_noise, dynamics.velocity_noise
    F, Q = constant_velocity(*noise, dt, dynamics.discretisation)
    L = message.information
    back = np.linalg.solve((np.eye(len(L)) + L @ Q).T, F).T
    information = back @ L @ F
    symmetric = 0.5 * (information + information.T)
    return BackwardMessage(message.reference, symmetric, back @ message.vector)


def with_fit(message: BackwardMessage, modes: LikelihoodModes, k: int, space: StateSpace) -> BackwardMessage:
    """Return the message times the k-th fit of the likelihood."""
    size, H = modes.gradients.shape[1], modes.information[k]
    away = space.local(message.reference, modes.poses[k])
    information, vector = message.information.copy(), message.vector.copy()
    information[:size, :size] += H
    vector[:size] += modes.gradients[k] + H @ away
    return BackwardMessage(message.reference, information, vector)


def joined(belief: StateGaussian, message: BackwardMessage, space: StateSpace) -> StateGaussian:
    """Return the belief times what later frames say: C' = (1 + C L)^-1 C, moved by C' (b - L m).

    m is the belief's mean in the message's tangent space; the covariance is taken for that in the belief's.
    """
    size, C, L = belief.velocity.size, belief.covariance, message.information
    mean = np.concatenate([space.local(message.reference, belief.pose), belief.velocity])
    joint = np.linalg.solve(np.eye(2 * size) + C @ L, C)
    moved, quicker = np.split(joint @ (message.vector - L @ mean), 2)
    pose = space.retract(belief.pose[None], moved[None])[0]
    return StateGaussian(pose, belief.velocity + quicker, 0.5 * (joint + joint.T))
