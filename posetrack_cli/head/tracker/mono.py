"""The people whom one camera sees, as the head tracker finds, recognises and learns them (chapter 4)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.actions import MEAN_DISPLACEMENTS
from posetrack_cli.head.adjustment.adjuster import Adjuster
from posetrack_cli.head.adjustment.focal_length import focal_length_check
from posetrack_cli.head.config import HeadMonoConfig, PersonSettings
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.face.points import (
    WHOLE,
    HeadPose,
    Scaling,
    enlarged,
    reduced,
    scaled_camera,
    scaled_pixels,
)
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.clicked import ClickedPoints
from posetrack_cli.head.initialisation.mono import (
    DetectedFace,
    MonoInitialisation,
    MonoInitialiser,
    eye_distance_px,
    face_at,
)
from posetrack_cli.head.initialisation.search import InitFailure
from posetrack_cli.head.initialisation.single_view import pose_near
from posetrack_cli.head.landmarks.faces import LandmarkFile, Landmarks
from posetrack_cli.head.multilinear.face_model import FaceModel, load_face_model
from posetrack_cli.head.particles.particles import velocity_between
from posetrack_cli.head.subject import MONO_TRACK, MonoDiagnostics
from posetrack_cli.head.tracker.codecs import (
    FOCAL_PX,
    MonoState,
    Stated,
    is_cut,
    known_people,
    mono_codec,
    people_codec,
    thumbnail,
    unusable_people,
)
from posetrack_cli.head.tracker.face_learning import off_axis_deg, shift_of
from posetrack_cli.head.tracker.frame_tracker import MONO, MONO_WITH_SKIN, FrameFit, SeededFrame, TrackState
from posetrack_cli.head.tracker.head_tracker import Description, HeadTracker
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
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import Arrays
from posetrack_cli.tracking.confidence import Regression
from posetrack_cli.tracking.state_codec import Codec
from posetrack_cli.tracking.two_pass import Learned

STRANGER_FRAMES = 45
"""A face that looks like none of the known ones in so many frames is another person's **[ours]**."""
STRANGER_FRAMES_AFTER_CUT = 6
"""The same after a cut to a face elsewhere, or of another size: reason enough to expect another person."""
OTHER_PLACE, OTHER_SIZE = 1.2, 1.35
"""A face is elsewhere if it is so many eye distances away, and of another size if the ratio is so large. A
quick head near the camera changes an image as a cut does, but stays where it was."""
RECOGNISED = 0.85
"""After a cut a face is surely a known person's if its score is so much of the usual one. Until it is, the
person is followed, but nothing is learnt: a quick head near the camera changes an image as a cut does."""
LEAST_LIKE = 0.2
"""A face where the last one was, of its size and at least so much like it, is followed by what it looks like
now: turned or blurred it looks like no template."""
STRANGER_OFF_AXIS_DEG = 25.0
"""Only a face that looks at the camera tells: from the side one's own looks strange, too."""
WHOLE_FACE_LIKE = 0.4
"""Mean correlation of a face's windows from which on it is the same face a moment later."""
KEPT, THE_SAME = 0.98, 0.8
"""What is left of a score after a frame that only looks like the one before, and the mean correlation from
which on the two look the same: between sharp and blurred it is no more."""
CLEARLY_BETTER = 0.03
"""Minimum score gain for a new detection to replace the track."""
SPAN_S = 2.0
"""Frames that a face is found in lie no farther apart, so that a face seen now and then is not made one."""
CHECK_EVERY_S = 0.5
"""A face is detected again, where the fit is poor, no more often than this."""
FORGOTTEN_S = 1.0
"""A face that was gone for so long may come back elsewhere in the image."""


@dataclass(frozen=True, eq=False)
class _Scaled:
    """What looks at images of one scale; the adjuster's camera would take them."""

    adjuster: Adjuster
    initialiser: MonoInitialiser
    fitter: PersonFitter


class MonoPeople:
    """The people in the images of one camera; a ``Faces``.

    Images are scaled to where faces are as large as patches ask for; see ``face.points``. Until a face is
    found they are looked at as they are, and so are those in which a small face is looked for.

    Args:
        config: parameters.
        camera: of the recording.
        model: of faces.
        choice: which face to begin with, 0 the largest.
        clicked: points of the first frame; without them the face is found there, too.
        known: what another tracker has exported: people and templates to begin with.
        landmarks: of the recorded images, from elsewhere.
        systematic_sd: (6,) what a track of the person is wrong by.

    Raises:
        UsageError: a face detector without its model.
        ResultError: ``known`` is not what a one-camera tracker with this model exports.
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
    ) -> None:
        self._config, self._recorded, self._model = config, camera, model
        self._systematic_sd = systematic_sd
        self._landmarks, self._told = landmarks, told_distance(config.person)
        self.cameras, self.status = (camera,), config.status
        self._detector, self._choice, self._clicked = FaceDetector(config.start.detection), choice, clicked
        self._scaling = Scaling(config.start.eye_distance_px, config.start.largest_scale, camera)
        self._scaled: dict[float, _Scaled] = {}
        self._people = people_codec(model, config.adjustment)
        self.codec: Codec[MonoState] = mono_codec(self._people)
        self._first = self._known_state(known) if known else MonoState(scale=self._clicked_scale())

    def start(self) -> MonoState:
        """Return the state before a first frame."""
        return self._first

    def look(self, state: MonoState, frame: Frame) -> tuple[MonoState, Frame]:
        """Return the frame, reduced for a large face, and the state that knows of a cut to another scene.

        Of a head that came nearer or went away the state is at another scale.
        """
        state = self._at_fitting_scale(state)
        frame = reduced(frame, state.scale or WHOLE)
        (image,) = frame.images
        if image is None:
            return state, frame
        scene = thumbnail(image)
        cut = state.cut or (state.scene is not None and is_cut(state.scene, scene))
        return replace(state, scene=scene, cut=cut), frame

    def is_known(self, state: MonoState) -> bool:
        """Whether a person is known."""
        return bool(state.people)

    def detect(self, state: MonoState, frame: SeededFrame) -> DetectedFace | InitFailure:
        """Look for a face, where the head was last if that was not long ago."""
        return self._detect_near(state, frame, self._last_pixels(state, frame))

    def begin(self, state: MonoState, frame: SeededFrame) -> tuple[MonoState, FrameFit | InitFailure]:
        """Look for a person who is not known; the first who is found decides the scale of images.

        The frame is then looked at again at that scale.
        """
        after, fit = self._begin(state, frame)
        scale = state.scale if state.scale is not None else self._scale_of(after)
        after = replace(after, scale=scale)
        if state.scale == scale or scale == WHOLE:
            return after, fit
        afresh = replace(self._first, scale=scale, search=state.search, first_ns=state.first_ns)
        afresh, again = self.look(afresh, frame.frame)
        return self._begin(afresh, SeededFrame(again, frame.rng))

    def fit(self, state: MonoState, track: TrackState, frame: SeededFrame) -> tuple[MonoState, FrameFit]:
        """Follow the person into a frame; where the fit is poor, compare it with a detection **[ours]**.

        After a blink or a smile points may have slid to places that they do not come back from; landmarks
        from elsewhere tell that where the fit does not.
        """
        fitter, settings = self._at(state).fitter, self._config.status
        here = self._enlarged(state, frame, self._pixels_of(state, track))
        fit = self._or_followed(state, track, here, fitter.fit(state.person, track, here))
        recent = frame.stamp_ns - state.checked_ns < CHECK_EVERY_S * 1e9
        if recent or (fit.score >= settings.check_below and not self._has_slid(state, frame, fit)):
            return state, fit
        state = replace(state, checked_ns=frame.stamp_ns)
        found = self.detect(state, frame)
        if isinstance(found, InitFailure):
            return state, fit
        there = self._enlarged(state, frame, found.pixels)
        again = fitter.fit_detection(state.person, found, track.stamp_ns, there)
        return state, again if again.score > fit.score + CLEARLY_BETTER else fit

    def _or_followed(
        self, state: MonoState, track: TrackState, frame: SeededFrame, fit: FrameFit
    ) -> FrameFit:
        """Return a fit, or where it is poor a better one that begins where the whole face went **[ours]**.

        A head that moves otherwise than before is not where its velocity leads, and its points find other
        places that look a little like theirs. A face that is blurred, looks where it never was seen to or
        has an expression of its own looks hardly like its templates wherever it is, but as a moment ago: the
        score of being followed by that is the frame's before times how alike they are, so that what slides
        is doubted in time.
        """
        clear = max(self.least_score(state), self._config.status.check_below)
        if fit.score >= clear or track.templates is None:
            return fit
        (image,), fitter = frame.frame.images, self._at(state).fitter
        there = None if image is None else self._moved_as_a_whole(state, track, image)
        if there is None:
            return fit
        again = fitter.fit_from(state.person, track, there, frame)
        # by weights, not by scores: for a place beyond the image the points that are not seen say nothing
        best = again if again.weights.mean() > fit.weights.mean() else fit
        if best.score >= clear:
            return best
        as_before = replace(state.person, templates=(track.templates,))
        followed = fitter.fit_from(as_before, track, there, frame)
        alike = float(np.clip(followed.score / THE_SAME, 0.0, 1.0))
        score = KEPT * state.trust * alike
        if score <= best.score:
            return best
        weights = np.minimum(followed.weights, best.weights)  # a moment ago it may have been wrong already
        return replace(followed, score=score, weights=weights, is_anchored=True)

    def _moved_as_a_whole(self, state: MonoState, track: TrackState, image: ImageArray) -> HeadPose | None:
        """Return a track's pose where its whole face went in an image, None where that is not seen.

        The shift comes first; places that the points then have by themselves tell how the head turned and
        came nearer.
        """
        camera, templates = self._at(state).adjuster.camera, track.templates
        before = project((camera,), track.pose.points(track.shape)).pixels[0]
        shift = None if templates is None else shift_of(image, templates, before)
        if shift is None or shift.likeness < WHOLE_FACE_LIKE:
            return None
        aside = shift.pixels / np.array([camera.fx, camera.fy]) * track.pose.position[2]
        moved = replace(track.pose, position=track.pose.position + np.append(aside, 0.0))
        return pose_near(moved, shift.places, shift.likenesses, camera, track.shape)

    def recognise(
        self, state: MonoState, found: DetectedFace, frame: SeededFrame
    ) -> Iterator[tuple[MonoState, FrameFit]]:
        """Follow a face for one frame as each of the known people, the last one first."""
        frame = self._enlarged(state, frame, found.pixels)
        fitter, last_seen_ns = self._at(state).fitter, state.last_seen_ns(frame)
        last: FrameFit | None = None
        for index in sorted(range(len(state.people)), key=lambda one: one != state.current):
            fit = fitter.fit_detection(state.people[index], found, last_seen_ns, frame)
            last = fit if last is None else last
            yield state.switch_person(index, frame.index), fit
        if last is not None and last.score > LEAST_LIKE and not self._is_elsewhere(state, found):
            yield state, self._at(state).fitter.fit_anchored(state.person, found, last_seen_ns, frame)

    def least_score(self, state: MonoState) -> float:
        """Return the score of a tracked face; long after a cut it must look as the person usually does."""
        least = self._config.status.tracking_above
        if not state.cut or state.strange < self._patience(state):
            return least
        return max(least, RECOGNISED * state.person.usual_score)

    def not_recognised(self, state: MonoState, found: DetectedFace) -> tuple[MonoState, bool]:
        """Count a face that looks like none of the known ones: after some frames it is another person's."""
        if off_axis_deg(found.pose) > STRANGER_OFF_AXIS_DEG:
            return state, False
        state = replace(state, strange=state.strange + 1, elsewhere=self._is_elsewhere(state, found))
        return state, state.strange >= self._patience(state)

    def _patience(self, state: MonoState) -> int:
        """In how many frames a face must look like nobody to be another person's."""
        return STRANGER_FRAMES_AFTER_CUT if state.cut and state.elsewhere else STRANGER_FRAMES

    def _is_elsewhere(self, state: MonoState, found: DetectedFace) -> bool:
        """Whether a face is not where the head was last, or not as large."""
        track = state.track
        if track is None or state.elsewhere:
            return True
        camera = self._at(state).adjuster.camera
        last = project((camera,), track.pose.points(track.shape)).pixels[0]
        away = float(np.linalg.norm(found.pixels.mean(axis=0) - last.mean(axis=0))) / found.eye_distance
        ratio = found.eye_distance / eye_distance_px(track.pose, camera)
        return not (away < OTHER_PLACE and 1.0 / OTHER_SIZE < ratio < OTHER_SIZE)

    def learn(self, state: MonoState, frame: SeededFrame, fit: FrameFit) -> tuple[MonoState, FrameFit]:
        """Adjust the person by a frame in which the head was tracked; not by a doubtful one."""
        state = replace(state, trust=min(fit.score, 1.0))
        if fit.is_anchored:
            seen = self._keep_skin(state, state.person, frame, fit)
            return replace(seen, strange=state.strange + 1), fit
        if state.cut and fit.score < RECOGNISED * state.person.usual_score:
            return (replace(state, strange=state.strange + 1) if state.elsewhere else state), fit
        fitter, told = self._at(state).fitter, self._told_of(state.current)
        person, fit = fitter.update_person(state.person, state.track, frame, fit, told)
        state = self._keep_skin(state, person, frame, fit).clear_candidates()
        return replace(state, strange=0, cut=False, elsewhere=False), fit

    def _keep_skin(
        self, state: MonoState, person: KnownPerson, frame: SeededFrame, fit: FrameFit
    ) -> MonoState:
        """Return the state with a person, and what the frame shows of the skin.

        Where a face turns as it was never seen to, points are found anew, and are off; skin mends them.
        """
        fitter = self._at(state).fitter
        if fitter.wants_skin(person, frame, fit):
            person = fitter.keep_skin(person, self._enlarged(state, frame, fit.pixels[0]), fit)
        return state.update_person(person)

    def state_fit(self, state: MonoState, frame: SeededFrame, fit: FrameFit) -> tuple[MonoState, FrameFit]:
        """Return what the result says: in a second pass a pose that the skin tells, too **[ours]**.

        The track goes on from its feature points, so that what goes wrong with the skin stays in its frame.
        """
        before = state.stated
        if state.person.skin_map is None:
            return replace(state, stated=None), fit
        stated = self._at(state).fitter.fit_on_skin(
            state.person, self._enlarged(state, frame, fit.pixels[0]), fit
        )
        now = stated.track
        if before is not None and np.any(now.velocity):
            velocity = velocity_between(before.pose, now.pose, fit.dt)
            rate = (stated.coefficients - before.coefficients) / fit.dt
            stated = replace(stated, track=replace(now, velocity=velocity), coefficient_rate=rate)
        return replace(state, stated=Stated(now.pose, stated.coefficients)), stated

    def regression(self, stated: FrameFit) -> Regression:
        """Return how probable it is that a frame is right."""
        return MONO if stated.unmatched is None else MONO_WITH_SKIN

    def describe(self, state: MonoState, fit: FrameFit | None) -> Description:
        """Return deformation and diagnostics of a frame."""
        mean = self._model.deformation_mean
        size = state.person.size if state.people else None
        return Description(
            mean if fit is None else fit.coefficients + mean,
            self._model.deformation_deviations,
            self._diagnostics(state, fit).numbers(),
            None if fit is None else size_and_systematic_variance(fit.track.pose, self._systematic_sd, size),
        )

    def export_model(self, state: MonoState, *, for_second_pass: bool) -> Learned:
        """Return what was learned of the people seen, and how large they were seen."""
        adjuster = self._at(state).adjuster
        people = tuple(one.over_album(adjuster) for one in state.people)
        people = tuple(
            (one.with_skin_map(adjuster) if for_second_pass else one.without_skin()).with_size(
                self._told_of(index), self._model
            )
            for index, one in enumerate(people)
        )
        focal = (state.scale or WHOLE) * self._recorded.fx
        return self._people.to_arrays(people) | {FOCAL_PX: np.array(focal)}

    def remarks(self, state: MonoState) -> tuple[str, ...]:
        """Say when another person was seen, and whether the camera seems to be another one."""
        people = (f"from frame {frame} on it is person {who}; the first is 0" for frame, who in state.changes)
        check = focal_length_check(state.person, self._at(state).adjuster, state.scale or WHOLE)
        return (*people, *check, *self._size_doubt(state))

    def _size_doubt(self, state: MonoState) -> tuple[str, ...]:
        """Say whether the first person would be of a size that hardly anybody has."""
        if self._told is None:
            return ()
        return self._told.doubt(person_shape(self._model, state.people[0].person).mean)

    def _begin(self, state: MonoState, frame: SeededFrame) -> tuple[MonoState, FrameFit | InitFailure]:
        """Collect n frames with the face, then adjust them together (4.4.1).

        Until then each frame is given the pose that it has alone **[ours]**.
        """
        if self._clicked is not None and frame.stamp_ns == state.first_ns:
            return self._begin_with_clicks(self._clicked, state, frame)
        initialiser = self._at(state).initialiser
        state = state.drop_before(frame.stamp_ns - round(SPAN_S * 1e9))
        found = self._detect_near(state, frame, state.candidates[-1].pixels if state.candidates else None)
        if isinstance(found, InitFailure):
            return state, found
        frame = self._enlarged(state, frame, found.pixels)
        alone = initialiser.initialise((found,))
        if isinstance(alone, InitFailure):
            return state, alone
        seen = initialiser.templates(frame.frame, found, alone)
        state = state.with_candidate(found, seen)
        if len(state.candidates) < self._config.start.frames:
            told = self._told_of(len(state.people))
            return state, self._at(state).fitter.initial_fit(frame, found, alone, seen, told)
        start = initialiser.initialise(state.candidates)
        if isinstance(start, InitFailure):
            return state.clear_candidates(), start
        return self._found(state, start, frame)

    def _begin_with_clicks(
        self, clicked: ClickedPoints, state: MonoState, frame: SeededFrame
    ) -> tuple[MonoState, FrameFit]:
        """Begin at once, from points that a person clicked."""
        at = self._at(state)
        pixels = scaled_pixels(clicked.pixels[0], state.scale or WHOLE)
        frame = self._enlarged(state, frame, pixels)
        face = face_at(pixels, frame.stamp_ns, at.adjuster.camera)
        start = at.initialiser.initialise((face,))
        if isinstance(start, InitFailure):
            raise clicked.unusable(start)
        state = state.with_candidate(face, at.initialiser.templates(frame.frame, face, start))
        return self._found(state, start, frame)

    def _found(
        self, state: MonoState, start: MonoInitialisation, frame: SeededFrame
    ) -> tuple[MonoState, FrameFit]:
        """Begin to know a person, whose reference is what the first of the frames showed."""
        at, last = self._at(state), state.candidates[-1]
        reference = at.initialiser.reference(state.first_templates, start)
        told = self._told_of(len(state.people))
        person = new_person(start.person, reference, at.adjuster).with_size(told, self._model)
        seen = at.initialiser.templates(frame.frame, last, start)
        fit = at.fitter.initial_fit(frame, last, start, seen, told)
        return state.with_new_person(person, fit.track, frame.index), fit

    def _has_slid(self, state: MonoState, frame: SeededFrame, fit: FrameFit) -> bool:
        """Whether points are elsewhere than the landmarks of a frame, if it has any."""
        initialiser = self._at(state).initialiser
        told = initialiser.told(frame.frame, fit.pixels[0])
        return told is not None and initialiser.has_slid(fit.pixels[0], told)

    def _last_pixels(self, state: MonoState, frame: SeededFrame) -> FloatArray | None:
        """Where the points were when the head was last tracked, unless that was long ago or before a cut."""
        track = state.track
        if track is None or state.cut or frame.stamp_ns - track.stamp_ns > FORGOTTEN_S * 1e9:
            return None
        return self._pixels_of(state, track)

    def _pixels_of(self, state: MonoState, track: TrackState) -> FloatArray:
        """Where a tracked head's points (K, 2) are in images of the state's scale."""
        camera = self._at(state).adjuster.camera
        pixels: FloatArray = project((camera,), track.pose.points(track.shape)).pixels[0]
        return pixels

    def _detect_near(
        self, state: MonoState, frame: SeededFrame, near: FloatArray | None
    ) -> DetectedFace | InitFailure:
        """Look for a face; a small one in the image as recorded, as a larger one would show no more of it."""
        scale = state.scale or WHOLE
        if scale <= WHOLE:
            return self._at(state).initialiser.detect(frame.frame, near)
        recorded = None if near is None else scaled_pixels(near, 1.0 / scale)
        found = self._at_scale(WHOLE).initialiser.detect(frame.frame, recorded)
        if isinstance(found, InitFailure):
            return found
        pixels, camera = scaled_pixels(found.pixels, scale), self._at(state).adjuster.camera
        return face_at(pixels, found.stamp_ns, camera, found.responses)

    def _enlarged(self, state: MonoState, frame: SeededFrame, pixels: FloatArray) -> SeededFrame:
        """The frame, about a face with points (K, 2) as large as the state's scale asks for."""
        scale = state.scale or WHOLE
        return frame if scale <= WHOLE else replace(frame, frame=enlarged(frame.frame, scale, pixels))

    def _diagnostics(self, state: MonoState, fit: FrameFit | None) -> MonoDiagnostics:
        score, weights = (np.nan, None) if fit is None else (fit.score, fit.weights)
        if not state.people or (fit is not None and state.candidates):  # somebody who is not known yet
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
            known.rms_px / (state.scale or WHOLE),
            np.nan if fit is None else fit.skin_share,
            score,
            weights,
            None if fit is None else fit.track.shape - neutral,
        )

    def _at(self, state: MonoState) -> _Scaled:
        """What looks at images of a state's scale; at whole ones before a face is first found."""
        return self._at_scale(state.scale or WHOLE)

    def _at_scale(self, scale: float) -> _Scaled:
        """What looks at images of a scale."""
        if scale not in self._scaled:
            config, camera = self._config, scaled_camera(self._recorded, scale)
            adjuster = Adjuster(self._model, camera, config.adjustment)
            told = None if self._landmarks is None else Landmarks(self._landmarks, camera, scale)
            initialiser = MonoInitialiser(config, adjuster, self._detector, self._choice, told)
            self._scaled[scale] = _Scaled(adjuster, initialiser, PersonFitter(config, adjuster))
        return self._scaled[scale]

    def _scale_of(self, state: MonoState) -> float | None:
        """The scale for the face that was found in a whole image; None where none was found yet."""
        if state.candidates:
            distance = state.candidates[0].eye_distance
        elif state.track is not None:
            distance = eye_distance_px(state.track.pose, self._recorded)
        else:
            return None
        return self._scaling.of_face(distance)

    def _at_fitting_scale(self, state: MonoState) -> MonoState:
        """The state at the scale that a head which is tracked asks for."""
        if state.track is None or state.scale is None or state.lost:
            return state
        distance = eye_distance_px(state.track.pose, self._recorded)
        return state.at_scale(self._scaling.fitting(state.scale, distance))

    def _clicked_scale(self) -> float | None:
        """The scale for the face whose points were clicked; None where none were."""
        if self._clicked is None:
            return None
        face = face_at(self._clicked.pixels[0], 0, self._recorded)
        return self._scaling.of_face(face.eye_distance)

    def _known_state(self, known: Arrays) -> MonoState:
        """The state that begins with people whom another tracker has learned."""
        scale = _known_scale(known, self._scaling)
        people = known_people(known, self._people)
        sized = (one.with_size(self._told_of(who), self._model) for who, one in enumerate(people))
        return MonoState(people=tuple(sized), scale=scale)

    def _told_of(self, who: int) -> PupilDistance | None:
        """What was told of a person's size: of the first alone."""
        return self._told if who == 0 else None


def told_distance(person: PersonSettings) -> PupilDistance | None:
    """Return the distance of the pupils that a configuration tells; None where it tells none."""
    if person.interpupillary_mm is None:
        return None
    sd = float(np.hypot(person.interpupillary_sd_mm, CORNERS_SD_MM))
    return PupilDistance(person.interpupillary_mm, sd)


def size_and_systematic_variance(pose: HeadPose, systematic_sd: FloatArray, size: Size | None) -> FloatArray:
    """Return (6,) what a track is wrong by in all frames alike, its size included.

    Another size moves a head along its ray: t' = c t has the variance (sd(log c) t)^2, with the deviation of
    the size that was told or, without, ``PRIOR_SD``.
    """
    sd, variance = PRIOR_SD if size is None else size.sd, np.square(systematic_sd)
    variance[:3] += np.square(sd * pose.position)
    return variance


MonoTracker: TypeAlias = HeadTracker[MonoState, DetectedFace]


def make_mono_tracker(
    config: HeadMonoConfig,
    camera: Camera,
    known: Arrays | None = None,
    *,
    face: int = 0,
    clicked: Path | None = None,
    landmarks: LandmarkFile | None = None,
    systematic_sd: FloatArray = MONO_TRACK.systematic_sd,
) -> MonoTracker:
    """Return the tracker that a run uses.

    Args:
        config: parameters; names the face model's file.
        camera: of the recording.
        known: what another tracker has exported.
        face: which one to begin with, 0 the largest.
        clicked: table of points in the first frame; without it the face is found there, too.
        landmarks: of the recorded images, from elsewhere.
        systematic_sd: (6,) what a track of the person is wrong by.

    Raises:
        UsageError, ResultError: a file that is missing or cannot be used.
        PosetrackError: clicked points that are none.
    """
    model = load_face_model(None if config.model.file is None else Path(config.model.file))
    points = None if clicked is None else ClickedPoints.read(clicked, (camera,))
    people = MonoPeople(
        config,
        camera,
        model,
        choice=face,
        clicked=points,
        known=known,
        landmarks=landmarks,
        systematic_sd=systematic_sd,
    )
    return HeadTracker(people)


def _known_scale(known: Arrays, scaling: Scaling) -> float:
    """The scale at which a learned face was seen, or the nearest."""
    if FOCAL_PX not in known:
        raise unusable_people(f"no array '{FOCAL_PX}'")
    focal = known[FOCAL_PX]
    if focal.dtype.kind != "f" or focal.shape != () or not 0.0 < focal < np.inf:
        raise unusable_people(f"'{FOCAL_PX}' as {focal.dtype} {focal.shape}, or not above 0")
    return scaling.usable(float(focal) / scaling.camera.fx)
