"""The head tracker for calibrated cameras: it finds a head, follows it and learns its face (chapter 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid_alignment import rigid_alignment
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.following import Followed, Follower, Following, Images, begun
from posetrack_cli.head.keyframes import is_new
from posetrack_cli.head.learning import FaceLearning, new_face
from posetrack_cli.head.motion import FRAME_S
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.refinement.refine import point_values
from posetrack_cli.head.refinement.settling import settle
from posetrack_cli.head.start.start import NoStart, Start, find_start
from posetrack_cli.head.stereo_estimates import searched, tracked
from posetrack_cli.head.stereo_state import StereoCodecs, StereoState
from posetrack_cli.head.templates import TemplateSet, take_templates
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.state_codec import Codec
from posetrack_cli.tracking.two_pass import NothingFoundError


class FindStart(Protocol):
    """How a face is found in one frame."""

    def __call__(self, images: Images) -> Start | NoStart:
        """Return where the face is, or why none was found."""


class StereoTracker:
    """Follows one head in the images of calibrated cameras; a ``LearningTracker``.

    Args:
        config: parameters.
        cameras: of the recording, the reference first.
        find_start: finds a face in one frame.
        known: what another tracker has ``learned``: model and templates to begin with.

    Raises:
        ResultError: ``known`` is not what a stereo tracker with these cameras learns.
    """

    def __init__(
        self,
        config: HeadStereoConfig,
        cameras: Sequence[Camera],
        find_start: FindStart,
        known: Mapping[str, np.ndarray[Any, Any]] | None = None,
    ) -> None:
        self._config, self._cameras, self._find_start = config, tuple(cameras), find_start
        self._follower = Follower(config.particles, config.refinement, self._cameras)
        self._steadiness = point_values(config.model.expression_mm) ** -2
        self._codecs = StereoCodecs(len(self._cameras), config.model)
        self._known = StereoState() if known is None else self._codecs.known(known)

    @property
    def codec(self) -> Codec[StereoState]:
        """How states are kept."""
        return self._codecs.state

    def start(self, frame: Frame, rng: np.random.Generator) -> StereoState:
        """Return the state before a first frame, in which the head has yet to be found."""
        return self._known

    def step(
        self, state: StereoState, frame: Frame, rng: np.random.Generator
    ) -> tuple[StereoState, Estimate]:
        """Advance by one frame; the state given is left as it is."""
        if state.face is None:
            return self._first_search(state, frame, rng)
        if state.following is not None:
            followed = self._followed(state, state.following, frame, rng)
            if self._is_tracked(followed):
                return self._tracked(state, frame, followed, self._status_after(state))
            if state.lost + 1 < self._config.status.lost_after_frames:
                return self._lost(state, frame)
        return self._search(state, frame, rng)

    def learned(self, state: StereoState) -> dict[str, np.ndarray[Any, Any]]:
        """Return what was learned of the face, shape model and templates, as arrays by name."""
        return self._codecs.learned(state) if state.face is not None else {}

    def not_found(self, state: StereoState) -> str:
        """Say how a head was looked for that was found in no frame yet; empty once it was found."""
        if state.following is not None:
            return ""
        return str(state.search)

    def remarks(self, state: StereoState) -> tuple[str, ...]:
        """Say nothing: what a stereo run finds is in its numbers."""
        return ()

    def _followed(
        self, state: StereoState, following: Following, frame: Frame, rng: np.random.Generator
    ) -> Followed:
        face = _found(state.face)
        return self._follower.step(following, frame.stamp_ns, frame.images, state.sets, face.model, rng)

    def _status_after(self, state: StereoState) -> Status:
        """A head that was gone for longer is found anew, wherever it comes back."""
        gone = state.lost >= self._config.status.lost_after_frames
        return Status.REINITIALISED if gone else Status.TRACKING

    def _is_tracked(self, followed: Followed) -> bool:
        return followed.score >= self._config.status.tracking_above

    def _tracked(
        self, state: StereoState, frame: Frame, followed: Followed, status: Status
    ) -> tuple[StereoState, Estimate]:
        """Learn from a frame in which the head was found."""
        now, settings = followed.following, self._config
        face = _found(state.face).after(
            now.shape, self._steadiness, now.pose, followed.correlations, settings.model
        )
        sets = state.sets
        if now.previous is not None and self._is_keyframe(sets, followed):
            sets = (*sets, now.previous)
        after = replace(state, face=face, sets=sets, following=now, lost=0)
        return after, tracked(frame, followed, face, status, settings)

    def _is_keyframe(self, sets: Sequence[TemplateSet], followed: Followed) -> bool:
        """Whether a frame shows the nearly neutral face from a direction of which nothing is kept."""
        settings = self._config.refinement
        neutral = float(np.linalg.norm(followed.coefficients)) < settings.keyframe_neutral_mm
        clear = followed.score > settings.keyframe_correlation
        return neutral and clear and is_new(sets, followed.following.pose.facing, settings.keyframe_deg)

    def _lost(self, state: StereoState, frame: Frame) -> tuple[StereoState, Estimate]:
        """The head is not where it was expected: nothing is learnt; it is looked for where it was last."""
        face, following = _found(state.face), state.following
        if following is not None:
            following = replace(following, velocity=np.zeros_like(following.velocity))
        after = replace(state, following=following, lost=state.lost + 1)
        return after, searched(frame, following, face, self._config)

    def _search(
        self, state: StereoState, frame: Frame, rng: np.random.Generator
    ) -> tuple[StereoState, Estimate]:
        """Look for a face that is known already; it must then look as it did."""
        found = self._find_start(frame.images)
        if not isinstance(found, Start):
            return self._lost(self._after_search(state, found), frame)
        face = _found(state.face)
        pose = self._laid_on(face.model.mean, found)
        stamp_ns = frame.stamp_ns - self._gap_ns(state, frame)
        following = self._follower.begin(stamp_ns, pose, face.model.mean, face.model, rng)
        followed = self._followed(state, following, frame, rng)
        if not self._is_tracked(followed):
            return self._lost(state, frame)
        status = Status.TRACKING if state.following is None else Status.REINITIALISED
        rested = replace(followed.following, velocity=np.zeros_like(following.velocity))
        return self._tracked(state, frame, replace(followed, following=rested), status)

    def _after_search(self, state: StereoState, failure: NoStart) -> StereoState:
        """Count a search that failed; refuse images that belong to other cameras than they are said to."""
        if state.following is not None:
            return state
        search = state.search.failed(failure)
        if search.images_exchanged:
            names = [camera.name for camera in self._cameras]
            raise NothingFoundError(
                "the cameras' images seem to be exchanged",
                found=f"in {search.exchanged} frames with a face the images fit the calibration in the order "
                + ", ".join(names[c] for c in search.order),
                expected=", ".join(names),
                hint="exchange the folders or topics, or calibrate again",
            )
        return replace(state, search=search)

    def _gap_ns(self, state: StereoState, frame: Frame) -> int:
        """Time since the head was last seen; the usual one between two frames if it was not."""
        if state.following is None:
            return round(FRAME_S * 1e9)
        return frame.stamp_ns - state.following.stamp_ns

    def _laid_on(self, mean: FloatArray, found: Start) -> HeadPose:
        """The pose in which the known shape lies best on the points that were found."""
        R, t = rigid_alignment(mean, found.pose.points(found.shape), self._steadiness)
        return HeadPose(t, quaternions_from_matrices(R))

    def _first_search(
        self, state: StereoState, frame: Frame, rng: np.random.Generator
    ) -> tuple[StereoState, Estimate]:
        found = self._find_start(frame.images)
        if not isinstance(found, Start):
            state = self._after_search(state, found)
            return state, searched(frame, None, None, self._config)
        shape = settle(frame.images, self._cameras, found.pose, found.shape, self._config.refinement)
        face = new_face(shape, self._config.model)
        reference = take_templates(frame.images, self._cameras, found.pose, shape)
        following = self._follower.begin(frame.stamp_ns, found.pose, shape, face.model, rng, reference)
        state = replace(state, face=face, sets=(reference,), following=following)
        followed = begun(following, face.model.size, found.score, found.pixels)
        return state, tracked(frame, followed, face, Status.TRACKING, self._config)


def make_stereo_tracker(
    config: HeadStereoConfig,
    cameras: Sequence[Camera],
    known: Mapping[str, np.ndarray[Any, Any]] | None = None,
) -> StereoTracker:
    """Return the tracker that finds the head by itself.

    Args:
        config: parameters.
        cameras: of the recording, the reference first.
        known: what another tracker has ``learned``.

    Raises:
        UsageError: a face detector without its model.
    """
    detector = FaceDetector(config.start.detection)

    def find(images: Images) -> Start | NoStart:
        return find_start(images, cameras, detector, config.start)

    return StereoTracker(config, cameras, find, known)


def _found(face: FaceLearning | None) -> FaceLearning:
    if face is None:
        raise RuntimeError("no face is known yet")  # a state that the methods above never make
    return face
