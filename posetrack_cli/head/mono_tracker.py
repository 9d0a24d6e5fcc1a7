"""The head tracker for one camera: it finds a head, follows it and learns whose it is (chapter 4)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.cuts import is_cut, thumbnail
from posetrack_cli.head.focal_doubt import focal_doubt
from posetrack_cli.head.following import Followed
from posetrack_cli.head.learning import off_axis_deg
from posetrack_cli.head.mono_config import HeadMonoConfig
from posetrack_cli.head.mono_estimates import MonoEstimates
from posetrack_cli.head.mono_finder import MonoFinder
from posetrack_cli.head.mono_start.detected import DetectedFace, clicked_face
from posetrack_cli.head.mono_start.start import MonoStart
from posetrack_cli.head.mono_state import MonoState, state_codec
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.person import KnownPerson, new_person
from posetrack_cli.head.person_codec import known_people, people_codec
from posetrack_cli.head.person_following import PersonFollower
from posetrack_cli.head.projection import project
from posetrack_cli.head.start.start import NoStart
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.two_pass import NothingFoundError

STRANGER_FRAMES = 10
"""A face that looks like none of the known ones in so many frames is another person's **[ours]**."""
STRANGER_FRAMES_AFTER_CUT = 3
"""So few after a cut: another scene is reason enough to expect another person."""
RECOGNISED = 0.85
"""After a cut a face is a known person's if its score is so much of the usual one."""
STRANGER_OFF_AXIS_DEG = 25.0
"""Only a face that looks at the camera tells: from the side one's own looks strange, too."""
CLEARLY_BETTER = 0.03
"""By so much the score of a face detected anew must be higher for it to take over from the track."""
FORGOTTEN_S = 1.0
"""A face that was gone for so long may come back elsewhere in the image."""


class MonoTracker:
    """Follows one head in the images of one camera; a ``LearningTracker``.

    Args:
        config: parameters.
        camera: of the recording.
        model: of faces.
        choice: which face to begin with, 0 the largest.
        clicked: (K, 2) pixels of the points in the first frame; None finds the face.
        clicked_where: what holds them, for an error.
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
        clicked_where: str = "",
        scale: float = 1.0,
        known: Mapping[str, np.ndarray[Any, Any]] | None = None,
    ) -> None:
        self._config, self._camera, self._model = config, camera, model
        self._clicked, self._clicked_where, self._scale = clicked, clicked_where, scale
        self._finder = MonoFinder(config, camera, model, choice)
        self._follower = PersonFollower(config, camera, model)
        self._estimates = MonoEstimates(model, scale)
        self.codec = state_codec(model, config.adjustment)
        people = () if known is None else known_people(known, model, config.adjustment)
        self._known = MonoState(people)

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
            followed = self._follower.followed(state.person, state.following, frame, rng)
            state, followed = self._checked(state, followed, frame, rng)
            if self._is_tracked(state, state.person, followed):
                return self._tracked(state, frame, followed, self._status_after(state))
            if state.lost + 1 < self._config.status.lost_after_frames and not state.cut:
                return self._lost(state, frame)
        return self._search(state, frame, rng)

    def learned(self, state: MonoState) -> dict[str, np.ndarray[Any, Any]]:
        """Return what was learned of the people seen, as arrays by name: identities, offsets, templates."""
        settings = self._config.adjustment
        people = tuple(one.over_all(self._model, self._camera, settings) for one in state.people)
        return people_codec(self._model, settings).to_arrays(people)

    def not_found(self, state: MonoState) -> str:
        """Say how a head was looked for that was found in no frame yet; empty once it was found."""
        return "" if state.following is not None or state.detected else str(state.search)

    def remarks(self, state: MonoState) -> tuple[str, ...]:
        """Say when another person was seen, and whether the camera seems to be another one."""
        people = (f"from frame {frame} on it is person {who}; the first is 0" for frame, who in state.changes)
        if not state.people:
            return ()
        settings = self._config.adjustment
        doubt = focal_doubt(state.person, self._model, self._camera, self._scale, settings)
        return (*people, *doubt)

    # A head that is followed

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
        again = self._follower.from_detection(state.person, found, state.following, frame, rng)
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
        person, followed = self._follower.learnt(state.person, state.following, frame, followed)
        after = replace(
            state.with_person(person).anew(), following=followed.following, lost=0, strange=0, cut=False
        )
        return after, self._estimates.tracked(frame, after, followed, status)

    # A head that is not where it was

    def _lost(self, state: MonoState, frame: Frame) -> tuple[MonoState, Estimate]:
        """Nothing is learnt; the head is looked for where it was last."""
        following = state.following
        if following is not None:
            following = replace(following, velocity=np.zeros_like(following.velocity))
        after = replace(state, following=following, lost=state.lost + 1)
        return after, self._estimates.searched(frame, after)

    def _search(self, state: MonoState, frame: Frame, rng: np.random.Generator) -> tuple[MonoState, Estimate]:
        """Look for a face that is known already; it must then look as it did."""
        found = self._finder.detect(frame, self._last_seen(state, frame))
        if isinstance(found, NoStart):
            searched = state.search.failed(found) if state.following is None else state.search
            return self._lost(replace(state, search=searched), frame)
        for index, followed in self._tried(state, found, frame, rng):
            if self._is_tracked(state, state.people[index], followed):
                status = Status.TRACKING if state.following is None else Status.REINITIALISED
                return self._tracked(state.turned_to(index, frame.index), frame, followed, status)
        return self._strange(state, found, frame, rng)

    def _tried(
        self, state: MonoState, found: DetectedFace, frame: Frame, rng: np.random.Generator
    ) -> Iterator[tuple[int, Followed]]:
        """Follow a face for one frame as each of the known people, the last one first."""
        for index in sorted(range(len(state.people)), key=lambda one: one != state.current):
            yield (
                index,
                self._follower.from_detection(state.people[index], found, state.following, frame, rng),
            )

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
        seen = self._finder.templates(frame, found, alone)
        state = state.seen(found, seen)
        if len(state.detected) < self._config.start.frames:
            followed = self._follower.resting(frame, found, alone, seen, rng)
            status = Status.REINITIALISED if state.people else Status.TRACKING
            unknown = MonoState(current=len(state.people))
            return state, self._estimates.tracked(frame, unknown, followed, status)
        start = self._finder.begin(state.detected)
        if isinstance(start, NoStart):
            return self._not_found(state.anew(), start, frame)
        return self._found(state, start, frame, rng)

    def _not_found(self, state: MonoState, failure: NoStart, frame: Frame) -> tuple[MonoState, Estimate]:
        state = replace(state, search=state.search.failed(failure), lost=state.lost + 1)
        return state, self._estimates.searched(frame, state)

    def _begun_with(
        self, state: MonoState, detected: tuple[DetectedFace, ...], frame: Frame, rng: np.random.Generator
    ) -> tuple[MonoState, Estimate]:
        """Begin at once, from points that a person clicked."""
        start = self._finder.begin(detected)
        if isinstance(start, NoStart):
            raise NothingFoundError(
                "clicked points begin no head",
                where=self._clicked_where,
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
        last = state.detected[-1]
        seen = self._finder.templates(frame, last, start)
        followed = self._follower.resting(frame, last, start, seen, rng)
        status = Status.REINITIALISED if state.people else Status.TRACKING
        after = state.with_new(person, followed.following, frame.index)
        return after, self._estimates.tracked(frame, after, followed, status)


def _with_view(state: MonoState, frame: Frame) -> MonoState:
    """Return the state that knows what the scene looks like now, and whether it was cut to."""
    (image,) = frame.images
    if image is None:
        return state
    now = thumbnail(image)
    cut = state.cut or (state.scene is not None and is_cut(state.scene, now))
    return replace(state, scene=now, cut=cut)
