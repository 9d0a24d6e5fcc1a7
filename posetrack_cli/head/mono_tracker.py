"""The head tracker for one camera: it finds a head, follows it and learns whose it is (chapter 4)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import normalised_from_pixels
from posetrack_cli.head.adjustment.intrinsics import check_focal
from posetrack_cli.head.adjustment.views import PointView
from posetrack_cli.head.cuts import is_cut, thumbnail
from posetrack_cli.head.estimates import followed_estimate, searched_estimate
from posetrack_cli.head.following import Followed, Follower, Following, begun
from posetrack_cli.head.keyframes import is_new
from posetrack_cli.head.learning import off_axis_deg
from posetrack_cli.head.mono_config import HeadMonoConfig
from posetrack_cli.head.mono_finder import MonoFinder
from posetrack_cli.head.mono_start.detected import DetectedFace, clicked_face
from posetrack_cli.head.mono_start.single import pose_of
from posetrack_cli.head.mono_start.start import MonoStart
from posetrack_cli.head.mono_state import MonoState, known_state, parts_of, state_of
from posetrack_cli.head.mono_subject import MonoNumbers
from posetrack_cli.head.motion import FRAME_S, velocity_between
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.person import KnownPerson, new_person
from posetrack_cli.head.person_arrays import people_parts
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.projection import project
from posetrack_cli.head.protocol import NoFaceError
from posetrack_cli.head.start.start import NoStart
from posetrack_cli.head.templates import TemplateSet
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status

FOCAL_VIEWS = 40
"""So many views of different directions can tell that a focal length is wrong."""
STRANGER_FRAMES = 10
"""A face that looks like none of the known ones in so many frames is another person's **[ours]**."""
STRANGER_FRAMES_AFTER_CUT = 3
RECOGNISED = 0.85
"""After a cut a face is a known person's if its score is so much of the usual one."""
STRANGER_OFF_AXIS_DEG = 25.0
"""Only a face that looks at the camera tells: from the side one's own looks strange, too."""
CLEARLY_BETTER = 0.03
"""Of two scores."""
FORGOTTEN_S = 1.0
"""A face that was gone for so long may come back elsewhere in the image."""


class MonoTracker:
    """Follows one head in the images of one camera; a ``HeadTracker``.

    Args:
        config: parameters.
        camera: of the recording.
        model: of faces.
        choice: which face to begin with, 0 the largest.
        clicked: (K, 2) pixels of the points in the first frame; None finds the face.
        scale: by which the images were reduced, for what is said in recorded pixels.
        known: what another tracker has ``learned``: people and templates to begin with.

    Raises:
        UsageError: a face detector without its model.
        ResultError: ``known`` is not what a one-camera tracker with this model learns.
    """

    def __init__(
        self,
        config: HeadMonoConfig,
        camera: Camera,
        model: FaceModel,
        choice: int = 0,
        clicked: FloatArray | None = None,
        scale: float = 1.0,
        known: Mapping[str, np.ndarray[Any, Any]] | None = None,
    ) -> None:
        self._config, self._camera, self._model = config, camera, model
        self._clicked, self._scale = clicked, scale
        self._finder = MonoFinder(config, camera, model, choice)
        self._follower = Follower(config.particles, config.refinement, (camera,))
        self._known = MonoState() if known is None else known_state(known, model, config.adjustment)

    def start(self, frame: Frame, rng: np.random.Generator) -> MonoState:
        """Return the state before a first frame, in which the head has yet to be found."""
        if self._clicked is None:
            return self._known
        return replace(self._known, clicked=clicked_face(self._clicked, frame.stamp_ns, self._camera))

    def step(self, state: MonoState, frame: Frame, rng: np.random.Generator) -> tuple[MonoState, Estimate]:
        """Advance by one frame; the state given is left as it is."""
        state = _with_view(state, frame)
        if not state.people:
            return self._first_search(state, frame, rng)
        if state.following is not None:
            followed = self._followed(state.person, state.following, frame, rng)
            state, followed = self._checked(state, followed, frame, rng)
            if self._is_tracked(state, state.person, followed):
                return self._tracked(state, frame, followed, self._status_after(state))
            if state.lost + 1 < self._config.status.lost_after_frames and not state.cut:
                return self._lost(state, frame)
        return self._search(state, frame, rng)

    def learned(self, state: MonoState) -> dict[str, np.ndarray[Any, Any]]:
        """Return what was learned of the people seen, as arrays by name: identities, offsets, templates."""
        settings = self._config.adjustment
        return people_parts([one.over_all(self._model, self._camera, settings) for one in state.people])

    def not_found(self, state: MonoState) -> str:
        """Say how a head was looked for that was found in no frame yet; empty once it was found."""
        return "" if state.following is not None or state.detected else str(state.search)

    def remarks(self, state: MonoState) -> tuple[str, ...]:
        """Say when another person was seen, and whether the camera seems to be another one."""
        people = (f"person {who} from {stamp * 1e-9:.2f} s on" for stamp, who in state.changes)
        return (*people, *self._doubt_of_focal_length(state))

    def _doubt_of_focal_length(self, state: MonoState) -> tuple[str, ...]:
        if not state.people or self._config.adjustment.when != "always":
            return ()
        person = state.person
        views = person.album.some(FOCAL_VIEWS)
        if len(views) < FOCAL_VIEWS:
            return ()
        settings = self._config.adjustment
        check = check_focal(views, person.person, self._model, self._camera, settings)
        if not check.beyond_doubt:
            return ()
        focal = self._camera.fx / self._scale
        return (
            f"focal length {focal:.0f} px, but the points fit {check.factor * focal:.0f} px better: are the "
            "intrinsics right? z and scale depend on them",
        )

    def state_parts(self, state: MonoState) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, int]]:
        """Take a state apart into arrays and whole numbers, for a checkpoint."""
        return parts_of(state)

    def state_from_parts(
        self, arrays: Mapping[str, np.ndarray[Any, Any]], numbers: Mapping[str, int]
    ) -> MonoState:
        """Put a state together from what ``state_parts`` made of it."""
        return state_of(arrays, numbers, self._model, self._config.adjustment)

    # A head that is followed

    def _followed(
        self, person: KnownPerson, following: Following, frame: Frame, rng: np.random.Generator
    ) -> Followed:
        now = replace(following.particles, model=person.shape)  # a means the same, whoever s says it is
        before = replace(following, particles=now)
        return self._follower.step(before, frame.stamp_ns, frame.images, person.sets, person.shape, rng)

    def _checked(
        self, state: MonoState, followed: Followed, frame: Frame, rng: np.random.Generator
    ) -> tuple[MonoState, Followed]:
        """Begin anew from a detection where the points look hardly like themselves, if they then do more.

        After a blink or a smile points may have slid to places that they do not come back from **[ours]**.
        """
        settings = self._config.status
        recent = frame.stamp_ns - state.checked_ns < settings.check_every_s * 1e9
        if recent or followed.score >= settings.check_below:
            return state, followed
        state = replace(state, checked_ns=frame.stamp_ns)
        found = self._finder.detect(frame, self._last_seen(state, frame))
        if isinstance(found, NoStart):
            return state, followed
        again = self._as_person(state, state.person, found, frame, rng)
        return state, again if again.score > followed.score + CLEARLY_BETTER else followed

    def _is_tracked(self, state: MonoState, person: KnownPerson, followed: Followed) -> bool:
        """Whether a frame shows a person; after a cut it must look as the person usually does."""
        least = self._config.status.tracking_above
        if state.cut:
            least = max(least, RECOGNISED * person.usual_score)
        return followed.score >= least

    def _status_after(self, state: MonoState) -> Status:
        """A head that was gone for longer is found anew, wherever it comes back."""
        gone = state.lost >= self._config.status.lost_after_frames
        return Status.REINITIALISED if gone else Status.TRACKING

    def _tracked(
        self, state: MonoState, frame: Frame, followed: Followed, status: Status
    ) -> tuple[MonoState, Estimate]:
        """Adjust the person by a frame in which the head was found."""
        person = state.person.scored(followed.score)
        if self._is_to_be_adjusted(followed):
            view, settings = self._view(frame, followed), self._config.adjustment
            person = person.after(view, followed.score, self._model, self._camera, settings)
            followed = self._adjusted(state.following, person, followed)
        if followed.following.previous is not None and self._is_keyframe(person, followed):
            keyframe = self._keyframe(followed.following.previous, followed.correlations)
            person = replace(person, sets=(*person.sets, keyframe))
        after = replace(state.with_person(person), following=followed.following, lost=0, strange=0, cut=False)
        return after, self._tracked_estimate(frame, after, followed, status)

    def _is_to_be_adjusted(self, followed: Followed) -> bool:
        """Only a face that looks at the camera, and like itself (4.4.3)."""
        settings = self._config.adjustment
        facing = off_axis_deg(followed.following.pose) < settings.facing_deg
        return settings.when == "always" and facing and followed.score > settings.score

    def _view(self, frame: Frame, followed: Followed) -> PointView:
        a = followed.coefficients + self._model.deformation_mean
        weights = np.where(np.isfinite(followed.pixels[0, :, 0]), followed.weights, 0.0)
        return PointView(frame.stamp_ns, followed.pixels[0], weights, followed.following.pose, a)

    def _adjusted(self, before: Following | None, person: KnownPerson, followed: Followed) -> Followed:
        """Return what a frame says after the adjustment that it took part in."""
        view, now = person.views[-1], followed.following
        coefficients = view.deformation - self._model.deformation_mean
        velocity = now.velocity
        if before is not None and np.any(velocity):
            velocity = velocity_between(before.pose, view.pose, followed.dt)
        following = replace(
            now,
            pose=view.pose,
            velocity=velocity,
            particles=now.particles.moved_to(view.pose, coefficients),
            shape=self._on_rays(view.pose, person.shape.shapes(coefficients), followed.pixels[0]),
        )
        return replace(followed, following=following, coefficients=coefficients)

    def _on_rays(self, pose: HeadPose, shape: FloatArray, pixels: FloatArray) -> FloatArray:
        """The points (K, 3) in the head's frame that are seen at pixels (K, 2), as deep as a shape's."""
        depths = pose.points(shape)[:, 2:]
        points = np.hstack([normalised_from_pixels(self._camera, pixels) * depths, depths])
        return np.where(np.isfinite(points), (points - pose.position) @ pose.rotation, shape)

    def _is_keyframe(self, person: KnownPerson, followed: Followed) -> bool:
        """Whether a frame shows the nearly neutral face from a direction of which nothing is kept."""
        settings = self._config.refinement
        deformed = float(np.linalg.norm(person.shape.basis @ followed.coefficients))
        clear = deformed < settings.keyframe_neutral_mm and followed.score > settings.keyframe_correlation
        return clear and is_new(person.sets, followed.following.pose.facing, settings.keyframe_deg)

    def _keyframe(self, templates: TemplateSet, correlations: FloatArray) -> TemplateSet:
        """A frame's templates without the points that do not look like themselves: they may have left."""
        alike = np.nan_to_num(correlations) > self._config.refinement.keyframe_correlation
        return replace(templates, seen=templates.seen & alike)

    # A head that is not where it was

    def _lost(self, state: MonoState, frame: Frame) -> tuple[MonoState, Estimate]:
        """Nothing is learnt; the head is looked for where it was last."""
        following = state.following
        if following is not None:
            following = replace(following, velocity=np.zeros_like(following.velocity))
        after = replace(state, following=following, lost=state.lost + 1)
        return after, self._searched_estimate(frame, after)

    def _search(self, state: MonoState, frame: Frame, rng: np.random.Generator) -> tuple[MonoState, Estimate]:
        """Look for a face that is known already; it must then look as it did."""
        found = self._finder.detect(frame, self._last_seen(state, frame))
        if isinstance(found, NoStart):
            searched = state.search.failed(found) if state.following is None else state.search
            return self._lost(replace(state, search=searched), frame)
        for index, followed in self._tried(state, found, frame, rng):
            if self._is_tracked(state, state.people[index], followed):
                status = Status.TRACKING if state.following is None else Status.REINITIALISED
                return self._tracked(state.turned_to(index, frame.stamp_ns), frame, followed, status)
        return self._strange(state, found, frame, rng)

    def _tried(
        self, state: MonoState, found: DetectedFace, frame: Frame, rng: np.random.Generator
    ) -> Iterator[tuple[int, Followed]]:
        """Follow a face for one frame as each of the known people, the last one first."""
        for index in sorted(range(len(state.people)), key=lambda one: one != state.current):
            yield index, self._as_person(state, state.people[index], found, frame, rng)

    def _as_person(
        self,
        state: MonoState,
        person: KnownPerson,
        found: DetectedFace,
        frame: Frame,
        rng: np.random.Generator,
    ) -> Followed:
        """Follow a detected face for one frame as a person's."""
        gap_ns = round(FRAME_S * 1e9)
        if state.following is not None:
            gap_ns = frame.stamp_ns - state.following.stamp_ns
        mean = person.shape.mean
        pose, _ = pose_of(found.pixels, found.responses, self._camera, mean)
        following = self._follower.begin(frame.stamp_ns - gap_ns, pose, mean, person.shape, rng)
        followed = self._followed(person, following, frame, rng)
        rested = replace(followed.following, velocity=np.zeros_like(following.velocity))
        return replace(followed, following=rested)

    def _strange(
        self, state: MonoState, found: DetectedFace, frame: Frame, rng: np.random.Generator
    ) -> tuple[MonoState, Estimate]:
        """A face that looks like none of the known ones: after some frames it is another person's."""
        if off_axis_deg(found.pose) > STRANGER_OFF_AXIS_DEG:
            return self._lost(state, frame)
        state = replace(state, strange=state.strange + 1)
        if state.strange < (STRANGER_FRAMES_AFTER_CUT if state.cut else STRANGER_FRAMES):
            return self._lost(state, frame)
        return self._first_search(state, frame, rng)

    def _last_seen(self, state: MonoState, frame: Frame) -> FloatArray | None:
        """Where the points were when the head was last tracked, unless that was long ago or before a cut."""
        following = state.following
        if following is None or state.cut or frame.stamp_ns - following.stamp_ns > FORGOTTEN_S * 1e9:
            return None
        pixels: FloatArray = project((self._camera,), following.pose.points(following.shape)).pixels[0]
        return pixels

    # A head that was never found

    def _first_search(
        self, state: MonoState, frame: Frame, rng: np.random.Generator
    ) -> tuple[MonoState, Estimate]:
        """Collect n frames with the face, then adjust them together (4.4.1).

        Until then each frame is given the pose that it has alone **[ours]**.
        """
        if state.clicked is not None:
            return self._begun_with(replace(state, clicked=None), (state.clicked,), frame, rng)
        state = state.not_before(frame.stamp_ns - round(self._config.start.span_s * 1e9))
        found = self._finder.detect(frame, state.detected[-1].pixels if state.detected else None)
        alone = found if isinstance(found, NoStart) else self._finder.begin((found,))
        if isinstance(alone, NoStart):
            return self._not_found(state, alone, frame)
        if isinstance(found, NoStart):
            raise RuntimeError("no face was found, and yet one began")  # never: alone is found's failure
        state = state.seen(found, self._finder.templates(frame, found, alone))
        if len(state.detected) < self._config.start.frames:
            followed = self._resting(frame, found, alone, rng)
            status = Status.REINITIALISED if state.people else Status.TRACKING
            return state, self._tracked_estimate(frame, MonoState(), followed, status)
        start = self._finder.begin(state.detected)
        if isinstance(start, NoStart):
            return self._not_found(state.anew(), start, frame)
        return self._found(state, start, frame, rng)

    def _not_found(self, state: MonoState, failure: NoStart, frame: Frame) -> tuple[MonoState, Estimate]:
        state = replace(state, search=state.search.failed(failure), lost=state.lost + 1)
        return state, self._searched_estimate(frame, state)

    def _begun_with(
        self, state: MonoState, detected: tuple[DetectedFace, ...], frame: Frame, rng: np.random.Generator
    ) -> tuple[MonoState, Estimate]:
        """Begin at once, from points that a person clicked."""
        start = self._finder.begin(detected)
        if isinstance(start, NoStart):
            raise NoFaceError(
                "clicked points begin no head",
                found=start.reason,
                hint="were they clicked in the first frame that is tracked? right is the subject's right",
            )
        state = state.seen(detected[-1], self._finder.templates(frame, detected[-1], start))
        return self._found(state, start, frame, rng)

    def _found(
        self, state: MonoState, start: MonoStart, frame: Frame, rng: np.random.Generator
    ) -> tuple[MonoState, Estimate]:
        """Begin to follow a head; its reference is what the first of the frames showed."""
        reference = self._finder.reference(state.first_templates, start)
        person = new_person(start.person, reference, self._model, self._config.adjustment)
        followed = self._resting(frame, state.detected[-1], start, rng)
        status = Status.REINITIALISED if state.people else Status.TRACKING
        after = state.with_new(person, followed.following, frame.stamp_ns)
        return after, self._tracked_estimate(frame, after, followed, status)

    def _resting(
        self, frame: Frame, found: DetectedFace, start: MonoStart, rng: np.random.Generator
    ) -> Followed:
        """What a frame says in which a face was detected that is not followed yet."""
        view, shape = start.views[-1], self._model.of_person(start.person.identity, start.person.offsets)
        own = self._on_rays(view.pose, shape.mean, found.pixels)
        seen = self._finder.templates(frame, found, start)
        following = self._follower.begin(frame.stamp_ns, view.pose, own, shape, rng, seen)
        return begun(following, shape.size, found.score, found.pixels[None])

    # What is said of a frame

    def _tracked_estimate(
        self, frame: Frame, state: MonoState, followed: Followed, status: Status
    ) -> Estimate:
        a = followed.coefficients + self._model.deformation_mean
        numbers = self._numbers(state, followed.score, followed.weights)
        return followed_estimate(frame, followed, status, a, numbers)

    def _searched_estimate(self, frame: Frame, state: MonoState) -> Estimate:
        mean, deviations = self._model.deformation_mean, self._model.deformation_deviations
        numbers = self._numbers(state, np.nan, None)
        return searched_estimate(frame, state.following, mean, deviations, numbers)

    def _numbers(self, state: MonoState, score: float, weights: FloatArray | None) -> FloatArray:
        if not state.people:
            unknown = np.full(self._model.identity_size, np.nan)
            return MonoNumbers(unknown, unknown, score=score, weights=weights).array()
        known = state.person
        return MonoNumbers(
            known.history.mean,
            known.history.spread,
            state.current,
            known.adjusted_frames,
            known.rms_px / self._scale,
            score,
            weights,
        ).array()


def _with_view(state: MonoState, frame: Frame) -> MonoState:
    """Return the state that knows what the scene looks like now, and whether it was cut to."""
    (image,) = frame.images
    if image is None:
        return state
    now = thumbnail(image)
    cut = state.cut or (state.scene is not None and is_cut(state.scene, now))
    return replace(state, scene=now, cut=cut)
