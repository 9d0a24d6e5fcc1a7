"""Who is tracked: identity and size, learned while tracking."""

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
from posetrack_cli.head.skin.map import SkinMap, cut_view, make_map, pose_on_map
from posetrack_cli.head.skin.matching import EVERY_NS, MOST_VIEWS, SkinAlbum
from posetrack_cli.head.tracker.face_learning import off_axis_deg
from posetrack_cli.head.tracker.frame_tracker import (
    FrameFit,
    FrameTracker,
    SeededFrame,
    TrackState,
    initial_fit,
)
from posetrack_cli.results.columns import floats

# How large a head is, where that is told: one camera does not see it **[ours]**.
#
# Images stay the same where all lengths are multiplied by one factor c. Of c alone is known that the
# likeliest face has 1: log c ~ N(0, m^2). A distance X of the pupils, measured with the standard deviation
# s_X, tells
#
#     log X = log c + log D + e,    e ~ N(0, s^2),    s^2 = (s_X^2 + s_D^2) / X^2
#
# with D the same distance of the person whom the images were adjusted to, c = 1, known to s_D. So
#
#     log c = k log (X / D),    sd(log c) = m sqrt(1 - k),    k = m^2 / (m^2 + s^2).
#
# Pupils are taken to lie midway between the corners of their eye. In the statistics that the shipped model
# comes from, ICT-FaceKit's, these middles are 63.0 mm apart on average, and people's pupils 63.4 (Dodgson
# 2004, 3976 adults). The corners that are followed lie ``CORNERS_OUTSIDE_MM`` farther out than those
# landmarks.


CORNERS_OUTSIDE_MM = 2.1
"""So much farther apart are the middles of eyes' corners as they are followed, in true mm, than as the
statistics' landmarks have them: over ten people of the study, whose recordings have the landmarks' places; it
spreads by 1.0 mm between them. It is 2.7 and 4.9 mm for two more. Where corners are found by what was learned
without the person it is 1.1 mm, and spreads by 2.1 mm (1.4 mm without one of them)."""
SMALLEST_SIZE, LARGEST_SIZE = 0.2, 5.0
"""Of any head beside the likeliest; a measurement that tells more is of something else."""
CORNERS_SD_MM = 1.1
"""s_D: the middles of eyes' corners, as followed, are pupils to within this, by nine of ten people of the
study."""
PRIOR_SD = 0.035
"""m: one camera does not see how large a head is. Chosen on the same people."""
DOUBTFUL = 2.5
"""Standard deviations between what is told and what is likely: one person in eighty."""
LEAST_MM = 1.0
"""A model may have faces whose eyes touch: even then logarithms are numbers."""
_RIGHT_EYE, _LEFT_EYE = slice(0, 2), slice(2, 4)


class Size(NamedTuple):
    """What all lengths of a person are multiplied by.

    Attributes:
        factor: c.
        sd: of log c.
    """

    factor: Annotated[float, floats(least=SMALLEST_SIZE, most=LARGEST_SIZE)]
    sd: Annotated[float, floats(least=0.0, most=1.0)]

    def of_shape(self, shape: ShapeModel) -> ShapeModel:
        """Return how a face of that size deforms."""
        return ShapeModel(self.factor * shape.mean, self.factor * shape.basis, shape.deviations)


class SizeMeasurement(Protocol):
    """What tells how large a person is."""

    def size_of(self, shape: FloatArray) -> Size:
        """Return the size of a person whom images were adjusted to as the neutral shape (K, 3), mm."""


@dataclass(frozen=True)
class PupilDistance:
    """A measured distance of the pupils.

    Attributes:
        distance_mm: X.
        sd_mm: of X beside D, s times X.
        prior_sd: m.
    """

    distance_mm: float
    sd_mm: float
    prior_sd: float = PRIOR_SD

    def size_of(self, shape: FloatArray) -> Size:
        """Return c and its deviation."""
        return _updated(self.distance_mm / pupil_distance(shape), self._sd, self.prior_sd)

    def doubt(self, shape: FloatArray) -> tuple[str, ...]:
        """Return a line where the person (K, 3) would be of a size that hardly anybody has."""
        seen = pupil_distance(shape)
        if abs(np.log(self.distance_mm / seen)) <= DOUBTFUL * float(np.hypot(self._sd, self.prior_sd)):
            return ()
        return (
            f"pupils {self.distance_mm:.3g} mm apart are told, but those of the likeliest such face are"
            f" {seen:.0f} mm apart: is the distance right, and does posetrack view show points at the corners"
            " of the eyes?",
        )

    @property
    def _sd(self) -> float:
        """s."""
        return self.sd_mm / self.distance_mm


def pupil_distance(shape: FloatArray) -> float:
    """Return D, mm, of a shape (K, 3) of followed points."""
    middles = shape[_LEFT_EYE].mean(axis=0) - shape[_RIGHT_EYE].mean(axis=0)
    return max(float(np.linalg.norm(middles)) - CORNERS_OUTSIDE_MM, LEAST_MM)


def _updated(ratio: float, sd: float, prior_sd: float) -> Size:
    """Return the size after one measurement of c: the Kalman step of its logarithm."""
    gain = prior_sd**2 / (prior_sd**2 + sd**2) if prior_sd > 0.0 else 0.0
    factor = float(np.clip(np.exp(gain * np.log(ratio)), SMALLEST_SIZE, LARGEST_SIZE))
    return Size(factor, float(prior_sd * np.sqrt(1.0 - gain)))


# The person before a camera: what is known, tracking into a frame, and what the frame adds (4.3.2, 4.4)


USUAL_RATE = 0.05
"""Share of a frame in the running mean of scores: twenty frames, longer than a blink or a word, count."""


@dataclass(frozen=True, eq=False)
class KnownPerson:
    """One person as far as frames have told.

    Attributes:
        person: identity and offsets; the views, too, are as large as these make the face.
        history: of identities, (4.36).
        views: n frames that are adjusted together.
        album: frames that show the face from all sides, for an adjustment over the whole recording.
        shape: how this person's face deforms, in true size.
        templates: reference first.
        adjusted_frames: how many frames the person was adjusted from.
        rms_px: of the last adjustment, root mean square.
        usual_score: running mean of the scores of tracked frames; NaN before the first.
        is_settled: whether a whole recording has said who it is; single frames then do no more **[ours]**.
        is_held: whether a user has said who it is: nothing is adjusted.
        size: what was told of it; None where nothing was.
        skin: frames of this recording that show it, for a second pass; as large as the views.
        skin_map: made of those of a first pass; None in a first one.
    """

    person: PersonParameters
    history: IdentityHistory
    views: tuple[PointView, ...]
    album: Album
    shape: ShapeModel
    templates: tuple[TemplateSet, ...]
    adjusted_frames: int = 0
    rms_px: float = np.nan
    usual_score: float = np.nan
    is_settled: bool = False
    is_held: bool = False
    size: Size | None = None
    skin: SkinAlbum = field(default_factory=SkinAlbum)
    skin_map: SkinMap | None = None

    @property
    def factor(self) -> float:
        """What lengths of the views are multiplied by to be true ones."""
        return 1.0 if self.size is None else self.size.factor

    def with_size(self, told: SizeMeasurement | None, model: FaceModel) -> KnownPerson:
        """Return the person as large as a measurement tells; without one unchanged."""
        if told is None:
            return self
        size = told.size_of(person_shape(model, self.person).mean)
        templates = tuple(one.of_size(size.factor / self.factor) for one in self.templates)
        return replace(self, size=size, shape=person_shape(model, self.person, size), templates=templates)

    def seen_larger(self, ratio: float) -> KnownPerson:
        """Return the person as images show it that are so many times as large.

        Templates know how large they are, and stay.
        """
        return replace(
            self,
            views=tuple(one.seen_larger(ratio) for one in self.views),
            album=self.album.seen_larger(ratio),
            skin=self.skin.seen_larger(ratio),
            rms_px=ratio * self.rms_px,
        )

    def with_score(self, score: float) -> KnownPerson:
        """Return what is known after a frame with a score."""
        before = score if np.isnan(self.usual_score) else self.usual_score
        return replace(self, usual_score=before + USUAL_RATE * (score - before))

    def after(self, view: PointView, score: float, adjuster: Adjuster) -> KnownPerson:
        """Return what is known after a frame; ``views`` then ends with that frame, adjusted.

        Args:
            view: the frame, its pose and deformation as the filter has them.
            score: mean correlation of its points.
            adjuster: of views of that camera.
        """
        settings = adjuster.settings
        if self.is_settled:
            return self._seen_again(view, score, adjuster)
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

    def _seen_again(self, view: PointView, score: float, adjuster: Adjuster) -> KnownPerson:
        """Return the same person after a frame: its pose and deformation alone are adjusted."""
        adjusted = self._adjusted_views((view,), adjuster, adjuster.settings.iterations)
        return replace(
            self,
            views=adjusted.views,
            album=self.album.with_view(adjusted.views[-1], score),
            adjusted_frames=self.adjusted_frames + 1,
            rms_px=rms(adjusted.residuals),
        )

    def _adjusted_views(self, views: Sequence[PointView], adjuster: Adjuster, iterations: int) -> Adjusted:
        """Adjust poses and deformations of views to the person as known, who is held."""
        closely = adjuster.over_recording
        return closely.adjust(
            views, self.person, iterations=iterations, hold_person=True, wide=True, deviations=False
        )

    def with_skin_map(self, adjuster: Adjuster) -> KnownPerson:
        """Return the person with a map of the skin, for a second pass over these images **[ours]**.

        The frames' poses are those that the person's points, as they are now known, have there.
        """
        shown, bare = self.skin.views, self.without_skin()
        if not shown:
            return bare
        views = [one.view for one in shown]
        adjusted = self._adjusted_views(views, adjuster, adjuster.settings.start_iterations)
        posed = [replace(one, view=view) for one, view in zip(shown, adjusted.views, strict=True)]
        shape = person_shape(adjuster.model, self.person).mean
        return replace(bare, skin_map=make_map(posed, shape, adjuster.camera))

    def without_skin(self) -> KnownPerson:
        """Return the person without what holds for images of one recording alone."""
        return replace(self, skin=SkinAlbum(), skin_map=None)

    def over_album(self, adjuster: Adjuster) -> KnownPerson:
        """Return the person adjusted from the whole album, for a second pass **[ours]**."""
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
    """Return what is known of a person who was just found, or whom another tracker has learned."""
    history = IdentityHistory.starting_with(person.identity, adjuster.settings.average)
    return KnownPerson(person, history, (), Album(), person_shape(adjuster.model, person), (reference,))


def person_shape(model: FaceModel, person: PersonParameters, size: Size | None = None) -> ShapeModel:
    """Return how a person's face deforms, in the size that was told or, without, in the likeliest."""
    shape = model.of_person(person.identity, person.offsets)
    return shape if size is None else size.of_shape(shape)


def rms(residuals: FloatArray) -> float:
    """Return the root mean square of distances, NaN left out; NaN of none."""
    known = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


@dataclass(frozen=True, eq=False)
class IdentityHistory:
    """The last N_s identities; ``identities`` and ``size`` are all that a checkpoint must keep.

    Attributes:
        identities: (m, S), 1 <= m <= N_s, the newest last.
        size: N_s.
    """

    identities: FloatArray
    size: int

    @classmethod
    def starting_with(cls, identity: FloatArray, size: int) -> IdentityHistory:
        """Return a history that begins with one identity (S,) and keeps ``size`` of them."""
        return cls(np.array(identity, dtype=np.float64)[None], size)

    def with_identity(self, identity: FloatArray) -> IdentityHistory:
        """Return the history after another adjustment; the oldest goes where there are too many."""
        return replace(self, identities=np.vstack([self.identities, identity])[-self.size :])

    @property
    def mean(self) -> FloatArray:
        """(S,) start of the next adjustment, (4.36)."""
        mean: FloatArray = self.identities.mean(axis=0)
        return mean

    @property
    def spread(self) -> FloatArray:
        """(S,) standard deviations about the mean: how far estimates still wander; 0 of one."""
        spread: FloatArray = self.identities.std(axis=0)
        return spread


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

    def fit_from(
        self, person: KnownPerson, track: TrackState, there: HeadPose, frame: SeededFrame
    ) -> FrameFit:
        """Return what a frame says of a person who was tracked before and now is about elsewhere."""
        about = replace(track.at_rest(), pose=there, particles=replace(track.particles, pose=there))
        fit = self.fit(person, about, frame)
        velocity = velocity_between(track.pose, fit.track.pose, fit.dt)
        return replace(fit, track=replace(fit.track, velocity=velocity))

    def fit_detection(
        self, person: KnownPerson, found: DetectedFace, last_seen_ns: int, frame: SeededFrame
    ) -> FrameFit:
        """Return what a frame says of a detected face if it is a person's; it is at rest."""
        mean = person.shape.mean
        pose, _ = pose_of(found.pixels, found.responses, self._camera, mean)
        track = self._frame_tracker.start(frame, pose, mean, person.shape)
        fit = self.fit(person, replace(track, stamp_ns=last_seen_ns), frame)
        return replace(fit, track=fit.track.at_rest(), coefficient_rate=np.zeros_like(fit.coefficient_rate))

    def fit_anchored(
        self, person: KnownPerson, found: DetectedFace, last_seen_ns: int, frame: SeededFrame
    ) -> FrameFit:
        """Return what a frame says of a face that is a person's, but looks like none of its templates.

        The points are held by what they look like in this very frame; its score is the detection's.
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
        told: SizeMeasurement | None,
    ) -> FrameFit:
        """Return what a frame says in which a face was detected that is not tracked yet."""
        shape = person_shape(self._model, start.person)
        pose = start.views[-1].pose
        if told is not None:
            size = told.size_of(shape.mean)
            pose, shape, seen = farther(pose, size.factor), size.of_shape(shape), seen.of_size(size.factor)
        own = self._on_rays(pose, shape.mean, found.pixels)
        track = self._frame_tracker.start(frame, pose, own, shape, seen)
        return initial_fit(track, found.score, found.pixels[None])

    def update_person(
        self,
        person: KnownPerson,
        before: TrackState | None,
        frame: SeededFrame,
        fit: FrameFit,
        told: SizeMeasurement | None = None,
    ) -> tuple[KnownPerson, FrameFit]:
        """Adjust the person by a frame in which it was found; return it and what the frame then says."""
        person = person.with_score(fit.score)
        if self._shows_person(person, fit):
            person = person.after(self._view(person, frame, fit), fit.score, self._adjuster)
            if not person.is_settled:
                before_size, person = person.factor, person.with_size(told, self._model)
                fit = _of_size(fit, person.factor / before_size)
            fit = self._adjusted(before, person, fit)
        if fit.track.templates is not None and self._is_keyframe(person, fit):
            keyframe = self._keyframe(fit.track.templates, fit.correlations)
            person = replace(person, templates=(*person.templates, keyframe))
        return person, fit

    def wants_skin(self, person: KnownPerson, frame: SeededFrame, fit: FrameFit) -> bool:
        """Whether a frame of a first pass is to be kept for what it shows of the skin."""
        wanted = self._config.skin.use and person.skin_map is None
        return wanted and person.skin.wants(frame.stamp_ns, fit.track.pose)

    def keep_skin(self, person: KnownPerson, frame: SeededFrame, fit: FrameFit) -> KnownPerson:
        """Return the person with what a frame shows of the skin **[ours]**.

        Args:
            person: who is seen.
            frame: its image as large as the face's points are in it.
            fit: of the frame.
        """
        (image,) = frame.frame.images
        if image is None:
            return person
        album = person.skin if person.skin.views else SkinAlbum(every_ns=EVERY_NS)
        shown = cut_view(image, self._camera, self._view(person, frame, fit))
        return replace(person, skin=album.with_view(shown, MOST_VIEWS))

    def fit_on_skin(self, person: KnownPerson, frame: SeededFrame, fit: FrameFit) -> FrameFit:
        """Return what a frame says with a pose between its feature points' and its skin's **[ours]**.

        The points stay where they are in the image, the deformation is the likeliest of those.
        """
        (image,) = frame.frame.images
        if person.skin_map is None or image is None:
            return fit
        by_points, factor = fit.track.pose, person.factor
        told = farther(by_points, 1.0 / factor)
        found = pose_on_map(person.skin_map, image, frame.stamp_ns, told, self._camera)
        pose, pixels = farther(found.pose, factor), fit.pixels[0]
        coefficients = self._deformation_at(pose, person.shape, pixels, fit.weights)
        shape = self._on_rays(pose, person.shape.shapes(coefficients), pixels)
        stated = replace(fit, track=replace(fit.track, pose=pose, shape=shape), coefficients=coefficients)
        return replace(stated, unmatched=found.unmatched, skin_share=found.share)

    def _deformation_at(
        self, pose: HeadPose, face: ShapeModel, pixels: FloatArray, weights: FloatArray
    ) -> FloatArray:
        """The likeliest coefficients (B,) of a face at a pose whose points are seen at pixels (K, 2)."""
        expected, slopes = pixels_and_jacobian(self._camera, pose.points(face.mean))
        seen = np.isfinite(pixels).all(axis=1) & (weights > 0.0)
        scale = np.sqrt(weights[seen]) / self._adjuster.over_recording.settings.pixel_sd.values[seen]
        J = scale[:, None, None] * (slopes[seen] @ (pose.rotation @ face.basis[seen]))
        rest = scale[:, None] * (pixels[seen] - expected[seen])
        precision = np.diag(np.maximum(face.deviations, LEAST_DEVIATION_MM) ** -2)
        matrix = precision + np.einsum("kia,kib->ab", J, J)
        return np.linalg.solve(matrix, np.einsum("kia,ki->a", J, rest))

    def _shows_person(self, person: KnownPerson, fit: FrameFit) -> bool:
        """Whether a face looks at the camera and like itself (4.4.3), and is little deformed **[ours]**.

        Of a person who is settled a deformed face tells nothing wrong.
        """
        settings = self._config.adjustment
        clear = off_axis_deg(fit.track.pose) < settings.facing_deg and fit.score > settings.score
        harmless = person.is_settled or _deformed_mm(person, fit) < settings.neutral_mm
        return settings.when == "always" and clear and harmless

    def _view(self, person: KnownPerson, frame: SeededFrame, fit: FrameFit) -> PointView:
        a = fit.coefficients + self._model.deformation_mean
        weights = np.where(np.isfinite(fit.pixels[0, :, 0]), fit.weights, 0.0)
        pose = farther(fit.track.pose, 1.0 / person.factor)
        return PointView(frame.stamp_ns, fit.pixels[0], weights, pose, a)

    def _adjusted(self, before: TrackState | None, person: KnownPerson, fit: FrameFit) -> FrameFit:
        """Return what a frame says after the adjustment that it took part in."""
        view, now = person.views[-1], fit.track
        coefficients, pose = (
            view.deformation - self._model.deformation_mean,
            farther(view.pose, person.factor),
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
        """The points (K, 3) in the head's frame that are seen at pixels (K, 2), as deep as a shape's."""
        depths = pose.points(shape)[:, 2:]
        points = np.hstack([normalised_from_pixels(self._camera, pixels) * depths, depths])
        return np.where(np.isfinite(points), (points - pose.position) @ pose.rotation, shape)

    def _is_keyframe(self, person: KnownPerson, fit: FrameFit) -> bool:
        """Whether a frame shows the nearly neutral face from a direction of which nothing is kept."""
        neutral = _deformed_mm(person, fit) < KEYFRAME_NEUTRAL_MM
        clear = neutral and fit.score > KEYFRAME_CORRELATION
        apart_deg = self._config.refinement.keyframe_deg
        return clear and is_new_direction(person.templates, fit.track.pose.facing, apart_deg)

    def _keyframe(self, templates: TemplateSet, correlations: FloatArray) -> TemplateSet:
        """A frame's templates without the points that do not look like themselves: they may have left."""
        alike = np.nan_to_num(correlations) > KEYFRAME_CORRELATION
        return replace(templates, seen=templates.seen & alike)


def farther(pose: HeadPose, factor: float) -> HeadPose:
    """Return where a head so many times as large looks the same."""
    return pose if factor == 1.0 else HeadPose(factor * pose.position, pose.quaternion)


def _of_size(fit: FrameFit, factor: float) -> FrameFit:
    """Return a fit whose frame's templates are of a head so many times as large."""
    if fit.track.templates is None:
        return fit
    return replace(fit, track=replace(fit.track, templates=fit.track.templates.of_size(factor)))


def _deformed_mm(person: KnownPerson, fit: FrameFit) -> float:
    """How far the face is from its mean deformation: the length of 3K numbers, mm."""
    return float(np.linalg.norm(person.shape.basis @ fit.coefficients))
