"""Following a found head from frame to frame: filter, refinement, the points' own places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import ParticleSettings, RefinementSettings
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.face.projection import project
from posetrack_cli.head.face.shape_model import ShapeModel
from posetrack_cli.head.face.templates import (
    TemplateSet,
    chosen,
    take_templates,
    tangents,
    template_images,
    visibility,
    warped,
)
from posetrack_cli.head.particles.filter import HeadFilter, HeadParticles
from posetrack_cli.head.particles.motion import FRAME_S, predicted_pose, velocity_between
from posetrack_cli.head.particles.scores import PatchObservation
from posetrack_cli.head.refinement.refine import recalculate, refine

Images = Sequence[ImageArray | None]


@dataclass(frozen=True, eq=False)
class TrackState:
    """A head that is being followed, after a frame.

    Attributes:
        stamp_ns: of the frame.
        pose: of the head.
        velocity: (6,) tangent vector per second.
        particles: about that pose.
        shape: (K, 3) M', the points' own places in the head's frame, mm.
        previous: templates of this frame; None if the head was put here and not seen here.
    """

    stamp_ns: int
    pose: HeadPose
    velocity: FloatArray
    particles: HeadParticles
    shape: FloatArray
    previous: TemplateSet | None


@dataclass(frozen=True, eq=False)
class FrameFit:
    """What one frame says about a head.

    Attributes:
        following: to go on with.
        coefficients: (B,) deformation, mm.
        coefficient_rate: (B,) its change since the frame before, mm/s.
        variance: (6 + B,) of pose (tangent vector) and coefficients.
        dt: s since the frame before.
        correlations: (K,) of each point at its own place, the best camera's; NaN where no camera sees it.
        weights: (K,) visibility of each point times its correlation, 0 to 1.
        score: mean correlation of the points, weighted by their visibility; 0 if none is visible.
        pixels: (C, K, 2) where the points are on the images.
        effective_sample_size: of the particles.
    """

    following: TrackState
    coefficients: FloatArray
    coefficient_rate: FloatArray
    variance: FloatArray
    dt: float
    correlations: FloatArray
    weights: FloatArray
    score: float
    pixels: FloatArray
    effective_sample_size: float


class FrameTracker:
    """One step of the method of chapters 3 and 4, for a head that was found.

    Args:
        particles: of the filter.
        refinement: what follows it.
        cameras: of the recording, one or more.
    """

    def __init__(
        self, particles: ParticleSettings, refinement: RefinementSettings, cameras: Sequence[Camera]
    ) -> None:
        self._settings, self._motion, self._cameras = refinement, particles, cameras
        self._filter = HeadFilter(particles, cameras)

    def begin(
        self,
        stamp_ns: int,
        pose: HeadPose,
        shape: FloatArray,
        model: ShapeModel,
        rng: np.random.Generator,
        seen: TemplateSet | None = None,
    ) -> TrackState:
        """Return a head at rest, its points at ``shape`` (K, 3), mm: ``seen`` there, or put there."""
        particles = self._filter.start(pose, model, rng)
        return TrackState(stamp_ns, pose, np.zeros(POSE_SIZE), particles, shape, seen)

    def step(
        self,
        before: TrackState,
        stamp_ns: int,
        images: Images,
        sets: Sequence[TemplateSet],
        model: ShapeModel,
        rng: np.random.Generator,
    ) -> FrameFit:
        """Advance by one frame.

        Args:
            before: the head after the frame before.
            stamp_ns: of this frame.
            images: grey, uint8, one a camera; None where a camera gave none.
            sets: templates, reference first.
            model: of the face.
            rng: source of randomness.
        """
        dt = (stamp_ns - before.stamp_ns) * 1e-9
        predicted = predicted_pose(before.pose, before.velocity, dt, self._motion)
        coefficients = before.particles.with_model(model).coefficients
        shape = model.shapes(coefficients)
        expected = self._expected(images, sets, predicted, shape)
        filtered = self._filter.step(before.particles, predicted, before.velocity, dt, expected, model, rng)
        stored = chosen(sets, filtered.pose.facing)
        refined = refine(
            images,
            self._cameras,
            stored,
            before.previous,
            model,
            filtered.pose,
            filtered.coefficients,
            self._settings,
        )
        places = model.shapes(refined.coefficients)
        own = recalculate(refined.scene, refined.pose, places, before.shape, self._settings)
        following = TrackState(
            stamp_ns,
            refined.pose,
            velocity_between(before.pose, refined.pose, dt),
            filtered.particles.moved_to(refined.pose, refined.coefficients),
            own.shape,
            take_templates(images, self._cameras, refined.pose, own.shape, own.pixels),
        )
        correlations, score = agreement(refined.correlations, refined.visibility)
        at_own_places, _ = agreement(own.correlations, refined.visibility)
        return FrameFit(
            following,
            refined.coefficients,
            (refined.coefficients - coefficients) / dt,
            following.particles.variance(),
            dt,
            at_own_places,
            refined.visibility.max(axis=0) * np.clip(np.nan_to_num(correlations), 0.0, 1.0),
            score,
            own.pixels,
            filtered.effective_sample_size,
        )

    def _expected(
        self, images: Images, sets: Sequence[TemplateSet], pose: HeadPose, shape: FloatArray
    ) -> PatchObservation:
        """What the points should look like at a predicted pose, and how far they are visible."""
        projection = project(self._cameras, pose.points(shape))
        patches, known = warped(chosen(sets, pose.facing)[-1], tangents(projection, pose))
        return PatchObservation(images, template_images(patches), visibility(projection, pose) * known)


def begun(following: TrackState, size: int, score: float, pixels: FloatArray) -> FrameFit:
    """What the frame says in which a head was first found.

    Args:
        following: the head, at rest.
        size: B, of a face that is not known to deform yet.
        score: of the start.
        pixels: (C, K, 2) where its points were found.
    """
    nothing, particles = np.zeros(size), following.particles
    return FrameFit(
        following,
        coefficients=nothing,
        coefficient_rate=nothing,
        variance=particles.variance(),
        dt=FRAME_S,
        correlations=np.full(len(following.shape), score),
        weights=np.full(len(following.shape), score),
        score=score,
        pixels=pixels,
        effective_sample_size=float(len(particles.weights)),
    )


def agreement(correlations: FloatArray, seen: FloatArray) -> tuple[FloatArray, float]:
    """Return each point's best correlation (K,) over cameras, and their mean weighted by visibility.

    Args:
        correlations: (C, K); NaN where a camera has nothing to compare.
        seen: (C, K) visibility, 0 to 1.
    """
    known = np.where(np.isnan(correlations) | (seen <= 0.0), -np.inf, correlations)
    best = known.max(axis=0)
    weights = np.where(np.isfinite(best), seen.max(axis=0), 0.0)
    total = float(weights.sum())
    score = float(weights @ np.where(np.isfinite(best), best, 0.0)) / total if total > 0.0 else 0.0
    return np.where(np.isfinite(best), best, np.nan), score
