"""What the one-camera tracker says about a frame, as results hold it."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.estimates import lost_estimate, tracked_estimate
from posetrack_cli.head.mono_state import MonoState
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.subject import MonoDiagnostics
from posetrack_cli.head.tracker.frame_tracker import FrameFit
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status


class MonoEstimates:
    """Makes estimates of frames.

    Args:
        model: of faces.
        scale: by which images were reduced, for what is said in recorded pixels.
    """

    def __init__(self, model: FaceModel, scale: float) -> None:
        self._model, self._scale = model, scale

    def tracked(self, frame: Frame, state: MonoState, followed: FrameFit, status: Status) -> Estimate:
        """Return the estimate of a frame in which the head was tracked; of whom, ``state`` tells."""
        a = followed.coefficients + self._model.deformation_mean
        numbers = self._numbers(state, followed.score, followed.weights)
        return tracked_estimate(frame, followed, status, a, numbers)

    def searched(self, frame: Frame, state: MonoState) -> Estimate:
        """Return the estimate of a frame in which the head was not found."""
        mean, deviations = self._model.deformation_mean, self._model.deformation_deviations
        numbers = self._numbers(state, np.nan, None)
        return lost_estimate(frame, state.following, mean, deviations, numbers)

    def _numbers(self, state: MonoState, score: float, weights: FloatArray | None) -> FloatArray:
        if not state.people:
            unknown = np.full(self._model.identity_size, np.nan)
            return MonoDiagnostics(unknown, unknown, state.current, score=score, weights=weights).array()
        known = state.person
        return MonoDiagnostics(
            known.history.mean,
            known.history.spread,
            state.current,
            known.adjusted_frames,
            known.rms_px / self._scale,
            score,
            weights,
        ).array()
