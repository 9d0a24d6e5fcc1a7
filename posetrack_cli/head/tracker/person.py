"""People tracked with one camera: identity and size, learned while tracking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import normalised_from_pixels, pixels_and_jacobian
from posetrack_cli.head.adjustment.adjuster import (
    Adjusted,
    Adjuster,
    Album,
    PersonParameters,
    PointView,
    choose_views,
)
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.face.points import HeadPose, ShapeModel
from posetrack_cli.head.face.rig_images import RigImages
from posetrack_cli.head.face.templates import TemplateSet, is_new_direction, take_templates
from posetrack_cli.head.initialisation.mono import DetectedFace, MonoInitialisation
from posetrack_cli.head.initialisation.single_view import pose_of
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.particles.particles import velocity_between
from posetrack_cli.head.refinement.refine import KEYFRAME_CORRELATION, KEYFRAME_NEUTRAL_MM, LEAST_DEVIATION_MM
from posetrack_cli.head.skin.map import MatchedSkin, SkinMap, cut_view, make_map, match_skin, pose_on_map
from posetrack_cli.head.skin.matching import MOST_VIEWS, SkinAlbum, SkinView
from posetrack_cli.head.tracker.face_learning import off_axis_deg
from posetrack_cli.head.tracker.frame_tracker import (
    FrameFit,
    FrameTracker,
    SeededFrame,
    TrackState,
    initial_fit,
)
from posetrack_cli.results.columns import floats

# Size of the head from the interpupillary distance: one camera does not observe scale **[ours]**.
#
# Multiplying all lengths by a factor c does not change the images. The prior is log c ~ N(0, m^2), with c = 1
# for the most likely face. An interpupillary distance X, measured with the standard deviation s_X, gives
#
#     log X = log c + log D + e,    e ~ N(0, s^2),    s^2 = (s_X^2 + s_D^2) / X^2
#
# with D the distance in the adjusted person (c = 1), known to s_D. Therefore
#
#     log c = k log (X / D),    sd(log c) = m sqrt(1 - k),    k = m^2 / (m^2 + s^2).
#
# A pupil is assumed midway between the corners of its eye. In ICT-FaceKit's statistics, on which the shipped
# model is based, these midpoints are 63.0 mm apart on average; the mean interpupillary distance of adults is
# 63.4 mm (Dodgson 2004, n = 3976). Tracked corners lie outside of those landmarks by ``CORNERS_OUTSIDE_MM``.

CORNERS_OUTSIDE_MM = 2.1
"""Tracked midpoints of the eye corners are farther apart than the statistics' landmarks by this much, true
mm."""
SMALLEST_SIZE, LARGEST_SIZE = 0.2, 5.0
"""Limits of a head's size relative to the most likely one; other measurements are mistakes."""
CORNERS_SD_MM = 1.1
"""s_D: deviation of the pupils from the midpoints of the tracked eye corners."""
PRIOR_SD = 0.035
"""m: one camera does not observe the size of a head."""
UNLIKELY_SD = 2.5
"""Standard deviations between measured and most likely distance that cause a warning: 1 person in 80."""
LEAST_MM = 1.0
"""Keeps logarithms finite if a model contains faces whose eyes touch."""
_RIGHT_EYE, _LEFT_EYE = slice(0, 2), slice(2, 4)


class Size(NamedTuple):
    """Scale factor of a person.

    Attributes:
        factor: c, applied to all lengths.
        sd: of log c.
    """

    factor: Annotated[float, floats(least=SMALLEST_SIZE, most=LARGEST_SIZE)]
    sd: Annotated[float, floats(least=0.0, most=1.0)]

    def scale_shape(self, shape: ShapeModel) -> ShapeModel:
        """Return the shape model of a face of that size."""
        return ShapeModel(self.factor * shape.mean, self.factor * shape.basis, shape.deviations)


class SizeMeasurement(Protocol):
    """A measurement of a person's size."""

    def size_of(self, shape: FloatArray) -> Size:
        """Return the size of a person with the adjusted neutral shape (K, 3), mm."""


@dataclass(frozen=True)
class PupilDistance:
    """A measured interpupillary distance.

    Attributes:
        distance_mm: X.
        sd_mm: combined standard deviation of X and D, s times X.
        prior_sd: m.
    """

    distance_mm: float
    sd_mm: float
    prior_sd: float = PRIOR_SD

    def size_of(self, shape: FloatArray) -> Size:
        """Return c and its standard deviation."""
        return _kalman_update(self.distance_mm / pupil_distance(shape), self._sd, self.prior_sd)

    def warnings(self, shape: FloatArray) -> tuple[str, ...]:
        """Return a warning if the shape (K, 3) would imply an unlikely size."""
        seen = pupil_distance(shape)
        if abs(np.log(self.distance_mm / seen)) <= UNLIKELY_SD * float(np.hypot(self._sd, self.prior_sd)):
            return ()
        return (
            f"interpupillary distance {self.distance_mm:.3g} mm, but the most likely face has {seen:.0f} mm:"
            " check the distance, and with posetrack view that the points are at the eye corners",
        )

    @property
    def _sd(self) -> float:
        """s, of the logarithm."""
        return self.sd_mm / self.distance_mm


def pupil_distance(shape: FloatArray) -> float:
    """Return D, mm, of a shape (K, 3) of tracked points."""
    middles = shape[_LEFT_EYE].mean(axis=0) - shape[_RIGHT_EYE].mean(axis=0)
    return max(float(np.linalg.norm(middles)) - CORNERS_OUTSIDE_MM, LEAST_MM)


def _kalman_update(ratio: float, sd: float, prior_sd: float) -> Size:
    """Return the size after one measurement of c: the Kalman update of its logarithm."""
    gain = prior_sd**2 / (prior_sd**2 + sd**2) if prior_sd > 0.0 else 0.0
    factor = float(np.clip(np.exp(gain * np.log(ratio)), SMALLEST_SIZE, LARGEST_SIZE))
    return Size(factor, float(prior_sd * np.sqrt(1.0 - gain)))


# Learning the person: adjustment after each frame (4.3.2, 4.4)

SCORE_RATE = 0.05
"""Rate of the running mean of scores: twenty frames, longer than a blink or a word."""


@dataclass(frozen=True, eq=False)
class KnownPerson:
    """A person as learned so far.

    Attributes:
        person: identity and offsets, in the scale of the views.
        history: of identities, (4.36).
        views: n frames that are adjusted together.
        album: frames from all directions, for the adjustment over the whole recording.
        shape: deformation model of the face, in true size.
        templates: reference first.
        adjusted_frames: number of frames used for adjustments.
        rms_px: residual of the last adjustment, root mean square.
        mean_score: running mean of the scores of tracked frames; NaN before the first.
        is_settled: identity determined over a whole recording, and no longer adjusted by single frames
            **[ours]**.
        is_held: identity given by the user; nothing is adjusted.
        size: measured size; None without a measurement.
        skin: frames of this recording for the skin map of a second pass, in the scale of the views.
        skin_map: from a first pass; None during it.
    """

    person: PersonParameters
    history: IdentityHistory
    views: tuple[PointView, ...]
    album: Album
    shape: ShapeModel
    templates: tuple[TemplateSet, ...]
    adjusted_frames: int = 0
    rms_px: float = np.nan
    mean_score: float = np.nan
    is_settled: bool = False
    is_held: bool = False
    size: Size | None = None
    skin: SkinAlbum = field(default_factory=SkinAlbum)
    skin_map: SkinMap | None = None

    @property
    def factor(self) -> float:
        """Factor from the scale of the views to true size."""
        return 1.0 if self.size is None else self.size.factor

    def with_size(self, measured: SizeMeasurement | None, model: FaceModel) -> KnownPerson:
        """Return the person with a measured size; unchanged without a measurement."""
        if measured is None:
            return self
        size = measured.size_of(person_shape(model, self.person).mean)
        templates = tuple(one.resized(size.factor / self.factor) for one in self.templates)
        return replace(self, size=size, shape=person_shape(model, self.person, size), templates=templates)

    def rescaled(self, ratio: float) -> KnownPerson:
        """Return the person for images scaled by a ratio.

        Templates contain their scale and do not change.
        """
        return replace(
            self,
            views=tuple(one.rescaled(ratio) for one in self.views),
            album=self.album.rescaled(ratio),
            skin=self.skin.rescaled(ratio),
            rms_px=ratio * self.rms_px,
        )

    def with_score(self, score: float) -> KnownPerson:
        """Update the running mean of scores."""
        before = score if np.isnan(self.mean_score) else self.mean_score
        return replace(self, mean_score=before + SCORE_RATE * (score - before))

    def after(self, view: PointView, score: float, adjuster: Adjuster) -> KnownPerson:
        """Adjust the person after a frame; ``views`` then ends with that frame, adjusted.

        Args:
            view: the frame with its tracked pose and deformation.
            score: mean correlation of its points.
            adjuster: for views of that camera.
        """
        settings = adjuster.settings
        if self.is_settled:
            return self._with_settled_view(view, score, adjuster)
        by_angles = settings.spread == "angles"
        views = choose_views(self.views, view, settings.views, by_angles=by_angles)
        start = PersonParameters(self.history.mean, self.person.offsets)
        adjusted = adjuster.adjust(views, start, iterations=settings.iterations, deviations=False)
        return replace(
            self,
            person=adjusted.person,
            history=self.history.with_identity(adjusted.person.identity),
            views=adjusted.views,
            album=self.album.with_view(adjusted.views[-1], score),
            shape=person_shape(adjuster.model, adjusted.person, self.size),
            adjusted_frames=self.adjusted_frames + 1,
            rms_px=rms(adjusted.residuals),
        )

    def _with_settled_view(self, view: PointView, score: float, adjuster: Adjuster) -> KnownPerson:
        """Adjust only pose and deformation of a frame to a settled person."""
        adjusted = self._adjusted_views((view,), adjuster, adjuster.settings.iterations)
        return replace(
            self,
            views=adjusted.views,
            album=self.album.with_view(adjusted.views[-1], score),
            adjusted_frames=self.adjusted_frames + 1,
            rms_px=rms(adjusted.residuals),
        )

    def _adjusted_views(self, views: Sequence[PointView], adjuster: Adjuster, iterations: int) -> Adjusted:
        """Adjust poses and deformations of views, with the person fixed."""
        closely = adjuster.over_recording
        return closely.adjust(
            views, self.person, iterations=iterations, hold_person=True, wide=True, deviations=False
        )

    def with_skin_map(self, adjuster: Adjuster) -> KnownPerson:
        """Return the person with a skin map for a second pass over the same images **[ours]**."""
        bare, shown = self.without_skin(), self._posed_skin(adjuster)
        if not shown:
            return bare
        return replace(bare, skin_map=make_map(shown, self._neutral(adjuster), (adjuster.camera,)))

    def matched_skin(self, adjuster: Adjuster) -> MatchedSkin | None:
        """Return the skin matched in all kept frames; None with too few."""
        shown = self._posed_skin(adjuster)
        return match_skin(shown, self._neutral(adjuster), (adjuster.camera,)) if shown else None

    def _posed_skin(self, adjuster: Adjuster) -> list[SkinView]:
        """Return the kept frames with poses adjusted to the person as now known."""
        if not self.skin.views:
            return []
        views = [one.view for one in self.skin.views]
        adjusted = self._adjusted_views(views, adjuster, adjuster.settings.start_iterations)
        return [replace(one, view=view) for one, view in zip(self.skin.views, adjusted.views, strict=True)]

    def _neutral(self, adjuster: Adjuster) -> FloatArray:
        """Return the neutral face (K, 3), mm, in the scale of the views."""
        return person_shape(adjuster.model, self.person).mean

    def without_skin(self) -> KnownPerson:
        """Return the person without data that is valid only for the images of one recording."""
        return replace(self, skin=SkinAlbum(), skin_map=None)

    def adjusted_over_album(self, adjuster: Adjuster) -> KnownPerson:
        """Return the person adjusted over the whole album, for a second pass **[ours]**."""
        if self.is_held:
            return replace(self, views=(), album=Album())
        views, settings = self.album.views, adjuster.settings
        if settings.when != "always" or not settings.whole or len(views) < 2:
            return self
        closely = adjuster.over_recording
        adjusted = closely.adjust(views, self.person, iterations=settings.start_iterations, wide=True)
        return replace(
            self,
            person=adjusted.person,
            history=IdentityHistory.starting_with(adjusted.person.identity, settings.average),
            views=(),
            album=Album(),
            shape=person_shape(adjuster.model, adjusted.person, self.size),
            rms_px=rms(adjusted.residuals),
            is_settled=True,
        )


def new_person(person: PersonParameters, reference: TemplateSet, adjuster: Adjuster) -> KnownPerson:
    """Return a newly initialised person."""
    history = IdentityHistory.starting_with(person.identity, adjuster.settings.average)
    return KnownPerson(person, history, (), Album(), person_shape(adjuster.model, person), (reference,))


def person_shape(model: FaceModel, person: PersonParameters, size: Size | None = None) -> ShapeModel:
    """Return the shape model of a person in the measured or, by default, the most likely size."""
    shape = model.of_person(person.identity, person.offsets)
    return shape if size is None else size.scale_shape(shape)


def rms(residuals: FloatArray) -> float:
    """Return the root mean square without NaN; NaN without values."""
    known = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


@dataclass(frozen=True, eq=False)
class IdentityHistory:
    """The last N_s identities.

    Attributes:
        identities: (m, S), 1 <= m <= N_s, the newest last.
        size: N_s.
    """

    identities: FloatArray
    size: int

    @classmethod
    def starting_with(cls, identity: FloatArray, size: int) -> IdentityHistory:
        """Return a history of up to ``size`` identities, starting with one (S,)."""
        return cls(np.array(identity, dtype=np.float64)[None], size)

    def with_identity(self, identity: FloatArray) -> IdentityHistory:
        """Append the identity of another adjustment; the oldest is dropped when full."""
        return replace(self, identities=np.vstack([self.identities, identity])[-self.size :])

    @property
    def mean(self) -> FloatArray:
        """(S,) start of the next adjustment, (4.36)."""
        mean: FloatArray = self.identities.mean(axis=0)
        return mean

    @property
    def spread(self) -> FloatArray:
        """(S,) standard deviations about the mean; 0 for a single identity."""
        spread: FloatArray = self.identities.std(axis=0)
        return spread


class PersonFitter:
    """Fits and updates a known person, frame by frame (chapter 4).

    Args:
        config: of the run.
        adjuster: for views of the camera.
    """

    def __init__(self, config: HeadMonoConfig, adjuster: Adjuster) -> None:
        self._config, self._adjuster = config, adjuster
        self._camera, self._model = adjuster.camera, adjuster.model
        self._frame_tracker = FrameTracker(config, (adjuster.camera,))

    def fit(self, person: KnownPerson, track: TrackState, frame: SeededFrame) -> FrameFit:
        """Track a person into a frame."""
        now = replace(track.particles, model=person.shape)  # the meaning of a does not depend on s
        before = replace(track, particles=now)
        return self._frame_tracker.step(before, frame, person.templates, person.shape)

    def fit_detection(
        self, person: KnownPerson, found: DetectedFace, last_seen_ns: int, frame: SeededFrame
    ) -> FrameFit:
        """Fit a person to a detected face; the fit has no velocity."""
        mean = person.shape.mean
        pose, _ = pose_of(found.pixels, found.responses, self._camera, mean)
        track = self._frame_tracker.start(frame, pose, mean, person.shape)
        fit = self.fit(person, replace(track, stamp_ns=last_seen_ns), frame)
        return replace(fit, track=fit.track.at_rest(), coefficient_rate=np.zeros_like(fit.coefficient_rate))

    def fit_anchored(
        self, person: KnownPerson, found: DetectedFace, last_seen_ns: int, frame: SeededFrame
    ) -> FrameFit:
        """Fit a detected face that resembles none of the person's templates.

        Templates are taken from this frame at the detected points, so that they stay there; the score is
        limited to the detection's.
        """
        mean = person.shape.mean
        pose, _ = pose_of(found.pixels, found.responses, self._camera, mean)
        seen = take_templates(RigImages((self._camera,), frame.frame.images), pose, mean, found.pixels[None])
        fit = self.fit_detection(replace(person, templates=(seen,)), found, last_seen_ns, frame)
        return replace(fit, score=min(fit.score, found.score), is_anchored=True)

    def initial_fit(
        self,
        frame: SeededFrame,
        found: DetectedFace,
        start: MonoInitialisation,
        seen: TemplateSet,
        measured: SizeMeasurement | None,
    ) -> FrameFit:
        """Return the fit of a frame with a detected face before tracking starts."""
        shape = person_shape(self._model, start.person)
        pose = start.views[-1].pose
        if measured is not None:
            size = measured.size_of(shape.mean)
            pose, shape, seen = (
                scaled_pose(pose, size.factor),
                size.scale_shape(shape),
                seen.resized(size.factor),
            )
        own = self._on_rays(pose, shape.mean, found.pixels)
        track = self._frame_tracker.start(frame, pose, own, shape, seen)
        return initial_fit(track, found.score, found.pixels[None])

    def update_person(
        self,
        person: KnownPerson,
        before: TrackState | None,
        frame: SeededFrame,
        fit: FrameFit,
        measured: SizeMeasurement | None = None,
    ) -> tuple[KnownPerson, FrameFit]:
        """Adjust the person by a tracked frame; return it and the adjusted fit."""
        person = person.with_score(fit.score)
        if self._shows_person(person, fit):
            person = person.after(self._view(person, frame, fit), fit.score, self._adjuster)
            if not person.is_settled:
                before_size, person = person.factor, person.with_size(measured, self._model)
                fit = _with_size(fit, person.factor / before_size)
            fit = self._adjusted(before, person, fit)
        if fit.track.templates is not None and self._is_keyframe(person, fit):
            keyframe = self._keyframe(fit.track.templates, fit.correlations)
            person = replace(person, templates=(*person.templates, keyframe))
        return person, fit

    def wants_skin(self, person: KnownPerson, frame: SeededFrame, fit: FrameFit) -> bool:
        """Whether the frame of a first pass is kept for the skin map."""
        wanted = self._config.skin.use and person.skin_map is None
        return wanted and person.skin.wants(frame.stamp_ns, fit.track.pose)

    def keep_skin(self, person: KnownPerson, frame: SeededFrame, fit: FrameFit) -> KnownPerson:
        """Return the person with a frame's skin **[ours]**.

        Args:
            person: who is seen.
            frame: with the image in the scale of the face.
            fit: of the frame.
        """
        (image,) = frame.frame.images
        if image is None:
            return person
        shown = cut_view((image,), (self._camera,), self._view(person, frame, fit))
        return replace(person, skin=person.skin.with_view(shown, MOST_VIEWS))

    def fit_on_skin(self, person: KnownPerson, frame: SeededFrame, fit: FrameFit) -> FrameFit:
        """Return the fit with a pose between those of feature points and skin **[ours]**.

        The points stay at their pixels; the deformation becomes the most likely one for them.
        """
        images = frame.frame.images
        if person.skin_map is None or images[0] is None:
            return fit
        by_points, factor = fit.track.pose, person.factor
        in_map = scaled_pose(by_points, 1.0 / factor)  # the map has the scale of the views
        found = pose_on_map(person.skin_map, images, frame.stamp_ns, in_map, (self._camera,))
        pose, pixels = scaled_pose(found.pose, factor), fit.pixels[0]
        coefficients = self._deformation_at(pose, person.shape, pixels, fit.weights)
        shape = self._on_rays(pose, person.shape.shapes(coefficients), pixels)
        refined = replace(fit, track=replace(fit.track, pose=pose, shape=shape), coefficients=coefficients)
        return replace(refined, unmatched=found.unmatched, skin_share=found.share)

    def _deformation_at(
        self, pose: HeadPose, face: ShapeModel, pixels: FloatArray, weights: FloatArray
    ) -> FloatArray:
        """Return the most likely coefficients (B,) of points at pixels (K, 2), with the pose fixed."""
        expected, slopes = pixels_and_jacobian(self._camera, pose.points(face.mean))
        seen = np.isfinite(pixels).all(axis=1) & (weights > 0.0)
        scale = np.sqrt(weights[seen]) / self._adjuster.over_recording.settings.pixel_sd.values[seen]
        J = scale[:, None, None] * (slopes[seen] @ (pose.rotation @ face.basis[seen]))
        rest = scale[:, None] * (pixels[seen] - expected[seen])
        precision = np.diag(np.maximum(face.deviations, LEAST_DEVIATION_MM) ** -2)
        matrix = precision + np.einsum("kia,kib->ab", J, J)
        return np.linalg.solve(matrix, np.einsum("kia,ki->a", J, rest))

    def _shows_person(self, person: KnownPerson, fit: FrameFit) -> bool:
        """Whether a frame is suitable to adjust the person (4.4.3).

        The face must look at the camera, match its templates and, unless the person is settled, be nearly
        neutral **[ours]**.
        """
        settings = self._config.adjustment
        clear = off_axis_deg(fit.track.pose) < settings.facing_deg and fit.score > settings.score
        harmless = person.is_settled or _deformed_mm(person, fit) < settings.neutral_mm
        return settings.when == "always" and clear and harmless

    def _view(self, person: KnownPerson, frame: SeededFrame, fit: FrameFit) -> PointView:
        a = fit.coefficients + self._model.deformation_mean
        weights = np.where(np.isfinite(fit.pixels[0, :, 0]), fit.weights, 0.0)
        pose = scaled_pose(fit.track.pose, 1.0 / person.factor)
        return PointView(frame.stamp_ns, fit.pixels[0], weights, pose, a)

    def _adjusted(self, before: TrackState | None, person: KnownPerson, fit: FrameFit) -> FrameFit:
        """Return the fit with pose and deformation of the adjustment."""
        view, now = person.views[-1], fit.track
        coefficients, pose = (
            view.deformation - self._model.deformation_mean,
            scaled_pose(view.pose, person.factor),
        )
        velocity, rate = now.velocity, fit.coefficient_rate
        if before is not None and np.any(velocity):
            velocity = velocity_between(before.pose, pose, fit.dt)
            rate = rate + (coefficients - fit.coefficients) / fit.dt
        track = replace(
            now,
            pose=pose,
            velocity=velocity,
            particles=now.particles.moved_to(pose, coefficients),
            shape=self._on_rays(pose, person.shape.shapes(coefficients), fit.pixels[0]),
        )
        return replace(fit, track=track, coefficients=coefficients, coefficient_rate=rate)

    def _on_rays(self, pose: HeadPose, shape: FloatArray, pixels: FloatArray) -> FloatArray:
        """Return the points (K, 3) in the head's frame at pixels (K, 2) and a shape's depths."""
        depths = pose.points(shape)[:, 2:]
        points = np.hstack([normalised_from_pixels(self._camera, pixels) * depths, depths])
        return np.where(np.isfinite(points), (points - pose.position) @ pose.rotation, shape)

    def _is_keyframe(self, person: KnownPerson, fit: FrameFit) -> bool:
        """Whether a nearly neutral face is seen from a direction without templates."""
        neutral = _deformed_mm(person, fit) < KEYFRAME_NEUTRAL_MM
        clear = neutral and fit.score > KEYFRAME_CORRELATION
        apart_deg = self._config.refinement.keyframe_deg
        return clear and is_new_direction(person.templates, fit.track.pose.facing, apart_deg)

    def _keyframe(self, templates: TemplateSet, correlations: FloatArray) -> TemplateSet:
        """Return a frame's templates without poorly correlated points."""
        alike = np.nan_to_num(correlations) > KEYFRAME_CORRELATION
        return replace(templates, seen=templates.seen & alike)


def scaled_pose(pose: HeadPose, factor: float) -> HeadPose:
    """Return the pose at which a head scaled by a factor looks the same."""
    return pose if factor == 1.0 else HeadPose(factor * pose.position, pose.quaternion)


def _with_size(fit: FrameFit, factor: float) -> FrameFit:
    """Return a fit whose templates belong to a head scaled by a factor."""
    if fit.track.templates is None:
        return fit
    return replace(fit, track=replace(fit.track, templates=fit.track.templates.resized(factor)))


def _deformed_mm(person: KnownPerson, fit: FrameFit) -> float:
    """Return the distance from the mean deformation, mm (norm of 3K values)."""
    return float(np.linalg.norm(person.shape.basis @ fit.coefficients))
