"""What is minimised, as the kernels read it: everything in units of its standard deviation.

    F = sum_ik w_ik H(|S_ik (pi(X_ik) - x_ik)|)  +  prior/2 (|u|^2 + sum_i |v_i|^2)  +  1/2 |q|^2       (4.18)
    X_ik = exp(d_i) R_i (Mbar_k + C_k (u + ubar) (v_i + vbar) + D_k q_k) + t_i + e_i                   (4.15)

u, v, q are whitened identity, deformations and offsets, pi the pinhole camera of focal length 1, x rays, S
what takes rays to pixels in units of their standard deviation, H Huber's function: e^2/2 up to h, then
h (e - h/2). The prior of u and q counts once, that of v once a view: so F is minus the logarithm of what is
thought of one person seen n times, and n views outweigh what is thought of the person before **[ours]**.

Without priors and bounds s is known up to a factor only: (4.15) is the same for c s and a / c.
"""

from __future__ import annotations

from typing import NamedTuple

from posetrack_cli.arrays import FloatArray

POSE = 6


class Problem(NamedTuple):
    """Model, observations and start poses of n views.

    Attributes:
        mean: (K, 3) Mbar, mm.
        core: (K, 3, S, A) C, mm: the model's, times sigma_s sigma_a.
        identity_centre: (S,) ubar = sbar / sigma_s.
        deformation_centre: (A,) vbar = abar / sigma_a.
        offset_deviations: (K, 3) D, mm.
        rotations: (n, 3, 3) R at the start.
        positions: (n, 3) t at the start, mm.
        rays: (n, K, 2) x, observed x/z, y/z without the lens's distortion.
        scales: (n, K, 2, 2) S.
        weights: (n, K) w, 0 where a point is left out.
        huber: h.
        prior: weight of u and v.
    """

    mean: FloatArray
    core: FloatArray
    identity_centre: FloatArray
    deformation_centre: FloatArray
    offset_deviations: FloatArray
    rotations: FloatArray
    positions: FloatArray
    rays: FloatArray
    scales: FloatArray
    weights: FloatArray
    huber: float
    prior: float


class Unknowns(NamedTuple):
    """What is sought; written over.

    Attributes:
        local: (n, 6 + A) tangent vector from the start pose, mm and rad, then v.
        shared: (S + 3K,) u, then q point by point.
    """

    local: FloatArray
    shared: FloatArray


class Boxes(NamedTuple):
    """C of (4.26), of the shape of the unknowns; infinite where there is no bound."""

    local_lower: FloatArray
    local_upper: FloatArray
    shared_lower: FloatArray
    shared_upper: FloatArray


class Part(NamedTuple):
    """Which unknowns move: the first ``local`` of each view first..last-1, and the first ``shared``."""

    first: int
    last: int
    local: int
    shared: int
