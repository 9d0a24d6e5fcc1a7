"""One-camera part of the head tracker: detects, recognises and learns people (chapter 4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.actions import MEAN_DISPLACEMENTS
from posetrack_cli.head.adjustment.adjuster import Adjuster
from posetrack_cli.head.adjustment.focal_length import focal_length_check
from posetrack_cli.head.config import HeadMonoConfig, PersonSettings
from posetrack_cli.head.detection.detector import CERTAIN, FaceDetector
from posetrack_cli.head.face.points import (
    UNSCALED,
    HeadPose,
    Scaling,
    enlarged,
    reduced,
    scaled_camera,
    scaled_pixels,
)
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import TemplateSet
from posetrack_cli.head.initialisation.clicked import ClickedPoints
from posetrack_cli.head.initialisation.mono import (
    DetectedFace,
    MonoInitialisation,
    MonoInitialiser,
    eye_distance_px,
    face_at,
)
from posetrack_cli.head.initialisation.search import InitFailure
from posetrack_cli.head.landmarks.faces import LandmarkFile, Landmarks
from posetrack_cli.head.lens.lens import EstimatedLens
from posetrack_cli.head.multilinear.face_model import FaceModel, load_face_model
from posetrack_cli.head.particles.particles import velocity_between
from posetrack_cli.head.skin.map import MatchedSkin
from posetrack_cli.head.subject import MONO_TRACK, MonoDiagnostics, mono_diagnostic_names
from posetrack_cli.head.tracker.codecs import (
    FOCAL_PX,
    MonoState,
    ReportedPose,
    damaged_people,
    is_cut,
    known_people,
    mono_codec,
    people_codec,
    thumbnail,
)
from posetrack_cli.head.tracker.face_learning import off_axis_deg
from posetrack_cli.head.tracker.frame_tracker import MONO, MONO_WITH_SKIN, FrameFit, SeededFrame, TrackState
from posetrack_cli.head.tracker.head_tracker import FaceDescription, HeadTracker, dense_faces
from posetrack_cli.head.tracker.person import (
    CORNERS_SD_MM,
    PRIOR_SD,
    KnownPerson,
    PersonFitter,
    PupilDistance,
    Size,
    new_person,
    person_shape,
)
from posetrack_cli.head.tracker.whole_face import whole_face_fit
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import Arrays
from posetrack_cli.tracking.confidence import Regression
from posetrack_cli.tracking.state_codec import Codec
from posetrack_cli.tracking.two_pass import Learned

NEW_PERSON_FRAMES = 45
"""Frames with a face unlike all known ones after which it becomes a new person **[ours]**."""
NEW_PERSON_FRAMES_AFTER_CUT = 6
"""The same after a scene cut to a face at another place or of another size."""
JUMP_EYES, JUMP_RATIO = 1.2, 1.35
"""Distance, in eye distances, and size ratio from which a face is elsewhere. A fast head near the camera
changes the image like a cut but stays near its place."""
RECOGNITION_SHARE = 0.85
"""After a cut, share of the usual score that a known person must reach. Until then the face is tracked
without learning."""
RESEMBLANCE_SHARE = 0.75
"""Share of the usual score that the only person must reach to be found again among others."""
LEAST_SIMILARITY = 0.2
"""Minimum score for following a face at the last place and size without its templates, which do not match a
turned or blurred face."""
NEW_PERSON_OFF_AXIS_DEG = 25.0
"""Only faces that look at the camera count as a new person: profiles differ from the templates anyway."""
SWITCH_MARGIN = 0.03
"""Minimum score gain for a new detection to replace the track."""
CANDIDATE_SPAN_S = 2.0
"""Longest time span of the frames that initialise a face."""
CHECK_EVERY_S = 0.5
"""Minimum time between detections in frames with a poor fit."""
BEGIN_AGAIN_S = 0.2
"""Minimum time between detections while the person was begun from a turned face."""
POSITION_TIMEOUT_S = 1.0
"""After this time without the face, it may return anywhere in the image."""


@dataclass(frozen=True, eq=False)
class _ScalePipeline:
    """Objects that depend on the camera of scaled images."""

    adjuster: Adjuster
    initialiser: MonoInitialiser
    fitter: PersonFitter


class MonoPeople:
    """People in the images of one camera; implements ``Faces``.

    Images are scaled to the face size for which patches are made; see ``face.points``. Until a face is found,
    and for detecting small faces, images are used unscaled.

    Args:
        config: of the run.
        camera: of the recording.
        model: face model.
        choice: face to start with, 0 is the largest.
        clicked: points in the first frame; without them the face is detected there as well.
        known: exported people and templates to start from.
        landmarks: of the recorded images, from another program.
        systematic_sd: (6,) standard deviations of the systematic error of a track.
        lens: uncertainty of the camera if its focal length was estimated.
        follows_one: another person is not tracked, even after a cut.

    Raises:
        UsageError: a face detector without its model.
        ResultError: ``known`` was not exported by a one-camera tracker with this model.
    """

    def __init__(
        self,
        config: HeadMonoConfig,
        camera: Camera,
        model: FaceModel,
        *,
        choice: int = 0,
        clicked: ClickedPoints | None = None,
        known: Arrays | None = None,
        landmarks: LandmarkFile | None = None,
        systematic_sd: FloatArray = MONO_TRACK.systematic_sd,
        lens: EstimatedLens | None = None,
        follows_one: bool = False,
    ) -> None:
        self._config, self._recorded, self._model, self._lens = config, camera, model, lens
        self._follows_one = follows_one
        self._systematic_sd = systematic_sd
        self._landmarks = landmarks
        self._pupil_distance = interpupillary_distance(config.person)
        self.cameras, self.status = (camera,), config.status
        # the papers' configurations, which have no dense face, look once
        self._detector = FaceDetector(config.start.detection, twice=config.face.use)
        self._choice, self._clicked = choice, clicked
        self._scaling = Scaling(config.start.eye_distance_px, config.start.largest_scale, camera)
        self._pipelines: dict[float, _ScalePipeline] = {}
        self._people = people_codec(model, config.adjustment)
        self.codec: Codec[MonoState] = mono_codec(self._people)
        self._first = self._known_state(known) if known else MonoState(scale=self._clicked_scale())

    @property
    def identity_size(self) -> int:
        """Number of identity coefficients."""
        return self._model.identity_size

    def start(self) -> MonoState:
        """Return the state before the first frame."""
        return self._first

    def prepare(self, state: MonoState, frame: Frame) -> tuple[MonoState, Frame]:
        """Return the frame, reduced for a large face, and the state with its scale and scene."""
        state = self._rescaled(state)
        frame = reduced(frame, state.scale or UNSCALED)
        (image,) = frame.images
        if image is None:
            return state, frame
        scene = thumbnail(image)
        cut = state.cut or (state.scene is not None and is_cut(state.scene, scene))
        return replace(state, scene=scene, cut=cut), frame

    def is_known(self, state: MonoState) -> bool:
        """Whether a person has been learned."""
        return bool(state.people)

    def person_index(self, state: MonoState) -> int:
        """Return the index of the current person."""
        return state.current

    def detect(self, state: MonoState, frame: SeededFrame) -> DetectedFace | InitFailure:
        """Detect a face, near the last position unless that is outdated."""
        return self._detect_near(state, frame.frame, self._last_pixels(state, frame), thoroughly=False)

    def begin(self, state: MonoState, frame: SeededFrame) -> tuple[MonoState, FrameFit | InitFailure]:
        """Detect a new person.

        The first one determines the image scale; the frame is then processed again.
        """
        after, fit = self._begin(state, frame)
        scale = state.scale if state.scale is not None else self._scale_of(after)
        after = replace(after, scale=scale)
        if state.scale == scale or scale == UNSCALED:
            return after, fit
        # templates and pixels of the unscaled image are of no use at the new scale
        rescaled = replace(self._first, scale=scale, search=state.search, first_ns=state.first_ns)
        rescaled, again = self.prepare(rescaled, frame.frame)
        return self._begin(rescaled, SeededFrame(again, frame.rng))

    def fit(self, state: MonoState, track: TrackState, frame: SeededFrame) -> tuple[MonoState, FrameFit]:
        """Track the person into a frame; compare a poor fit with a new detection **[ours]**.

        After a blink or a smile points may slide to places from which they do not return. Landmarks detect
        that even where the fit's score does not.
        """
        if state.is_provisional and frame.stamp_ns - state.checked_ns >= BEGIN_AGAIN_S * 1e9:
            state = replace(state, checked_ns=frame.stamp_ns)
            begun = self._begin_again(state, track, frame)
            if begun is not None:
                return begun
        fitter, settings = self._pipeline(state).fitter, self._config.status
        here = self._enlarged(state, frame, self._pixels_of(state, track))
        fit = self._or_whole_face_fit(state, track, here, fitter.fit(state.person, track, here))
        recent = frame.stamp_ns - state.checked_ns < CHECK_EVERY_S * 1e9
        if recent or (fit.score >= settings.check_below and not self._has_slid(state, frame, fit)):
            return state, fit
        state = replace(state, checked_ns=frame.stamp_ns)
        found = self.detect(state, frame)
        if isinstance(found, InitFailure):
            return state, fit
        there = self._enlarged(state, frame, found.pixels)
        again = fitter.fit_detection(state.person, found, track.stamp_ns, there)
        return state, again if again.score > fit.score + SWITCH_MARGIN else fit

    def _or_whole_face_fit(
        self, state: MonoState, track: TrackState, frame: SeededFrame, fit: FrameFit
    ) -> FrameFit:
        """Return the fit, or for a poor one a better fit from the whole face's motion **[ours]**."""
        pipeline = self._pipeline(state)

        def refit(about: TrackState, templates: Sequence[TemplateSet] | None) -> FrameFit:
            person = state.person if templates is None else replace(state.person, templates=tuple(templates))
            return pipeline.fitter.fit(person, about, frame)

        images = RigImages((pipeline.adjuster.camera,), frame.frame.images)
        clear = max(self.least_score(state), self._config.status.check_below)
        return whole_face_fit(fit, track, images, refit, clear=clear, trust=state.trust)

    def recognise(
        self, state: MonoState, found: DetectedFace, frame: SeededFrame
    ) -> Iterator[tuple[MonoState, FrameFit]]:
        """Fit each known person to a detected face for one frame, the current one first."""
        frame = self._enlarged(state, frame, found.pixels)
        fitter, last_seen_ns = self._pipeline(state).fitter, state.last_seen_ns(frame)
        last: FrameFit | None = None
        for index in sorted(range(len(state.people)), key=lambda one: one != state.current):
            fit = fitter.fit_detection(state.people[index], found, last_seen_ns, frame)
            last = fit if last is None else last
            yield state.switch_person(index, frame.index), fit
        if last is None or self._follows_one:  # a place is no evidence where heads cross
            return
        if last.score > LEAST_SIMILARITY and not self._is_elsewhere(state, found):
            yield state, self._pipeline(state).fitter.fit_anchored(state.person, found, last_seen_ns, frame)

    def least_score(self, state: MonoState) -> float:
        """Return the minimum score of a tracked face, higher for some time after a cut."""
        least = self._config.status.tracking_above
        if self._follows_one and state.lost:
            least = max(least, RESEMBLANCE_SHARE * state.person.mean_score)
        # soon after a cut poorly matching frames are not learned from, so the usual threshold is safe
        if not state.cut or state.strange < self._patience(state):
            return least
        return max(least, RECOGNITION_SHARE * state.person.mean_score)

    def not_recognised(self, state: MonoState, found: DetectedFace) -> tuple[MonoState, bool]:
        """Count an unknown face; after enough frames it becomes a new person."""
        if off_axis_deg(found.pose) > NEW_PERSON_OFF_AXIS_DEG:
            return state, False
        state = replace(state, strange=state.strange + 1, elsewhere=self._is_elsewhere(state, found))
        return state, state.strange >= self._patience(state) and not self._follows_one

    def _patience(self, state: MonoState) -> int:
        """Return the number of frames after which an unknown face becomes a new person."""
        is_quick = state.cut and state.elsewhere and not self._follows_one
        return NEW_PERSON_FRAMES_AFTER_CUT if is_quick else NEW_PERSON_FRAMES

    def _is_elsewhere(self, state: MonoState, found: DetectedFace) -> bool:
        """Whether a face is away from the last position of the head or of another size."""
        track = state.track
        if track is None or state.elsewhere:
            return True
        camera = self._pipeline(state).adjuster.camera
        last = project((camera,), track.pose.points(track.shape)).pixels[0]
        away = float(np.linalg.norm(found.pixels.mean(axis=0) - last.mean(axis=0))) / found.eye_distance
        ratio = found.eye_distance / eye_distance_px(track.pose, camera)
        return not (away < JUMP_EYES and 1.0 / JUMP_RATIO < ratio < JUMP_RATIO)

    def learn(self, state: MonoState, frame: SeededFrame, fit: FrameFit) -> tuple[MonoState, FrameFit]:
        """Update the person from a tracked frame, unless the frame is doubtful."""
        state = replace(state, trust=min(fit.score, 1.0))
        if fit.is_anchored:  # no templates matched, so the frame cannot confirm the person
            seen = self._keep_skin(state, state.person, frame, fit)
            return replace(seen, strange=state.strange + 1), fit
        if state.cut and fit.score < RECOGNITION_SHARE * state.person.mean_score:
            return (replace(state, strange=state.strange + 1) if state.elsewhere else state), fit
        fitter, measured = self._pipeline(state).fitter, self._size_measurement(state.current)
        person, fit = fitter.update_person(state.person, state.track, frame, fit, measured)
        state = self._keep_skin(state, person, frame, fit).clear_candidates()
        return replace(state, strange=0, cut=False, elsewhere=False), fit

    def _keep_skin(
        self, state: MonoState, person: KnownPerson, frame: SeededFrame, fit: FrameFit
    ) -> MonoState:
        """Return the state with the person and the frame's skin.

        Frames with new directions are included: their points were re-detected and are inaccurate, which the
        skin corrects.
        """
        fitter = self._pipeline(state).fitter
        if fitter.wants_skin(person, frame, fit):
            person = fitter.keep_skin(person, self._enlarged(state, frame, fit.pixels[0]), fit)
        return state.update_person(person)

    def report_fit(self, state: MonoState, frame: SeededFrame, fit: FrameFit) -> tuple[MonoState, FrameFit]:
        """Return the fit for the result, in a second pass refined by the skin **[ours]**.

        Tracking continues from the feature points, so a wrong skin match affects only its own frame.
        """
        before = state.stated
        if state.person.skin_map is None:
            return replace(state, stated=None), fit
        reported = self._pipeline(state).fitter.fit_on_skin(
            state.person, self._enlarged(state, frame, fit.pixels[0]), fit
        )
        now = reported.track
        if before is not None and np.any(now.velocity):
            velocity = velocity_between(before.pose, now.pose, fit.dt)
            rate = (reported.coefficients - before.coefficients) / fit.dt
            reported = replace(reported, track=replace(now, velocity=velocity), coefficient_rate=rate)
        return replace(state, stated=ReportedPose(now.pose, reported.coefficients)), reported

    def regression(self, reported: FrameFit) -> Regression:
        """Return the confidence model for a frame."""
        regression = MONO if reported.unmatched is None else MONO_WITH_SKIN
        if self._lens is None:
            return regression
        return regression._replace(most=self._lens.share_right(reported.track.pose))

    def describe(self, state: MonoState, fit: FrameFit | None) -> FaceDescription:
        """Return deformation and diagnostics of a frame."""
        mean = self._model.deformation_mean
        return FaceDescription(
            mean if fit is None else fit.coefficients + mean,
            self._model.deformation_deviations,
            self._diagnostics(state, fit).numbers(),
            None if fit is None else self._systematic_variance(state, fit),
        )

    def _systematic_variance(self, state: MonoState, fit: FrameFit) -> FloatArray:
        """Return the (6,) variances of the systematic error, which grow while the brows are raised."""
        pose, size = fit.track.pose, state.person.size if state.people else None
        variance = size_and_systematic_variance(pose, self._systematic_sd, size)
        if self._lens is not None:
            variance += self._lens.variance(pose)
        if not state.people or not self._config.face.use:  # the papers state no error of expressions
            return variance
        neutral = state.person.shape.mean - MEAN_DISPLACEMENTS
        return variance + MONO_TRACK.expression_variance(fit.track.shape - neutral)

    def matched_skin(self, state: MonoState) -> tuple[MatchedSkin, Camera] | None:
        """Return the skin of the person seen most and the camera of its images; None with too few frames."""
        if not state.people:
            return None
        adjuster = self._pipeline(state).adjuster
        person = max(state.people, key=lambda one: len(one.skin.views)).adjusted_over_album(adjuster)
        matched = person.matched_skin(adjuster)
        return None if matched is None else (matched, adjuster.camera)

    def export_model(self, state: MonoState, *, for_second_pass: bool) -> Learned:
        """Return the learned people and the focal length at which they were observed."""
        adjuster = self._pipeline(state).adjuster
        people = tuple(one.adjusted_over_album(adjuster) for one in state.people)
        people = tuple(
            (one.with_skin_map(adjuster) if for_second_pass else one.without_skin()).with_size(
                self._size_measurement(index), self._model
            )
            for index, one in enumerate(people)
        )
        focal = (state.scale or UNSCALED) * self._recorded.fx
        return self._people.to_arrays(people) | {FOCAL_PX: np.array(focal)}

    def remarks(self, state: MonoState) -> tuple[str, ...]:
        """Warn about changes of the person, wrong intrinsics and an implausible size."""
        people = (
            f"person {who} is tracked from frame {frame} on (the first person is 0)"
            for frame, who in state.changes
        )
        return (*people, *self._focal_length_warning(state), *self._size_warning(state))

    def _focal_length_warning(self, state: MonoState) -> tuple[str, ...]:
        """Warn about wrong intrinsics, unless they were estimated."""
        if self._lens is not None:
            return ()
        return focal_length_check(state.person, self._pipeline(state).adjuster, state.scale or UNSCALED)

    def _size_warning(self, state: MonoState) -> tuple[str, ...]:
        """Warn if the interpupillary distance implies an unlikely size of the first person."""
        if self._pupil_distance is None:
            return ()
        return self._pupil_distance.warnings(person_shape(self._model, state.people[0].person).mean)

    def _begin(self, state: MonoState, frame: SeededFrame) -> tuple[MonoState, FrameFit | InitFailure]:
        """Collect n frames with the face, then adjust them together (4.4.1).

        Until then each frame is reported with the pose from its own points **[ours]**.
        """
        if self._clicked is not None and frame.stamp_ns == state.first_ns:
            return self._begin_with_clicks(self._clicked, state, frame)
        initialiser = self._pipeline(state).initialiser
        state = state.drop_before(frame.stamp_ns - round(CANDIDATE_SPAN_S * 1e9))
        near = state.candidates[-1].pixels if state.candidates else None
        # quickly after the first frame, except at a new scale; another person's face was just found so
        fresh = not state.people and (not state.search.frames or state.scale is not None)
        found = self._detect_near(state, frame.frame, near, thoroughly=fresh or near is not None)
        if isinstance(found, InitFailure):
            return state, found
        frame = self._enlarged(state, frame, found.pixels)
        alone = initialiser.initialise((found,))
        if isinstance(alone, InitFailure):
            return state, alone
        seen = initialiser.templates(frame.frame, found, alone)
        state = state.with_candidate(found, seen)
        if len(state.candidates) < self._config.start.frames:
            measured = self._size_measurement(len(state.people))
            return state, self._pipeline(state).fitter.initial_fit(frame, found, alone, seen, measured)
        start = initialiser.initialise(state.candidates)
        if isinstance(start, InitFailure):
            return state.clear_candidates(), start
        return self._found(state, start, frame)

    def _begin_again(
        self, state: MonoState, track: TrackState, frame: SeededFrame
    ) -> tuple[MonoState, FrameFit] | None:
        """Replace a person begun from a turned face once the face looks at the camera **[ours]**.

        Half of the points of a turned face are hidden, so that its person and templates are poor. None if it
        does not look at the camera.
        """
        found = self._detect_near(state, frame.frame, self._pixels_of(state, track), thoroughly=False)
        if isinstance(found, InitFailure) or found.score < CERTAIN:
            return None
        initialiser, frame = self._pipeline(state).initialiser, self._enlarged(state, frame, found.pixels)
        start = initialiser.initialise((found,))
        turned = off_axis_deg(found.pose) > NEW_PERSON_OFF_AXIS_DEG
        if isinstance(start, InitFailure) or turned:
            return None
        search = state.search.failed(InitFailure("face turned away", found.score))
        kept = {name: getattr(state, name) for name in ("scale", "first_ns", "scene", "evidence", "record")}
        begun = replace(self._first, search=search, **kept)
        begun = begun.with_candidate(found, initialiser.templates(frame.frame, found, start))
        return self._found(begun, start, frame)

    def _begin_with_clicks(
        self, clicked: ClickedPoints, state: MonoState, frame: SeededFrame
    ) -> tuple[MonoState, FrameFit]:
        """Initialise from the clicked points of the first frame."""
        pipeline = self._pipeline(state)
        pixels = scaled_pixels(clicked.pixels[0], state.scale or UNSCALED)
        frame = self._enlarged(state, frame, pixels)
        face = face_at(pixels, frame.stamp_ns, pipeline.adjuster.camera)
        start = pipeline.initialiser.initialise((face,))
        if isinstance(start, InitFailure):
            raise clicked.no_head_error(start)
        state = state.with_candidate(face, pipeline.initialiser.templates(frame.frame, face, start))
        return self._found(state, start, frame)

    def _found(
        self, state: MonoState, start: MonoInitialisation, frame: SeededFrame
    ) -> tuple[MonoState, FrameFit]:
        """Create a person from the adjusted frames; the first frame is the reference."""
        pipeline, last = self._pipeline(state), state.candidates[-1]
        reference = pipeline.initialiser.reference(state.first_templates, start)
        measured = self._size_measurement(len(state.people))
        person = new_person(start.person, reference, pipeline.adjuster).with_size(measured, self._model)
        seen = pipeline.initialiser.templates(frame.frame, last, start)
        fit = pipeline.fitter.initial_fit(frame, last, start, seen, measured)
        return state.with_new_person(person, fit.track, frame.index), fit

    def _has_slid(self, state: MonoState, frame: SeededFrame, fit: FrameFit) -> bool:
        """Whether points have left the landmarks of the frame, if it has any."""
        initialiser = self._pipeline(state).initialiser
        face = initialiser.landmark_face(frame.frame, fit.pixels[0])
        return face is not None and initialiser.has_slid(fit.pixels[0], face)

    def _last_pixels(self, state: MonoState, frame: SeededFrame) -> FloatArray | None:
        """Return the points of the last track, None if that is outdated or before a cut."""
        track = state.track
        if track is None or state.cut or frame.stamp_ns - track.stamp_ns > POSITION_TIMEOUT_S * 1e9:
            return None
        return self._pixels_of(state, track)

    def _pixels_of(self, state: MonoState, track: TrackState) -> FloatArray:
        """Return the pixels (K, 2) of a track's points at the state's image scale."""
        camera = self._pipeline(state).adjuster.camera
        pixels: FloatArray = project((camera,), track.pose.points(track.shape)).pixels[0]
        return pixels

    def _detect_near(
        self, state: MonoState, frame: Frame, near: FloatArray | None, *, thoroughly: bool
    ) -> DetectedFace | InitFailure:
        """Detect a face; small faces in the unscaled image, as magnification adds no information."""
        scale = state.scale or UNSCALED
        if scale <= UNSCALED:
            return self._pipeline(state).initialiser.detect(frame, near, thoroughly=thoroughly)
        recorded = None if near is None else scaled_pixels(near, 1.0 / scale)
        unscaled = self._pipeline_at(UNSCALED).initialiser
        found = unscaled.detect(frame, recorded, thoroughly=thoroughly)
        if isinstance(found, InitFailure):
            return found
        pixels, camera = scaled_pixels(found.pixels, scale), self._pipeline(state).adjuster.camera
        return face_at(pixels, found.stamp_ns, camera, found.responses)

    def _enlarged(self, state: MonoState, frame: SeededFrame, pixels: FloatArray) -> SeededFrame:
        """Return the frame, magnified around points (K, 2) if the state's scale requires it."""
        scale = state.scale or UNSCALED
        return frame if scale <= UNSCALED else replace(frame, frame=enlarged(frame.frame, scale, pixels))

    def _diagnostics(self, state: MonoState, fit: FrameFit | None) -> MonoDiagnostics:
        score, weights = (np.nan, None) if fit is None else (fit.score, fit.weights)
        if not state.people or (fit is not None and state.candidates):  # the person is not initialised yet
            unknown = np.full(self._model.identity_size, np.nan)
            return MonoDiagnostics(unknown, unknown, len(state.people), score=score, weights=weights)
        known = state.person
        neutral = known.shape.mean - MEAN_DISPLACEMENTS
        return MonoDiagnostics(
            known.history.mean,
            known.history.spread,
            state.current,
            known.factor,
            PRIOR_SD if known.size is None else known.size.sd,
            known.adjusted_frames,
            known.rms_px / (state.scale or UNSCALED),
            np.nan if fit is None else fit.skin_share,
            score,
            weights,
            None if fit is None else fit.track.shape - neutral,
        )

    def _pipeline(self, state: MonoState) -> _ScalePipeline:
        """Return the pipeline for the state's image scale; unscaled before a face is found."""
        return self._pipeline_at(state.scale or UNSCALED)

    def _pipeline_at(self, scale: float) -> _ScalePipeline:
        if scale not in self._pipelines:
            config, camera = self._config, scaled_camera(self._recorded, scale)
            adjuster = Adjuster(self._model, camera, config.adjustment)
            landmarks = None if self._landmarks is None else Landmarks(self._landmarks, camera, scale)
            initialiser = MonoInitialiser(config, adjuster, self._detector, self._choice, landmarks)
            self._pipelines[scale] = _ScalePipeline(adjuster, initialiser, PersonFitter(config, adjuster))
        return self._pipelines[scale]

    def _scale_of(self, state: MonoState) -> float | None:
        """Return the scale for a face found in an unscaled image; None if there is none."""
        if state.candidates:
            distance = state.candidates[0].eye_distance
        elif state.track is not None:
            distance = eye_distance_px(state.track.pose, self._recorded)
        else:
            return None
        return self._scaling.for_face(distance)

    def _rescaled(self, state: MonoState) -> MonoState:
        """Return the state at the scale that fits the tracked head."""
        if state.track is None or state.scale is None or state.lost:
            return state
        distance = eye_distance_px(state.track.pose, self._recorded)
        return state.at_scale(self._scaling.updated(state.scale, distance))

    def _clicked_scale(self) -> float | None:
        """Return the scale for the clicked face; None without clicked points."""
        if self._clicked is None:
            return None
        face = face_at(self._clicked.pixels[0], 0, self._recorded)
        return self._scaling.for_face(face.eye_distance)

    def _known_state(self, known: Arrays) -> MonoState:
        """Return the state that starts with exported people."""
        scale = _known_scale(known, self._scaling)
        people = known_people(known, self._people)
        sized = (one.with_size(self._size_measurement(who), self._model) for who, one in enumerate(people))
        return MonoState(people=tuple(sized), scale=scale)

    def _size_measurement(self, who: int) -> PupilDistance | None:
        """Return the measured size, which applies to the first person only."""
        return self._pupil_distance if who == 0 else None


def interpupillary_distance(person: PersonSettings) -> PupilDistance | None:
    """Return the configured interpupillary distance; None if not set."""
    if person.interpupillary_mm is None:
        return None
    sd = float(np.hypot(person.interpupillary_sd_mm, CORNERS_SD_MM))
    return PupilDistance(person.interpupillary_mm, sd)


def size_and_systematic_variance(pose: HeadPose, systematic_sd: FloatArray, size: Size | None) -> FloatArray:
    """Return the (6,) variances of the systematic error of a track, including its scale.

    Another size moves the head along its ray: t' = c t has the variance (sd(log c) t)^2, with the standard
    deviation of the measured size or, without a measurement, ``PRIOR_SD``.
    """
    sd, variance = PRIOR_SD if size is None else size.sd, np.square(systematic_sd)
    variance[:3] += np.square(sd * pose.position)
    return variance


MonoTracker: TypeAlias = HeadTracker[MonoState, DetectedFace]


def make_mono_people(
    config: HeadMonoConfig,
    camera: Camera,
    known: Arrays | None = None,
    *,
    face: int = 0,
    clicked: Path | None = None,
    landmarks: LandmarkFile | None = None,
    systematic_sd: FloatArray = MONO_TRACK.systematic_sd,
    lens: EstimatedLens | None = None,
    follows_one: bool = False,
) -> MonoPeople:
    """Create the one-camera part of a run's tracker.

    Args:
        config: of the run; names the face model's file.
        camera: of the recording.
        known: arrays exported by another tracker.
        face: face to start with, 0 is the largest.
        clicked: table of points in the first frame; without it the face is detected there as well.
        landmarks: of the recorded images, from another program.
        systematic_sd: (6,) standard deviations of the systematic error of a track.
        lens: uncertainty of the camera if its focal length was estimated.
        follows_one: another person is not tracked, even after a cut.

    Raises:
        UsageError, ResultError: a file is missing or invalid.
        PosetrackError: invalid clicked points.
    """
    return MonoPeople(
        config,
        camera,
        load_face_model(None if config.model.file is None else Path(config.model.file)),
        choice=face,
        clicked=None if clicked is None else ClickedPoints.read(clicked, (camera,)),
        known=known,
        landmarks=landmarks,
        systematic_sd=systematic_sd,
        lens=lens,
        follows_one=follows_one,
    )


def make_mono_tracker(
    config: HeadMonoConfig, camera: Camera, known: Arrays | None = None, **options: Any
) -> MonoTracker:
    """Create the tracker of a run; see ``make_mono_people``."""
    people = make_mono_people(config, camera, known, **options)
    names = mono_diagnostic_names(people.identity_size)
    return HeadTracker(people, dense_faces(config, (camera,), names, known), known)


def _known_scale(known: Arrays, scaling: Scaling) -> float:
    """Return the usable scale nearest to the one at which a face was learned."""
    if FOCAL_PX not in known:
        raise damaged_people(f"array '{FOCAL_PX}' is missing")
    focal = known[FOCAL_PX]
    if focal.dtype.kind != "f" or focal.shape != () or not 0.0 < focal < np.inf:
        raise damaged_people(f"'{FOCAL_PX}' is {focal.dtype} {focal.shape}, or not above 0")
    return scaling.usable(float(focal) / scaling.camera.fx)
