"""The head tracker: finds a head, follows it from frame to frame and learns its face.

The same steps serve several calibrated cameras (thesis, chapter 3) and one (chapter 4). The differences, how
a face is detected, recognised and learned, are behind the protocol ``Faces``, implemented by ``StereoFace``
and ``MonoPeople``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import quaternion_rate
from posetrack_cli.head.config import HeadMonoConfig, HeadStatusSettings, HeadStereoConfig
from posetrack_cli.head.dense.face import KNOWN_FACES, LEARNED_EVERY, DenseFaces
from posetrack_cli.head.face.points import MEAN_SHAPE, POSE_SIZE, HeadPose
from posetrack_cli.head.initialisation.search import InitFailure
from posetrack_cli.head.model_file import damaged_model
from posetrack_cli.head.subject import SIGN_NAMES
from posetrack_cli.head.tracker.frame_tracker import (
    NO_SIGNS,
    FrameFit,
    HeadState,
    SeededFrame,
    TrackState,
    confidence_signs,
    track_warnings,
)
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import Arrays, LayoutError
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.confidence import PROBABLY, Regression
from posetrack_cli.tracking.state_codec import Codec, joined, part_of
from posetrack_cli.tracking.two_pass import Learned, NothingFoundError

UNSEEN = HeadPose(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
"""Pose reported before the first detection, with status lost: in front of the camera and facing it."""
UNKNOWN_SD = np.array([300.0] * 3 + [1.0] * 3)
"""(6,) mm and rad, standard deviations of a pose that was not observed."""


@dataclass(frozen=True, eq=False)
class FaceDescription:
    """Deformation and diagnostics of a frame, as stored in results.

    Attributes:
        coefficients: (B,) deformation; missing variances and rates of a fit with fewer coefficients are 0.
        deviations: (B,) standard deviations of the coefficients while the face is not visible.
        diagnostics: (M,) numbers named in ``head.subject``.
        systematic: (6,) variances of the systematic error of the track, mm^2 in camera axes and rad^2 in head
            axes, added to those of the frame; None if unknown.
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
    face: FaceDescription,
    signs: FloatArray,
) -> Estimate:
    """Return the estimate of a tracked frame, including its confidence signs.

    Velocity variances are those of a difference of two frames with independent errors.
    """
    count, now = len(face.coefficients), fit.track
    rotation = now.pose.rotation
    variance = in_body_axes(padded(fit.variance, POSE_SIZE + count), rotation)
    rate = padded(fit.coefficient_rate, count)
    stated = variance.copy()
    if face.systematic is not None:
        stated[:POSE_SIZE] += face.systematic
    twist = np.concatenate([now.velocity[:3], rotation.T @ now.velocity[3:], rate])
    # position in camera axes, rotation in head axes, as twists are defined in results
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


def lost_estimate(frame: Frame, track: TrackState | None, face: FaceDescription) -> Estimate:
    """Return the estimate of a lost frame: the last known pose, with status lost."""
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
    """Return the first ``count`` values, padded with zeros."""
    filled = np.zeros(count)
    filled[: len(values)] = values[:count]
    return filled


def in_body_axes(variance: FloatArray, rotation: FloatArray) -> FloatArray:
    """Convert the rotation part of variances (6 + B,) from camera axes to head axes."""
    turned = variance.copy()
    turned[3:6] = np.square(rotation.T) @ variance[3:6]
    return turned


DENSE = "dense"
"""Part of the learned arrays that belongs to the dense face."""
State = TypeVar("State", bound=HeadState)
Found = TypeVar("Found")


class Faces(Protocol[State, Found]):
    """Camera-specific part of the tracker: detect, recognise, learn and describe faces."""

    @property
    def codec(self) -> Codec[State]:
        """Conversion of states to arrays, for checkpoints, and back."""

    @property
    def status(self) -> HeadStatusSettings:
        """Thresholds for a tracked head."""

    @property
    def cameras(self) -> Sequence[Camera]:
        """Cameras of the recording."""

    def start(self) -> State:
        """Return the state before the first frame, empty or with a previously learned face."""

    def prepare(self, state: State, frame: Frame) -> tuple[State, Frame]:
        """Return the frame in the scale of the tracker, and the state updated from the whole image."""

    def is_known(self, state: State) -> bool:
        """Whether a face has been learned, so that a detected one can be recognised."""

    def person_index(self, state: State) -> int:
        """Return the index of the tracked person."""

    def detect(self, state: State, frame: SeededFrame) -> Found | InitFailure:
        """Detect a face in a frame."""

    def begin(self, state: State, frame: SeededFrame) -> tuple[State, FrameFit | InitFailure]:
        """Detect an unknown face and start to learn it."""

    def fit(self, state: State, track: TrackState, frame: SeededFrame) -> tuple[State, FrameFit]:
        """Track the head from its last state into a frame."""

    def recognise(self, state: State, found: Found, frame: SeededFrame) -> Iterator[tuple[State, FrameFit]]:
        """Fit each known face, the most likely first, to a detected one; the fits have no velocity."""

    def least_score(self, state: State) -> float:
        """Return the minimum score for a known face."""

    def not_recognised(self, state: State, found: Found) -> tuple[State, bool]:
        """Count an unrecognised face; return whether to start a new one."""

    def learn(self, state: State, frame: SeededFrame, fit: FrameFit) -> tuple[State, FrameFit]:
        """Learn from a tracked frame; return the fit with the updated face."""

    def report_fit(self, state: State, frame: SeededFrame, fit: FrameFit) -> tuple[State, FrameFit]:
        """Return the fit for the result, which may be better than the one to continue from."""

    def regression(self, reported: FrameFit) -> Regression:
        """Return the confidence model for a frame."""

    def describe(self, state: State, fit: FrameFit | None) -> FaceDescription:
        """Return deformation and diagnostics of a frame; without a fit, those of a lost frame."""

    def export_model(self, state: State, *, for_second_pass: bool) -> Learned:
        """Return the learned face as arrays by name.

        With ``for_second_pass``, include data that is valid only for the same images.
        """

    def remarks(self, state: State) -> tuple[str, ...]:
        """Return warnings about a finished run, one line each."""


def dense_faces(
    config: HeadStereoConfig | HeadMonoConfig,
    cameras: Sequence[Camera],
    number_names: Sequence[str],
    known: Arrays | None,
) -> DenseFaces | None:
    """Return what measures the dense face in a pass that starts with what is known; None without it."""
    if not config.face.use:
        return None
    is_first_of_two = config.run.passes > 1 and known is None
    return DenseFaces(cameras, (*number_names, *SIGN_NAMES), LEARNED_EVERY if is_first_of_two else 1)


class HeadTracker(Generic[State, Found]):
    """Tracker of one head.

    Args:
        faces: camera-specific part, for several cameras or one.
        dense: measures the dense face; None without it.
        known: exported by another tracker, for what is known of the dense face.

    Raises:
        ResultError: ``known`` has a damaged dense face.
    """

    def __init__(
        self, faces: Faces[State, Found], dense: DenseFaces | None = None, known: Arrays | None = None
    ) -> None:
        self._faces, self._dense = faces, dense
        try:
            self._known_faces = KNOWN_FACES.from_arrays(part_of(known or {}, DENSE))
        except LayoutError as error:
            raise damaged_model(error, "a model saved by posetrack head") from error

    @property
    def codec(self) -> Codec[State]:
        """Conversion of states to arrays, for checkpoints, and back."""
        return self._faces.codec

    def start(self, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before the first frame."""
        return replace(self._faces.start(), first_ns=frame.stamp_ns, dense=self._known_faces)

    def step(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate]:
        """Advance by one frame; the given state is not modified."""
        return self._with_dense(frame, *self._step(state, frame, rng))

    def _with_dense(self, frame: Frame, state: State, estimate: Estimate) -> tuple[State, Estimate]:
        """Add the dense face to the estimate of a frame."""
        if self._dense is None or state.record.frames % self._dense.every:
            return state, estimate
        known, estimate = self._dense.add(state.dense, frame, estimate, self._faces.person_index(state))
        return replace(state, dense=known), estimate

    def _step(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate]:
        state, prepared = self._faces.prepare(state, frame)
        now = SeededFrame(prepared, rng)
        if state.track is None:  # the face may be known from a model file or the first pass
            return (
                self._reacquire(state, now) if self._faces.is_known(state) else self._initialise(state, now)
            )
        state, fit = self._faces.fit(state, state.track, now)
        if self._accepts(state, fit):
            return self._update(state, now, fit, reinitialised=self._patience(state) < 0)
        if state.is_continuous and self._patience(state) > 0:
            return self._coast(state, now)
        return self._reacquire(state, now)

    def follow(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate] | None:
        """Advance a tracked head by a frame without a search; None if it is not where it is expected."""
        state, prepared = self._faces.prepare(state, frame)
        if state.track is None:
            return None
        now = SeededFrame(prepared, rng)
        state, fit = self._faces.fit(state, state.track, now)
        if not self._accepts(state, fit):
            return None
        return self._with_dense(frame, *self._update(state, now, fit, reinitialised=False))

    def miss(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate]:
        """Advance by a frame in which the head counts as lost, without a search."""
        state, prepared = self._faces.prepare(state, frame)
        waiting = replace(state, lost=max(state.lost, 1))
        return self._with_dense(frame, *self._coast(waiting, SeededFrame(prepared, rng)))

    def is_known(self, state: State) -> bool:
        """Whether a face has been learned."""
        return self._faces.is_known(state)

    def learned(self, state: State, *, for_second_pass: bool = False) -> Learned:
        """Return the learned face as arrays by name; empty while no face is known."""
        if not self.is_known(state):
            return {}
        learned = self._faces.export_model(state, for_second_pass=for_second_pass)
        faces = KNOWN_FACES.to_arrays(state.dense)
        return learned | {joined(DENSE, name): array for name, array in faces.items()}

    def not_found(self, state: State) -> str:
        """Summarise an unsuccessful search; empty once a head was found."""
        return "" if state.is_found else str(state.search)

    def remarks(self, state: State) -> tuple[str, ...]:
        """Return warnings about a finished run, one line each."""
        if not self._faces.is_known(state):
            return ()
        return (*self._faces.remarks(state), *track_warnings(state.record))

    def _accepts(self, state: State, fit: FrameFit) -> bool:
        return fit.score >= self._faces.least_score(state)

    def _patience(self, state: State) -> int:
        """Return how many more frames may be lost before a new detection; negative after one."""
        return self._faces.status.lost_after_frames - 1 - state.lost

    def _initialise(self, state: State, frame: SeededFrame) -> tuple[State, Estimate]:
        is_new_person = self._faces.is_known(state)
        state, fit = self._faces.begin(state, frame)
        if isinstance(fit, InitFailure):
            return self._coast(self._failed(state, fit), frame)
        return self._tracked(state, None, frame, fit, fit, reinitialised=is_new_person)

    def _update(
        self, state: State, frame: SeededFrame, fit: FrameFit, *, reinitialised: bool
    ) -> tuple[State, Estimate]:
        before = state.track
        state, fit = self._faces.learn(state, frame, fit)
        state, reported = self._faces.report_fit(replace(state, track=fit.track, lost=0), frame, fit)
        return self._tracked(state, before, frame, fit, reported, reinitialised=reinitialised)

    def _coast(self, state: State, frame: SeededFrame) -> tuple[State, Estimate]:
        """Report a lost frame: nothing is learned, and the pose stays at rest."""
        track = None if state.track is None else state.track.at_rest()
        state = replace(state, track=track, lost=state.lost + 1)
        if track is not None:
            state = replace(state, record=state.record.missed(frame.stamp_ns - track.stamp_ns))
        return state, lost_estimate(frame.frame, track, self._faces.describe(state, None))

    def _reacquire(self, state: State, frame: SeededFrame) -> tuple[State, Estimate]:
        """Detect a known face; it must resemble the learned one."""
        found = self._faces.detect(state, frame)
        if isinstance(found, InitFailure):
            return self._coast(self._failed(state, found), frame)
        for recognised, fit in self._faces.recognise(state, found, frame):
            if self._accepts(recognised, fit):
                return self._update(recognised, frame, fit, reinitialised=state.track is not None)
        state, is_new = self._faces.not_recognised(state, found)
        return self._initialise(state, frame) if is_new else self._coast(state, frame)

    def _failed(self, state: State, failure: InitFailure) -> State:
        """Count a failed search before the first detection.

        Raises:
            NothingFoundError: the images of the cameras are swapped.
        """
        if state.track is not None:
            return state
        search, names = state.search.failed(failure), [camera.name for camera in self._faces.cameras]
        if search.images_swapped:
            raise NothingFoundError(
                "the cameras' images seem to be swapped",
                found=f"{search.swapped} frames with a face fit the calibration in the order "
                + ", ".join(names[c] for c in search.order),
                expected=", ".join(names),
                hint="swap the folders or topics, or calibrate again",
            )
        return replace(state, search=search)

    def _tracked(
        self,
        state: State,
        before: TrackState | None,
        frame: SeededFrame,
        fit: FrameFit,
        reported: FrameFit,
        *,
        reinitialised: bool,
    ) -> tuple[State, Estimate]:
        face = self._faces.describe(state, reported)
        evidence = state.evidence.after(confidence_signs(before, fit, reported, self._faces.cameras[0]))
        confidence = self._faces.regression(reported).probability(evidence.signs)
        record = state.record.tracked(frame.index, doubtful=confidence < PROBABLY)
        status = Status.REINITIALISED if reinitialised else Status.TRACKING
        # a doubtful frame is reported as lost, but tracking continues from it
        status = Status.LOST if confidence < self._faces.status.doubtful_below else status
        estimate = tracked_estimate(frame.frame, reported, status, confidence, face, evidence.signs)
        return replace(state, evidence=evidence, record=record), estimate
