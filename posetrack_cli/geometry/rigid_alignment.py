"""The rigid transform that lays one set of points on another."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray


def rigid_alignment(
    source: FloatArray, target: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return R (3, 3) and t (3,) that minimise sum_k w_k |R a_k + t - b_k|^2 (Kabsch 1976).

    With both sets about their weighted means, H = sum_k w_k a_k b_k^T = U S V^T and R = V D U^T, with
    D = diag(1, 1, det(V U^T)) so that no mirror image is taken.

    Args:
        source: (K, 3) a.
        target: (K, 3) b.
        weights: (K,) w >= 0, not all zero.
    """
    share = weights / weights.sum()
    from_middle, to_middle = share @ source, share @ target
    covariance = (source - from_middle).T @ (share[:, None] * (target - to_middle))
    U, _, Vt = np.linalg.svd(covariance)
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))])
    R: FloatArray = Vt.T @ turn @ U.T
    return R, to_middle - R @ from_middle
