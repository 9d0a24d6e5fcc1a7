"""Tracking a known person into a frame, and learning from the frame (thesis, 4.3.2 and 4.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.projection import normalised_from_pixels
from posetrack_cli.head.adjustment.adjuster import Adjuster
from posetrack_cli.head.adjustment.views import PointView
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.face.templates import TemplateSet, is_new_direction
from posetrack_cli.head.initialisation.mono import DetectedFace, MonoInitialisation
from posetrack_cli.head.initialisation.single_view import pose_of
from posetrack_cli.head.particles.particles import velocity_between
from posetrack_cli.head.tracker.face_learning import off_axis_deg
from posetrack_cli.head.tracker.frame_tracker import (
    FrameFit,
    FrameTracker,
    SeededFrame,
    TrackState,
    initial_fit,
)
from posetrack_cli.head.tracker.person import KnownPerson, person_shape


class PersonFitter:
    """One step of the method of chapter 4 for a person who was found.

    Args:
        config: parameters.
        adjuster: of a person to views of the camera that sees the person.
    """

    def __init__(self, config: HeadMonoConfig, adjuster: Adjuster) -> None:
        self._config, self._adjuster = config, adjuster
        self._camera, self._model = adjuster.camera, adjuster.model
        self._frame_tracker = FrameTracker(config, (adjuster.camera,))

    def fit(self, person: KnownPerson, track: TrackState, frame: SeededFrame) -> FrameFit:
        """Return what a frame says of a person who was tracked before."""
        now = replace(track.particles, model=person.shape)  # a means the same, whoever s says it is
        before = replace(track, particles=now)
        return self._frame_tracker.step(before, frame, person.templates, person.shape)

    def fit_detection(
        self, person: KnownPerson, found: DetectedFace, last_seen_ns: int, frame: SeededFrame
    ) -> FrameFit:
        """Return what a frame says of a detected face if it is a person's; it is at rest."""
        mean = person.shape.mean
        pose, _ = pose_of(found.pixels, found.responses, self._camera, mean)
        track = self._frame_tracker.start(frame, pose, mean, person.shape)
        fit = self.fit(person, replace(track, stamp_ns=last_seen_ns), frame)
        return replace(fit, track=fit.track.at_rest(), coefficient_rate=np.zeros_like(fit.coefficient_rate))

    def initial_fit(
        self, frame: SeededFrame, found: DetectedFace, start: MonoInitialisation, seen: TemplateSet
    ) -> FrameFit:
        """Return what a frame says in which a face was detected that is not tracked yet."""
        view, shape = start.views[-1], person_shape(self._model, start.person)
        own = self._on_rays(view.pose, shape.mean, found.pixels)
        track = self._frame_tracker.start(frame, view.pose, own, shape, seen)
        return initial_fit(track, found.score, found.pixels[None])

    def update_person(
        self, person: KnownPerson, before: TrackState | None, frame: SeededFrame, fit: FrameFit
    ) -> tuple[KnownPerson, FrameFit]:
        """Adjust the person by a frame in which it was found; return it and what the frame then says."""
        person = person.with_score(fit.score)
        if self._shows_person(person, fit):
            person = person.after(self._view(frame, fit), fit.score, self._adjuster)
            fit = self._adjusted(before, person, fit)
        if fit.track.templates is not None and self._is_keyframe(person, fit):
            keyframe = self._keyframe(fit.track.templates, fit.correlations)
            person = replace(person, templates=(*person.templates, keyframe))
        return person, fit

    def _shows_person(self, person: KnownPerson, fit: FrameFit) -> bool:
        """Whether a face looks at the camera and like itself (4.4.3), and is little deformed **[ours]**."""
        settings = self._config.adjustment
        clear = off_axis_deg(fit.track.pose) < settings.facing_deg and fit.score > settings.score
        return settings.when == "always" and clear and _deformed_mm(person, fit) < settings.neutral_mm

    def _view(self, frame: SeededFrame, fit: FrameFit) -> PointView:
        a = fit.coefficients + self._model.deformation_mean
        weights = np.where(np.isfinite(fit.pixels[0, :, 0]), fit.weights, 0.0)
        return PointView(frame.stamp_ns, fit.pixels[0], weights, fit.track.pose, a)

    def _adjusted(self, before: TrackState | None, person: KnownPerson, fit: FrameFit) -> FrameFit:
        """Return what a frame says after the adjustment that it took part in."""
        view, now = person.views[-1], fit.track
        coefficients = view.deformation - self._model.deformation_mean
        velocity, rate = now.velocity, fit.coefficient_rate
        if before is not None and np.any(velocity):
            velocity = velocity_between(before.pose, view.pose, fit.dt)
            rate = rate + (coefficients - fit.coefficients) / fit.dt
        track = replace(
            now,
            pose=view.pose,
            velocity=velocity,
            particles=now.particles.moved_to(view.pose, coefficients),
            shape=self._on_rays(view.pose, person.shape.shapes(coefficients), fit.pixels[0]),
        )
        return replace(fit, track=track, coefficients=coefficients, coefficient_rate=rate)

    def _on_rays(self, pose: HeadPose, shape: FloatArray, pixels: FloatArray) -> FloatArray:
        """The points (K, 3) in the head's frame that are seen at pixels (K, 2), as deep as a shape's."""
        depths = pose.points(shape)[:, 2:]
        points = np.hstack([normalised_from_pixels(self._camera, pixels) * depths, depths])
        return np.where(np.isfinite(points), (points - pose.position) @ pose.rotation, shape)

    def _is_keyframe(self, person: KnownPerson, fit: FrameFit) -> bool:
        """Whether a frame shows the nearly neutral face from a direction of which nothing is kept."""
        settings = self._config.refinement
        neutral = _deformed_mm(person, fit) < settings.keyframe_neutral_mm
        clear = neutral and fit.score > settings.keyframe_correlation
        return clear and is_new_direction(person.templates, fit.track.pose.facing, settings.keyframe_deg)

    def _keyframe(self, templates: TemplateSet, correlations: FloatArray) -> TemplateSet:
        """A frame's templates without the points that do not look like themselves: they may have left."""
        alike = np.nan_to_num(correlations) > self._config.refinement.keyframe_correlation
        return replace(templates, seen=templates.seen & alike)


def _deformed_mm(person: KnownPerson, fit: FrameFit) -> float:
    """How far the face is from its mean deformation: the length of 3K numbers, mm."""
    return float(np.linalg.norm(person.shape.basis @ fit.coefficients))
