"""The update of a Kalman filter, against which particle filters and smoothers are measured."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.model import Gaussian


def kalman_update(
    belief: Gaussian, observation: FloatArray, sensor: FloatArray, noise: FloatArray
) -> tuple[Gaussian, float]:
    """Condition the belief on y = H x + e, e ~ N(0, R).

    K = C H^T (H C H^T + R)^-1; the covariance in Joseph's form (1 - K H) C (1 - K H)^T + K R K^T, which stays
    symmetric and positive.

    Args:
        belief: before the observation, dimension D.
        observation: (M,) y.
        sensor: (M, D) H.
        noise: (M, M) R, positive definite.

    Returns:
        The belief after, and the log evidence log p(y).
    """
    innovation = observation - sensor @ belief.mean
    spread = sensor @ belief.covariance @ sensor.T + noise
    gain = np.linalg.solve(spread, sensor @ belief.covariance).T
    rest = np.eye(belief.mean.size) - gain @ sensor
    covariance = rest @ belief.covariance @ rest.T + gain @ noise @ gain.T
    log_determinant = np.linalg.slogdet(2.0 * np.pi * spread)[1]
    distance = innovation @ np.linalg.solve(spread, innovation)
    log_evidence = -0.5 * float(log_determinant + distance)
    return Gaussian(belief.mean + gain @ innovation, covariance), log_evidence
