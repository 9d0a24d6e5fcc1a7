"""The one-camera tracker that a run uses, made from its files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.initialisation.clicked import read_clicked
from posetrack_cli.head.mono_reduction import ReducingTracker, reduced_pixels
from posetrack_cli.head.mono_tracker import MonoTracker
from posetrack_cli.head.multilinear.face_model import load_face_model


def make_mono_tracker(
    config: HeadMonoConfig,
    camera: Camera,
    known: Mapping[str, np.ndarray[Any, Any]] | None = None,
    *,
    face: int = 0,
    clicked: Path | None = None,
) -> ReducingTracker:
    """Return the tracker that a run uses.

    Args:
        config: parameters; names the face model's file.
        camera: of the recording.
        known: what another tracker has ``learned``.
        face: which one to begin with, 0 the largest.
        clicked: table of points in the first frame; None finds the face.

    Raises:
        UsageError, ResultError: a file that is missing or cannot be used.
        PosetrackError: clicked points that are none.
    """
    model = load_face_model(None if config.model.file is None else Path(config.model.file))
    points = None if clicked is None else read_clicked(clicked, (camera,))[0]
    where = "" if clicked is None else str(clicked)

    def make(
        seen_by: Camera, scale: float, learned: Mapping[str, np.ndarray[Any, Any]] | None
    ) -> MonoTracker:
        own = None if points is None else reduced_pixels(points, scale)
        return MonoTracker(config, seen_by, model, face, own, where, scale, learned)

    return ReducingTracker(camera, config.start.eye_distance_px, make, known)
