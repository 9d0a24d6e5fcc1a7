"""What stereo and mono trackers share, and the estimates they state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import quaternion_rate
from posetrack_cli.head.config import HeadStatusSettings
from posetrack_cli.head.face.points import MEAN_SHAPE, POSE_SIZE, HeadPose
from posetrack_cli.head.initialisation.search import InitFailure
from posetrack_cli.head.tracker.frame_tracker import (
    NO_SIGNS,
    FrameFit,
    HeadState,
    SeededFrame,
    TrackState,
    doubts,
    signs_of,
)
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.confidence import PROBABLY, Regression
from posetrack_cli.tracking.state_codec import Codec
from posetrack_cli.tracking.two_pass import Learned, NothingFoundError

# What a head tracker says about a frame, as results hold it


UNSEEN = HeadPose(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
"""Pose reported before the first detection: before the camera, looking at it; its status is lost."""
UNKNOWN_SD = np.array([300.0] * 3 + [1.0] * 3)
"""(6,) mm and rad, of a head whose place is not known."""


@dataclass(frozen=True, eq=False)
class Description:
    """A face as the result of a frame states it.

    Attributes:
        coefficients: (B,) deformation; where a fit has fewer, the rest of its variances and rates is 0.
        deviations: (B,) standard deviations of the coefficients while the face is not seen.
        diagnostics: (M,) what ``head.subject`` names.
        systematic: (6,) variances of what the whole track is wrong by, mm^2 in camera axes and rad^2 in the
            head's, beside those of a frame; None where nothing is known.
    """

    coefficients: FloatArray
    deviations: FloatArray
    diagnostics: FloatArray
    systematic: FloatArray | None = None


def tracked_estimate(
    frame: Frame,
    fit: FrameFit,
    status: Status,
    confidence: float,
    face: Description,
    signs: FloatArray,
) -> Estimate:
    """Return the estimate of a frame in which the head was followed, and what its confidence rests on.

    Velocities are differences of two frames' estimates, whose errors are taken for independent.
    """
    count, now = len(face.coefficients), fit.track
    rotation = now.pose.rotation
    variance = in_body_axes(padded(fit.variance, POSE_SIZE + count), rotation)
    rate = padded(fit.coefficient_rate, count)
    stated = variance.copy()
    if face.systematic is not None:
        stated[:POSE_SIZE] += face.systematic
    twist = np.concatenate([now.velocity[:3], rotation.T @ now.velocity[3:], rate])
    return Estimate(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        status=status,
        confidence=confidence,
        position=now.pose.position,
        quaternion=now.pose.quaternion,
        shape=face.coefficients,
        pose_rate=np.concatenate([twist[:3], quaternion_rate(now.pose.quaternion, twist[3:6]), rate]),
        twist=twist,
        pose_variance=stated,
        twist_variance=2.0 * variance / fit.dt**2,
        points=now.pose.points(now.shape),
        effective_sample_size=fit.effective_sample_size,
        resampled=True,
        numbers=np.concatenate([face.diagnostics, signs]),
    )


def lost_estimate(frame: Frame, track: TrackState | None, face: Description) -> Estimate:
    """Return the estimate of a frame in which the head was not found: where it was last, status lost."""
    pose = UNSEEN if track is None else track.pose
    shape = MEAN_SHAPE if track is None else track.shape
    count = len(face.coefficients)
    nothing = np.zeros(POSE_SIZE + count)
    variance = np.concatenate([np.square(UNKNOWN_SD), np.square(face.deviations)])
    return Estimate(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        status=Status.LOST,
        confidence=0.0,
        position=pose.position,
        quaternion=pose.quaternion,
        shape=face.coefficients,
        pose_rate=np.zeros(POSE_SIZE + 1 + count),
        twist=nothing,
        pose_variance=variance,
        twist_variance=variance,
        points=pose.points(shape),
        effective_sample_size=None,
        resampled=False,
        numbers=np.concatenate([face.diagnostics, NO_SIGNS]),
    )


def padded(values: FloatArray, count: int) -> FloatArray:
    """Return the first ``count`` values; zeros where there are fewer."""
    filled = np.zeros(count)
    filled[: len(values)] = values[:count]
    return filled


def in_body_axes(variance: FloatArray, rotation: FloatArray) -> FloatArray:
    """Variances (6 + B,) whose rotation part is about the head's axes instead of the camera's."""
    turned = variance.copy()
    turned[3:6] = np.square(rotation.T) @ variance[3:6]
    return turned


# The head tracker: it finds a head, follows it from frame to frame, and learns its face.
#
# The same steps serve several calibrated cameras (thesis, chapter 3) and one (chapter 4). What differs
# between the two, how a face is found, recognised and learned, is asked of ``Faces``: a ``StereoFace`` or
# ``MonoPeople``.


State = TypeVar("State", bound=HeadState)
Found = TypeVar("Found")


class Faces(Protocol[State, Found]):
    """What differs between one camera and several: how a face is found, recognised, learned and described."""

    @property
    def codec(self) -> Codec[State]:
        """How states become arrays, for a checkpoint, and back."""

    @property
    def status(self) -> HeadStatusSettings:
        """When a head counts as tracked."""

    @property
    def cameras(self) -> Sequence[Camera]:
        """The recording's."""

    def start(self) -> State:
        """Return the state before a first frame: nothing is known, or what another tracker has learned."""

    def look(self, state: State, frame: Frame) -> tuple[State, Frame]:
        """Return the frame as it is tracked in, and the state that knows what the whole image tells."""

    def is_known(self, state: State) -> bool:
        """Whether a face is known, so that one that is found can be recognised."""

    def detect(self, state: State, frame: SeededFrame) -> Found | InitFailure:
        """Look for a face in a frame."""

    def begin(self, state: State, frame: SeededFrame) -> tuple[State, FrameFit | InitFailure]:
        """Look for a face that is not known, and begin to know it where there is one."""

    def fit(self, state: State, track: TrackState, frame: SeededFrame) -> tuple[State, FrameFit]:
        """Follow the head that was tracked before into a frame."""

    def recognise(self, state: State, found: Found, frame: SeededFrame) -> Iterator[tuple[State, FrameFit]]:
        """Follow a face that was found as each of the known ones, the likeliest first; it is at rest."""

    def least_score(self, state: State) -> float:
        """Return the score from which on a face counts as the known one."""

    def not_recognised(self, state: State, found: Found) -> tuple[State, bool]:
        """Note a face that is none of the known ones; tell whether it is to be begun with."""

    def learn(self, state: State, frame: SeededFrame, fit: FrameFit) -> tuple[State, FrameFit]:
        """Learn from a frame in which the head was tracked; return what the frame then says."""

    def state_fit(self, state: State, frame: SeededFrame, fit: FrameFit) -> tuple[State, FrameFit]:
        """Return what the result says of a frame, which may be better than what the track goes on from."""

    def regression(self, stated: FrameFit) -> Regression:
        """Return how probable it is that a frame of which this is stated is right, by its signs."""

    def describe(self, state: State, fit: FrameFit | None) -> Description:
        """Return the face as the result of a frame states it; without a fit, of one without a head."""

    def export_model(self, state: State, *, for_second_pass: bool) -> Learned:
        """Return what was learned of a known face, as arrays by name.

        For a second pass over the same images also what holds in them alone.
        """

    def remarks(self, state: State) -> tuple[str, ...]:
        """Say what a user should know about a finished run beside its numbers; each is one line."""


class HeadTracker(Generic[State, Found]):
    """Follows one head.

    Args:
        faces: of several cameras, or of one.
    """

    def __init__(self, faces: Faces[State, Found]) -> None:
        self._faces = faces

    @property
    def codec(self) -> Codec[State]:
        """How states become arrays, for a checkpoint, and back."""
        return self._faces.codec

    def start(self, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before a first frame, in which the head has yet to be found."""
        return replace(self._faces.start(), first_ns=frame.stamp_ns)

    def step(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate]:
        """Advance by one frame; the state given is left as it is."""
        state, seen = self._faces.look(state, frame)
        now = SeededFrame(seen, rng)
        if state.track is None:  # of a face known from elsewhere, or anybody's
            return (
                self._reacquire(state, now) if self._faces.is_known(state) else self._initialise(state, now)
            )
        state, fit = self._faces.fit(state, state.track, now)
        if self._accepts(state, fit):
            return self._update(state, now, fit, found_anew=self._patience(state) < 0)
        if state.is_continuous and self._patience(state) > 0:
            return self._coast(state, now)
        return self._reacquire(state, now)

    def learned(self, state: State, *, for_second_pass: bool = False) -> Learned:
        """Return what was learned of the face as arrays by name; empty before it is known."""
        known = self._faces.is_known(state)
        return self._faces.export_model(state, for_second_pass=for_second_pass) if known else {}

    def not_found(self, state: State) -> str:
        """Say how a head was looked for that was found in no frame yet; empty once it was found."""
        return "" if state.is_found else str(state.search)

    def remarks(self, state: State) -> tuple[str, ...]:
        """Say what a user should know about a finished run beside its numbers; each is one line."""
        if not self._faces.is_known(state):
            return ()
        return (*self._faces.remarks(state), *doubts(state.record))

    def _accepts(self, state: State, fit: FrameFit) -> bool:
        """Whether a frame shows the face that is known."""
        return fit.score >= self._faces.least_score(state)

    def _patience(self, state: State) -> int:
        """In how many more frames the head may be missed before it is searched for; below 0 when it was."""
        return self._faces.status.lost_after_frames - 1 - state.lost

    def _initialise(self, state: State, frame: SeededFrame) -> tuple[State, Estimate]:
        """Look for a face that is not known."""
        is_another = self._faces.is_known(state)
        state, fit = self._faces.begin(state, frame)
        if isinstance(fit, InitFailure):
            return self._coast(self._failed(state, fit), frame)
        return self._tracked(state, None, frame, fit, fit, found_anew=is_another)

    def _update(
        self, state: State, frame: SeededFrame, fit: FrameFit, *, found_anew: bool
    ) -> tuple[State, Estimate]:
        """Learn from a frame in which the head was tracked."""
        before = state.track
        state, fit = self._faces.learn(state, frame, fit)
        state, stated = self._faces.state_fit(replace(state, track=fit.track, lost=0), frame, fit)
        return self._tracked(state, before, frame, fit, stated, found_anew=found_anew)

    def _coast(self, state: State, frame: SeededFrame) -> tuple[State, Estimate]:
        """Miss the head: nothing is learnt, and it is looked for where it was last."""
        track = None if state.track is None else state.track.at_rest()
        state = replace(state, track=track, lost=state.lost + 1)
        if track is not None:
            state = replace(state, record=state.record.missed(frame.stamp_ns - track.stamp_ns))
        return state, lost_estimate(frame.frame, track, self._faces.describe(state, None))

    def _reacquire(self, state: State, frame: SeededFrame) -> tuple[State, Estimate]:
        """Look for a face that is known; it must then look as it did."""
        found = self._faces.detect(state, frame)
        if isinstance(found, InitFailure):
            return self._coast(self._failed(state, found), frame)
        for recognised, fit in self._faces.recognise(state, found, frame):
            if self._accepts(recognised, fit):
                return self._update(recognised, frame, fit, found_anew=state.track is not None)
        state, is_new = self._faces.not_recognised(state, found)
        return self._initialise(state, frame) if is_new else self._coast(state, frame)

    def _failed(self, state: State, failure: InitFailure) -> State:
        """Count a search that failed before a head was found.

        Raises:
            NothingFoundError: the images belong to other cameras than they are said to.
        """
        if state.track is not None:
            return state
        search, names = state.search.failed(failure), [camera.name for camera in self._faces.cameras]
        if search.images_exchanged:
            raise NothingFoundError(
                "the cameras' images seem to be exchanged",
                found=f"in {search.exchanged} frames with a face the images fit the calibration in the order "
                + ", ".join(names[c] for c in search.order),
                expected=", ".join(names),
                hint="exchange the folders or topics, or calibrate again",
            )
        return replace(state, search=search)

    def _tracked(
        self,
        state: State,
        before: TrackState | None,
        frame: SeededFrame,
        fit: FrameFit,
        stated: FrameFit,
        *,
        found_anew: bool,
    ) -> tuple[State, Estimate]:
        """Tell of a frame with the head; of what is more probably wrong than right, that it is lost."""
        face = self._faces.describe(state, stated)
        evidence = state.evidence.after(signs_of(before, fit, stated, self._faces.cameras[0]))
        confidence = self._faces.regression(stated).probability(evidence.signs)
        record = state.record.tracked(frame.index, doubtful=confidence < PROBABLY)
        status = Status.REINITIALISED if found_anew else Status.TRACKING
        status = Status.LOST if confidence < self._faces.status.doubtful_below else status
        estimate = tracked_estimate(frame.frame, stated, status, confidence, face, evidence.signs)
        return replace(state, evidence=evidence, record=record), estimate
