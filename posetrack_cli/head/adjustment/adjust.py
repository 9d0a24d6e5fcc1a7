"""Bundle adjustment of n views with a separated face model: poses, deformations, one person (thesis, 4.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import canonical, exponential, multiply
from posetrack_cli.head.adjustment.preparation import clipped, make_boxes, make_problem, make_start
from posetrack_cli.head.adjustment.solver.cost import cost
from posetrack_cli.head.adjustment.solver.descent import adjust_in_stages, all_lengths, identity_variances
from posetrack_cli.head.adjustment.solver.problem import POSE, Part, Problem, Unknowns
from posetrack_cli.head.adjustment.views import Adjusted, PersonParameters, PointView
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.refinement.refine import point_values


def adjust(
    views: Sequence[PointView],
    person: PersonParameters,
    model: FaceModel,
    camera: Camera,
    settings: AdjustmentSettings,
    *,
    iterations: int,
    hold_person: bool = False,
    wide: bool = False,
    deviations: bool = True,
) -> Adjusted:
    """Adjust views and person to each other, (4.29)-(4.37).

    Stage 1 moves the poses only; stage 2 poses, deformations, identity and, with ``settings.offsets``, the
    constant offsets of points **[ours]**. What is minimised stands in ``solver.problem``: Huber's function of
    residuals instead of their squares, and priors, are **[ours]**. The result's cost is never above that of
    the start (moved into its bounds, should it be outside).

    Args:
        views: n frames with start poses and deformations; points without weight or pixel are left out.
        person: start.
        model: what faces are like.
        camera: that saw them, with its lens; must be the reference camera.
        settings: of the adjustment.
        iterations: steps of each of the two stages at most; fewer where F falls no more.
        hold_person: leave identity and offsets as they are, also where they are out of bounds.
        wide: no bounds about the start, only those about the mean of identity and deformation.
        deviations: whether to tell the identity's; NaN without.
    """
    problem = make_problem(views, model, camera, settings)
    start = make_start(views, person, model, problem)
    boxes = make_boxes(start, settings, model.identity_size, wide)
    unknowns = clipped(start, boxes)
    if hold_person:
        unknowns = Unknowns(unknowns.local, start.shared)
    shared = _shared_size(model, settings, hold_person)
    taken = adjust_in_stages(problem, boxes, unknowns, iterations, shared)
    everything = Part(0, len(views), unknowns.local.shape[1], shared)
    return Adjusted(
        _views(views, unknowns, problem, model),
        person if hold_person else _person(unknowns, problem, model),
        cost(problem, unknowns, everything),
        _residuals(problem, unknowns, settings),
        taken,
        _deviations(problem, unknowns, everything, model)
        if deviations
        else np.full(model.identity_size, np.nan),
    )


def _shared_size(model: FaceModel, settings: AdjustmentSettings, hold_person: bool) -> int:
    """Return how many unknowns the views share."""
    offsets = model.mean.size if settings.offsets else 0
    return 0 if hold_person else model.identity_size + offsets


def _views(
    views: Sequence[PointView], unknowns: Unknowns, problem: Problem, model: FaceModel
) -> tuple[PointView, ...]:
    """Return the views with adjusted poses and deformations."""
    tangents, whitened = unknowns.local[:, :POSE], unknowns.local[:, POSE:]
    deformations = (whitened + problem.deformation_centre) * model.deformation_deviations
    before = np.array([view.pose.quaternion for view in views]).reshape(-1, 4)
    quaternions = canonical(multiply(exponential(tangents[:, 3:]), before))
    positions = problem.positions + tangents[:, :3]
    return tuple(
        replace(view, pose=HeadPose(position, quaternion), deformation=deformation)
        for view, position, quaternion, deformation in zip(
            views, positions, quaternions, deformations, strict=True
        )
    )


def _person(unknowns: Unknowns, problem: Problem, model: FaceModel) -> PersonParameters:
    """Return the adjusted person."""
    size = model.identity_size
    identity = (unknowns.shared[:size] + problem.identity_centre) * model.identity_deviations
    return PersonParameters(identity, unknowns.shared[size:].reshape(-1, 3) * problem.offset_deviations)


def _residuals(problem: Problem, unknowns: Unknowns, settings: AdjustmentSettings) -> FloatArray:
    """Return (n, K) lengths of errors, recorded pixels."""
    lengths = np.empty(problem.weights.shape)
    all_lengths(problem, unknowns, lengths)
    pixels: FloatArray = np.where(problem.weights > 0.0, lengths * point_values(settings.pixel_sd), np.nan)
    return pixels


def _deviations(problem: Problem, unknowns: Unknowns, part: Part, model: FaceModel) -> FloatArray:
    """Return (S,) posterior standard deviations of s."""
    if part.shared == 0:
        return model.identity_deviations
    variances = np.empty(model.identity_size)
    identity_variances(problem, unknowns, part, variances)
    deviations: FloatArray = np.sqrt(variances) * model.identity_deviations
    return deviations
