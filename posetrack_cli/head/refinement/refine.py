"""One frame's refinement: the calls that a tracker makes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.config import RefinementSettings, StereoRefinementSettings
from posetrack_cli.head.face.points import of_kinds
from posetrack_cli.head.face.pose import HeadPose, ShapeModel
from posetrack_cli.head.face.rig_images import RigImages
from posetrack_cli.head.face.templates import take_templates
from posetrack_cli.head.refinement.evidence import project_point
from posetrack_cli.head.refinement.joint import Face, FaceUnknowns, Prior, descend
from posetrack_cli.head.refinement.recalculation import (
    Printed,
    recalculate_2d_as_printed,
    recalculate_as_printed,
    recalculate_points,
)
from posetrack_cli.head.refinement.scene import ComparedFrame, Scene

WIDE_PRIOR = np.array([50.0] * 3 + [0.5] * 3)
"""(6,) standard deviations about the predicted pose, mm and rad: keep what no patch tells."""
LEAST_DEVIATION_MM = 1e-3
ITERATIONS = 3
"""Of Gauss-Newton over pose, deformation and a residual per point."""
RESIDUAL_MM = of_kinds(eyes=0.8, mouth=2.5, nostrils=3.0, brows=0.9)
"""(K,) standard deviations of what the model does not explain."""
RECALCULATION_MM = of_kinds(eyes=1.0, mouth=12.0, nostrils=2.5, brows=2.0)
"""(K,) the same for the points' own places, with the pose held."""
DEGREES_OF_FREEDOM = 4.0
"""Of the Student-t density of the points' residuals."""
KEYFRAME_NEUTRAL_MM, KEYFRAME_CORRELATION = 3.0, 0.7
"""A keyframe's face is deformed by less (length of 3K numbers), and looks more like itself."""


@dataclass(frozen=True, eq=False)
class Refined:
    """What the patches of one frame agree on.

    Attributes:
        pose: of the head.
        coefficients: (B,) a, mm.
        residuals: (K, 3) delta, how far each point lies from the model, in the head's frame, mm.
        correlations: (C, K) the best with a template of ``templates``; NaN where there is none.
        visibility: (C, K) cosine of normal and ray at the predicted pose; 0 from behind and without an image.
        scene: the frame as it was looked at, for ``recalculate``.
    """

    pose: HeadPose
    coefficients: FloatArray
    residuals: FloatArray
    correlations: FloatArray
    visibility: FloatArray
    scene: Scene


@dataclass(frozen=True, eq=False)
class Recalculated:
    """The points' own places.

    Attributes:
        shape: (K, 3) M' in the head's frame, mm.
        correlations: (C, K) as of ``Refined``.
        pixels: (C, K, 2).
    """

    shape: FloatArray
    correlations: FloatArray
    pixels: FloatArray


def refine(frame: ComparedFrame, model: ShapeModel, pose: HeadPose, coefficients: FloatArray) -> Refined:
    """Refine pose and deformation together from where a filter puts them (``joint``).

    Without ``settings.joint`` they stay, and only how they look is told.

    Args:
        frame: images and templates.
        model: mean and deformations of the face.
        pose, coefficients: start, (B,) mm.
    """
    residuals = np.zeros_like(model.mean)
    # lenses are linearised about the start, so with a distorted one a second round begins where it ended
    for _ in range(2 if any(camera.is_distorted for camera in frame.images.cameras) else 1):
        shape = model.shapes(coefficients) + residuals
        scene, seen = frame.scene(pose, shape)
        state = _descended(scene, model, pose, coefficients, residuals, frame.settings)
        pose, coefficients, residuals = _pose(state), state.coefficients, state.residuals
    return Refined(pose, coefficients, residuals, state.correlations, seen, scene)


def recalculate(
    scene: Scene, pose: HeadPose, shape: FloatArray, start: FloatArray, settings: RefinementSettings
) -> Recalculated:
    """Find the points' own places with the pose held (``recalculation``, or the thesis's, ``printed``).

    As printed, several cameras move points in space (3.3), one camera moves them in its image (4.42); their
    depths are then those of M.

    Args:
        scene: of the frame, about nearly this pose and shape: ``Refined.scene``.
        pose: of the head.
        shape: (K, 3) M, what the model says, in the head's frame, mm.
        start: (K, 3) M' of the frame before.
        settings: weights, priors, steps.
    """
    count = (len(scene.images.sizes), len(shape))
    points, correlations, pixels = start.copy(), np.empty(count), np.empty((*count, 2))
    R, t, most = pose.rotation, pose.position, settings.recalculation_iterations
    if settings.recalculation == "printed" and count[0] == 1:
        return _recalculated_in_image(scene, pose, shape, start, settings)
    if settings.recalculation == "printed":
        printed = Printed(settings.rho, settings.epsilon)
        recalculate_as_printed(scene, R, t, shape, printed, most, points, correlations, pixels)
    else:
        prior = make_prior(RECALCULATION_MM)
        recalculate_points(scene, R, t, shape, prior, most, points, correlations, pixels)
    return Recalculated(points, correlations, pixels)


def _recalculated_in_image(
    scene: Scene, pose: HeadPose, shape: FloatArray, start: FloatArray, settings: RefinementSettings
) -> Recalculated:
    """(4.42) to (4.52), and the points at M's depths that are seen at the pixels found."""
    expected, jacobians = _seen_at(scene, pose.points(shape))
    pixels, _ = _seen_at(scene, pose.points(start))
    correlations, printed = np.empty(len(shape)), Printed(settings.rho, settings.epsilon)
    most = settings.recalculation_iterations
    recalculate_2d_as_printed(scene, expected, printed, most, pixels, correlations)
    across = np.linalg.solve(jacobians[:, :, :2], (pixels - expected)[..., None])[..., 0]
    moved = np.hstack([across, np.zeros((len(shape), 1))]) @ pose.rotation
    return Recalculated(shape + moved, correlations[None], pixels[None])


def _seen_at(scene: Scene, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the one camera sees points (K, 3), mm in its axes: (K, 2), and (K, 2, 3) its derivatives."""
    pixels, jacobians = np.empty((len(points), 2)), np.empty((len(points), 2, 3))
    for k, point in enumerate(points):
        project_point(scene.optics, 0, k, point, pixels[k], jacobians[k])
    return pixels, jacobians


def _descended(
    scene: Scene,
    model: ShapeModel,
    pose: HeadPose,
    coefficients: FloatArray,
    residuals: FloatArray,
    settings: RefinementSettings,
) -> FaceUnknowns:
    count = (len(scene.images.sizes), len(model.mean))
    state = FaceUnknowns(
        pose.rotation.copy(),
        pose.position.copy(),
        np.array(coefficients, dtype=np.float64),
        residuals.copy(),
        np.zeros(6),
        np.empty(count),
    )
    precisions = np.maximum(model.deviations, LEAST_DEVIATION_MM) ** -2
    face = Face(np.array(model.mean), np.ascontiguousarray(model.basis), precisions)
    descend(scene, face, make_prior(RESIDUAL_MM), ITERATIONS if settings.joint else 0, state)
    return state


def _pose(state: FaceUnknowns) -> HeadPose:
    return HeadPose(state.position, quaternions_from_matrices(state.rotation))


def make_prior(scales: FloatArray) -> Prior:
    """Return the prior of points that lie off their model by standard deviations (K,), mm."""
    return Prior(scales, DEGREES_OF_FREEDOM, WIDE_PRIOR**-2)


ROUNDS, STEPS = 3, 5
"""A point that came nearer or went away is looked at from there again."""


def refine_initial_depth(
    images: RigImages, pose: HeadPose, shape: FloatArray, settings: StereoRefinementSettings
) -> FloatArray:
    """Return the shape (K, 3), mm, at which the patches of all cameras agree best **[ours]**.

    A point of a shape that was just found may lie some mm before or behind the skin that its patches show:
    then the reference templates of two cameras ask for one depth and the comparison between the cameras
    for another, and every later pose is pulled to and fro. Here the first camera with an image holds the
    point at its pixel, and the comparison between the cameras moves it along the ray.

    Args:
        images: of all cameras.
        pose: of the head.
        shape: (K, 3) as found, mm.
        settings: weights, steps.
    """
    prior = make_prior(np.full(len(shape), settings.settling_mm))
    points = np.array(shape, dtype=np.float64)
    for _ in range(ROUNDS):
        templates = take_templates(images, pose, points)
        held = replace(templates, seen=_first_camera_only(templates.seen))
        scene, _seen = ComparedFrame(images, [held], None, settings).scene(pose, points)
        correlations = np.empty(templates.seen.shape)
        pixels = np.empty((*templates.seen.shape, 2))
        most = STEPS
        recalculate_points(
            scene, pose.rotation, pose.position, shape, prior, most, points, correlations, pixels
        )
    return points


def _first_camera_only(seen: BoolArray) -> BoolArray:
    """Return (C, K) where the first camera that sees anything sees a point."""
    first: BoolArray = np.zeros_like(seen)
    camera = int(np.argmax(seen.any(axis=1)))
    first[camera] = seen[camera]
    return first
