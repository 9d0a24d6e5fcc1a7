"""Metrics of a head against points that were annotated in images."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray
from posetrack_cli.evaluation.metrics.measures import Matched, Measures, common_columns
from posetrack_cli.evaluation.metrics.pose_errors import distances
from posetrack_cli.evaluation.truth.image_points import OUTER_EYES
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import pixels_from_points

ERROR, NORMALISED = "landmark_error_px", "landmark_nme"


def landmark_metrics(measures: Measures, matched: Matched, camera: Camera) -> None:
    """Add the distances between projected and annotated points, in pixels and in distances of the eyes.

    Args:
        measures: where to.
        matched: the frames with a truth.
        camera: of the estimates, with its distortion.
    """
    estimate, truth = matched.estimate, matched.truth
    if truth.pixels is None:
        return measures.lack("the truth has no image points", ERROR, NORMALISED)
    points = common_columns(estimate.point_names, truth.point_names)
    if estimate.points is None or not points.names:
        return measures.lack("the result has other points", ERROR, NORMALISED)
    projected, visible = pixels_from_points(camera, matched.of_estimate("points")[:, points.estimate])
    pixels = matched.of_truth("pixels")
    errors = distances(projected, pixels[:, points.truth])
    known: BoolArray = np.logical_and.reduce(visible, axis=1)
    if not known.all():
        measures.notes.append(f"image errors without {(~known).sum()} frames with points outside the view")
    measures.add(ERROR, errors, known)
    measures.summarise_parts(ERROR, errors[known], points.names)
    right, left = (pixels[:, truth.point_names.index(name)] for name in OUTER_EYES)
    measures.add(NORMALISED, 100.0 * np.mean(errors, axis=1) / distances(right, left), known)
