"""What the stereo tracker says about a frame, as results hold it."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.estimates import lost_estimate, padded, tracked_estimate
from posetrack_cli.head.subject import StereoDiagnostics
from posetrack_cli.head.tracker.face_learning import FaceLearning
from posetrack_cli.head.tracker.frame_tracker import FrameFit, TrackState
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status


def components_of(config: HeadStereoConfig) -> int:
    """Return B, the number of deformation coefficients in the result."""
    return 0 if config.model.kind == "rigid" else config.model.components


def tracked(
    frame: Frame, followed: FrameFit, face: FaceLearning, status: Status, config: HeadStereoConfig
) -> Estimate:
    """Return the estimate of a frame in which the head was tracked."""
    count = components_of(config)
    numbers = _numbers(face, followed.score, followed.weights).array(count)
    return tracked_estimate(frame, followed, status, padded(followed.coefficients, count), numbers)


def searched(
    frame: Frame, following: TrackState | None, face: FaceLearning | None, config: HeadStereoConfig
) -> Estimate:
    """Return the estimate of a frame in which the head was not found."""
    count = components_of(config)
    mu = padded(np.zeros(0) if face is None else face.model.deviations, count)
    return lost_estimate(frame, following, np.zeros(count), mu, _numbers(face, np.nan, None).array(count))


def _numbers(face: FaceLearning | None, score: float, weights: FloatArray | None) -> StereoDiagnostics:
    if face is None:
        return StereoDiagnostics(np.zeros(0), score=score, weights=weights)
    statistics = face.statistics
    known = statistics.learnt > 0
    return StereoDiagnostics(
        statistics.eigenvalues if known else np.zeros(0),
        float(statistics.contribution[-1]) if known else np.nan,
        statistics.learnt,
        score,
        weights,
    )
