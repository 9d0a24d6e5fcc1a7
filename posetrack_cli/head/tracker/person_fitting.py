"""Following a known person for a frame, and learning from the frame (thesis, 4.3.2 and 4.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import normalised_from_pixels
from posetrack_cli.head.adjustment.views import PointView
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.face.templates import TemplateSet, is_new
from posetrack_cli.head.initialisation.detected_face import DetectedFace
from posetrack_cli.head.initialisation.mono import MonoInitialisation
from posetrack_cli.head.initialisation.single_view import pose_of
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.particles.motion import FRAME_S, velocity_between
from posetrack_cli.head.tracker.face_learning import off_axis_deg
from posetrack_cli.head.tracker.frame_tracker import FrameFit, FrameTracker, TrackState, begun
from posetrack_cli.head.tracker.person import KnownPerson
from posetrack_cli.recording.base import Frame


class PersonFitter:
    """One step of the method of chapter 4 for a person who was found.

    Args:
        config: parameters.
        camera: that sees the person.
        model: of faces.
    """

    def __init__(self, config: HeadMonoConfig, camera: Camera, model: FaceModel) -> None:
        self._config, self._camera, self._model = config, camera, model
        self._follower = FrameTracker(config.particles, config.refinement, (camera,))

    def followed(
        self, person: KnownPerson, following: TrackState, frame: Frame, rng: np.random.Generator
    ) -> FrameFit:
        """Return what a frame says of a person who was followed before."""
        now = replace(following.particles, model=person.shape)  # a means the same, whoever s says it is
        before = replace(following, particles=now)
        return self._follower.step(before, frame.stamp_ns, frame.images, person.sets, person.shape, rng)

    def from_detection(
        self,
        person: KnownPerson,
        found: DetectedFace,
        before: TrackState | None,
        frame: Frame,
        rng: np.random.Generator,
    ) -> FrameFit:
        """Return what a frame says of a detected face if it is a person's, last seen as ``before``."""
        gap_ns = round(FRAME_S * 1e9) if before is None else frame.stamp_ns - before.stamp_ns
        mean = person.shape.mean
        pose, _ = pose_of(found.pixels, found.responses, self._camera, mean)
        following = self._follower.begin(frame.stamp_ns - gap_ns, pose, mean, person.shape, rng)
        followed = self.followed(person, following, frame, rng)
        rested = replace(followed.following, velocity=np.zeros_like(following.velocity))
        return replace(followed, following=rested, coefficient_rate=np.zeros_like(followed.coefficient_rate))

    def resting(
        self,
        frame: Frame,
        found: DetectedFace,
        start: MonoInitialisation,
        seen: TemplateSet,
        rng: np.random.Generator,
    ) -> FrameFit:
        """What a frame says in which a face was detected that is not followed yet."""
        view, shape = start.views[-1], self._model.of_person(start.person.identity, start.person.offsets)
        own = self._on_rays(view.pose, shape.mean, found.pixels)
        following = self._follower.begin(frame.stamp_ns, view.pose, own, shape, rng, seen)
        return begun(following, shape.size, found.score, found.pixels[None])

    def learnt(
        self, person: KnownPerson, before: TrackState | None, frame: Frame, followed: FrameFit
    ) -> tuple[KnownPerson, FrameFit]:
        """Adjust the person by a frame in which it was found; return it and what the frame then says."""
        person = person.scored(followed.score)
        if self._is_to_be_adjusted(person, followed):
            view, settings = self._view(frame, followed), self._config.adjustment
            person = person.after(view, followed.score, self._model, self._camera, settings)
            followed = self._adjusted(before, person, followed)
        if followed.following.previous is not None and self._is_keyframe(person, followed):
            keyframe = self._keyframe(followed.following.previous, followed.correlations)
            person = replace(person, sets=(*person.sets, keyframe))
        return person, followed

    def _is_to_be_adjusted(self, person: KnownPerson, followed: FrameFit) -> bool:
        """Only a face that looks at the camera, like itself (4.4.3), and is little deformed **[ours]**."""
        settings = self._config.adjustment
        facing = off_axis_deg(followed.following.pose) < settings.facing_deg
        fit = facing and followed.score > settings.score
        return settings.when == "always" and fit and _deformed_mm(person, followed) < settings.neutral_mm

    def _view(self, frame: Frame, followed: FrameFit) -> PointView:
        a = followed.coefficients + self._model.deformation_mean
        weights = np.where(np.isfinite(followed.pixels[0, :, 0]), followed.weights, 0.0)
        return PointView(frame.stamp_ns, followed.pixels[0], weights, followed.following.pose, a)

    def _adjusted(self, before: TrackState | None, person: KnownPerson, followed: FrameFit) -> FrameFit:
        """Return what a frame says after the adjustment that it took part in."""
        view, now = person.views[-1], followed.following
        coefficients = view.deformation - self._model.deformation_mean
        velocity, rate = now.velocity, followed.coefficient_rate
        if before is not None and np.any(velocity):
            velocity = velocity_between(before.pose, view.pose, followed.dt)
            rate = rate + (coefficients - followed.coefficients) / followed.dt
        following = replace(
            now,
            pose=view.pose,
            velocity=velocity,
            particles=now.particles.moved_to(view.pose, coefficients),
            shape=self._on_rays(view.pose, person.shape.shapes(coefficients), followed.pixels[0]),
        )
        return replace(followed, following=following, coefficients=coefficients, coefficient_rate=rate)

    def _on_rays(self, pose: HeadPose, shape: FloatArray, pixels: FloatArray) -> FloatArray:
        """The points (K, 3) in the head's frame that are seen at pixels (K, 2), as deep as a shape's."""
        depths = pose.points(shape)[:, 2:]
        points = np.hstack([normalised_from_pixels(self._camera, pixels) * depths, depths])
        return np.where(np.isfinite(points), (points - pose.position) @ pose.rotation, shape)

    def _is_keyframe(self, person: KnownPerson, followed: FrameFit) -> bool:
        """Whether a frame shows the nearly neutral face from a direction of which nothing is kept."""
        settings = self._config.refinement
        neutral = _deformed_mm(person, followed) < settings.keyframe_neutral_mm
        clear = neutral and followed.score > settings.keyframe_correlation
        return clear and is_new(person.sets, followed.following.pose.facing, settings.keyframe_deg)

    def _keyframe(self, templates: TemplateSet, correlations: FloatArray) -> TemplateSet:
        """A frame's templates without the points that do not look like themselves: they may have left."""
        alike = np.nan_to_num(correlations) > self._config.refinement.keyframe_correlation
        return replace(templates, seen=templates.seen & alike)


def _deformed_mm(person: KnownPerson, followed: FrameFit) -> float:
    """How far the face is from its mean deformation: the length of 3K numbers, mm."""
    return float(np.linalg.norm(person.shape.basis @ followed.coefficients))
