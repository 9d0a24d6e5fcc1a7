"""Tracking of one frame: pose, deformation, points and confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from posetrack_cli.head.dense.face import KNOWN_FACES, KnownFace
from posetrack_cli.head.face.points import POINT_COUNT, POSE_SIZE, HeadPose, ShapeModel
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import (
    TemplateSet,
    nearest_templates,
    take_templates,
    tangents,
    template_images,
    visibility,
    warped,
)
from posetrack_cli.head.initialisation.mono import EYE_DISTANCE_MM, eye_distance_px
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.particles.filter import HeadFilter
from posetrack_cli.head.particles.particles import (
    FRAME_S,
    PARTICLES,
    HeadMotion,
    HeadParticles,
    velocity_between,
)
from posetrack_cli.head.particles.scores import PatchObservation
from posetrack_cli.head.refinement.evidence import ComparedFrame
from posetrack_cli.head.refinement.refine import recalculate, refine
from posetrack_cli.head.subject import SIGNS
from posetrack_cli.head.tracker.face_learning import off_axis_deg
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import Stamp, floats
from posetrack_cli.tracking.confidence import PROBABLY, Regression, RunningSigns, signs_codec

# Confidence: the probability that a head's estimate is correct **[ours]**.
#
# Correct means a rotation error below ``RIGHT_DEG`` and a mean point error in the head below ``RIGHT_MM``
# (``head.subject``), after removal of constant offsets: the placement of the head's frame and of its points
# is a convention. It is a logistic regression on running means (``tracking.confidence``) of
#
#     misfit          log (r + .4)    r: RMS distance of the points from the face model, % of the eye distance
#     smallness       log (80 / e)    e: eye distance of a face that looks at the camera, pixels
#     unsteadiness    log (u + .2)    u: rotation error of the constant-velocity prediction, degrees, over the
#                                     square root of the number of usual frame intervals
#     unseen          1 - W           W: mean weight of the points, 0 (hidden or unlike) to 1
#     unmatched       1 - M           M: share of the skin points found again; second pass of one camera only,
#                                     otherwise 0 with a weight of 0
#
# ``scripts/build confidence`` fits the weights to rendered and drawn heads, also at reduced size, blurred,
# fast, occluded, dark and noisy, because few regular frames fail. With skin, real videos are included:
# rendered heads alone give real faces too little confidence.

MONO = Regression(4.43, np.array([-0.75, -0.59, -0.17, -9.04, 0.0]))
MONO_WITH_SKIN = Regression(7.64, np.array([0.0, -0.12, -0.03, -5.27, -7.24]))
STEREO = Regression(3.70, np.array([-1.22, -1.00, -1.54, -7.07, 0.0]))
_USUAL_PX, _STEADY_DEG, _EXACT = 80.0, 0.2, 0.4
_LONGEST_S = 0.2
"""Time step limit, s: velocities do not last longer."""


NO_SIGNS: FloatArray = np.full(len(SIGNS), np.nan)
NO_SIGNS.setflags(write=False)
DOUBTFUL_SHARE, LONG_S = 0.1, 1.0
"""Thresholds of the warnings at the end of a run: share of doubtful frames, and length of a gap."""


def track_warnings(record: TrackRecord) -> tuple[str, ...]:
    """Return a warning about an unreliable track, in one line with advice; () for a good one."""
    found = []
    if record.doubtful > DOUBTFUL_SHARE * record.frames:
        found.append(f"{record.doubtful} of {record.frames} frames have low confidence (below {PROBABLY:g})")
    if record.gap_ns > LONG_S * 1e9:
        found.append(f"no face for {record.gap_ns * 1e-9:.1f} s after frame {record.gap_frame}")
    if not found:
        return ()
    help_ = (
        "inspect them with posetrack view; larger, sharper images of the whole face or --landmarks may help"
    )
    return (f"{'; '.join(found)}: {help_}",)


def confidence_signs(
    before: TrackState | None, fit: FrameFit, reported: FrameFit, camera: Camera
) -> FloatArray:
    """Return the inputs (5,) of the confidence model for a tracked frame.

    Args:
        before: the track after the previous frame; None without one.
        fit: of the frame, from its feature points.
        reported: of the frame, possibly refined by skin.
        camera: of the recorded image, the reference.
    """
    track = fit.track
    off_model = track.shape - track.particles.model.shapes(fit.coefficients)
    seen = (fit.weights > 0.0) & np.isfinite(fit.pixels).all(axis=2).any(axis=0)
    rms = float(np.sqrt(np.mean(np.sum(off_model[seen] ** 2, axis=1)))) if seen.any() else EYE_DISTANCE_MM
    return np.array(
        [
            np.log(100.0 * rms / EYE_DISTANCE_MM + _EXACT),
            np.log(_USUAL_PX / eye_distance_px(track.pose, camera)),
            np.log(_turn_error_deg(before, fit) + _STEADY_DEG),
            1.0 - float(fit.weights.mean()),
            0.0 if reported.unmatched is None else reported.unmatched,
        ]
    )


def _turn_error_deg(before: TrackState | None, fit: FrameFit) -> float:
    """Rotation error of the constant-velocity prediction, relative to how the particles' spread grows."""
    velocity = np.zeros(3) if before is None else before.velocity[3:]
    seconds = min(fit.dt, _LONGEST_S)
    turned = np.linalg.norm(fit.track.velocity[3:] - velocity) * seconds
    # whole intervals: stamps that jitter by a nanosecond change nothing
    return float(np.degrees(turned) / np.sqrt(max(round(seconds / FRAME_S), 1)))


# Frame-to-frame tracking: particle filter, refinement, individual points


@dataclass(frozen=True, eq=False)
class SeededFrame:
    """A frame and the random generator for its step.

    Attributes:
        frame: in the scale of the tracker.
        rng: source of randomness.
    """

    frame: Frame
    rng: np.random.Generator

    @property
    def index(self) -> int:
        """Frame number in the recording."""
        return self.frame.index

    @property
    def stamp_ns(self) -> int:
        """Time stamp of the frame."""
        return self.frame.stamp_ns


@dataclass(frozen=True, eq=False)
class TrackState:
    """State of a tracked head after a frame.

    Attributes:
        stamp_ns: of the frame.
        pose: of the head.
        velocity: tangent vector per second.
        particles: relative to that pose.
        shape: M', the refined points in the head's frame, mm.
        templates: of this frame; None if the head was placed without being observed.
    """

    stamp_ns: Stamp
    pose: HeadPose
    velocity: Annotated[FloatArray, floats(POSE_SIZE)]
    particles: Annotated[HeadParticles, PARTICLES]
    shape: Annotated[FloatArray, floats(POINT_COUNT, 3)]
    templates: TemplateSet | None

    def at_rest(self) -> TrackState:
        """Return the track with zero velocity."""
        return replace(self, velocity=np.zeros_like(self.velocity))


@dataclass(frozen=True, eq=False)
class FrameFit:
    """Result of tracking one frame.

    Attributes:
        track: state from which tracking continues.
        coefficients: (B,) deformation, mm.
        coefficient_rate: (B,) its change since the previous frame, mm/s.
        variance: (6 + B,) of pose (tangent vector) and coefficients.
        dt: s since the previous frame.
        correlations: (K,) of each refined point, in the best camera; NaN where no camera sees it.
        weights: (K,) visibility of each point times its correlation, 0 to 1.
        score: visibility-weighted mean correlation of the points; 0 if none is visible.
        pixels: (C, K, 2) of the points in the images.
        effective_sample_size: of the particles.
        is_anchored: the points were detected or compared with the previous frame only, not with stored
            templates.
        unmatched: share of the skin points that were not found; None without a skin map.
        skin_share: share of the skin in the pose, 0 to 1.
        by_camera: (C, K) correlations of the refined points in every camera; None before tracking.
    """

    track: TrackState
    coefficients: FloatArray
    coefficient_rate: FloatArray
    variance: FloatArray
    dt: float
    correlations: FloatArray
    weights: FloatArray
    score: float
    pixels: FloatArray
    effective_sample_size: float
    is_anchored: bool = False
    unmatched: float | None = None
    skin_share: float = 0.0
    by_camera: FloatArray | None = None


LONG_AGO_NS = -(2**62)


class TrackRecord(NamedTuple):
    """Statistics of a track since the head was first found.

    Attributes:
        frames: number of frames, tracked or lost.
        doubtful: tracked frames with a confidence below one half.
        gap_ns: longest time without a head, up to the last frame.
        gap_frame: last frame with a head before that gap.
        last_frame: last frame with a head.
    """

    frames: int = 0
    doubtful: int = 0
    gap_ns: int = 0
    gap_frame: int = 0
    last_frame: int = 0

    def tracked(self, frame_index: int, *, doubtful: bool) -> TrackRecord:
        """Return the record after a tracked frame."""
        counted = self._replace(frames=self.frames + 1, doubtful=self.doubtful + int(doubtful))
        return counted._replace(last_frame=frame_index)

    def missed(self, gone_ns: int) -> TrackRecord:
        """Return the record after a lost frame, ``gone_ns`` after the last tracked one."""
        counted = self._replace(frames=self.frames + 1)
        if gone_ns <= self.gap_ns:
            return counted
        return counted._replace(gap_ns=gone_ns, gap_frame=self.last_frame)


NO_EVIDENCE, NO_RECORD = RunningSigns.before(len(SIGNS)), TrackRecord()
"""Values before any frame."""


class SoughtFace(NamedTuple):
    """A face from which a person is being initialised.

    Attributes:
        first_ns: stamp of its first frame.
        middle: (2,) pixels of its last place in the recorded image.
        eye_distance: pixels.
    """

    first_ns: int
    middle: FloatArray
    eye_distance: float


@dataclass(frozen=True, eq=False)
class HeadState:
    """State of a head tracker after a frame; subclasses add the learned face.

    Attributes:
        track: at the last tracked frame; None before the first.
        lost: number of consecutive lost frames up to the last one.
        search: statistics of the search before the first detection.
        first_ns: stamp of the first frame, to which clicked points refer.
        evidence: running confidence signs.
        record: statistics of the track.
        dense: what is known of the dense face of each person.
        trust: score of the last tracked frame, 0 to 1.
    """

    track: TrackState | None = None
    lost: int = 0
    search: Search = field(default_factory=Search)
    first_ns: Stamp = LONG_AGO_NS
    evidence: Annotated[RunningSigns, signs_codec(len(SIGNS))] = NO_EVIDENCE
    record: TrackRecord = NO_RECORD
    dense: Annotated[tuple[KnownFace, ...], KNOWN_FACES] = ()
    trust: Annotated[float, floats(least=0.0, most=1.0)] = 0.0

    @property
    def is_found(self) -> bool:
        """Whether a head was found in any frame so far."""
        return self.track is not None

    @property
    def sought(self) -> SoughtFace | None:
        """The face from which a person is being initialised over several frames; None without one."""
        return None

    def after_absence(self) -> HeadState:
        """Return the state to search with after a long absence."""
        return self

    def last_seen_ns(self, frame: SeededFrame) -> int:
        """Return the stamp of the last tracked frame; a frame interval ago before the first."""
        return frame.stamp_ns - round(FRAME_S * 1e9) if self.track is None else self.track.stamp_ns

    @property
    def begun_late(self) -> int | None:
        """The frame in which the head was found, if earlier ones may show it; None otherwise."""
        return None

    @property
    def is_continuous(self) -> bool:
        """Whether the head may still be near its last tracked pose."""
        return True


class FrameTracker:
    """One tracking step of chapters 3 and 4: filter, refinement and point recalculation.

    Args:
        config: of filter and refinement.
        cameras: of the recording, one or more.
    """

    def __init__(self, config: HeadStereoConfig | HeadMonoConfig, cameras: Sequence[Camera]) -> None:
        self._settings, self._motion, self._cameras = config.refinement, config.particles, cameras
        self._filter = HeadFilter(config.particles, cameras)
        adjustment = config.adjustment if isinstance(config, HeadMonoConfig) else None
        self._gate = adjustment if adjustment is not None and adjustment.gates_points else None

    def images(self, frame: SeededFrame) -> RigImages:
        """Return a frame's images with their cameras."""
        return RigImages(self._cameras, frame.frame.images)

    def start(
        self,
        frame: SeededFrame,
        pose: HeadPose,
        shape: FloatArray,
        model: ShapeModel,
        seen: TemplateSet | None = None,
    ) -> TrackState:
        """Return a track at rest with points at ``shape`` (K, 3), mm, and their templates if observed."""
        particles = self._filter.start(pose, model, frame.rng)
        return TrackState(frame.stamp_ns, pose, np.zeros(POSE_SIZE), particles, shape, seen)

    def step(
        self,
        before: TrackState,
        frame: SeededFrame,
        templates: Sequence[TemplateSet],
        model: ShapeModel,
    ) -> FrameFit:
        """Track one frame.

        Args:
            before: state after the previous frame.
            frame: one grey image per camera; None for a missing image.
            templates: reference first.
            model: of the face.
        """
        dt, images = (frame.stamp_ns - before.stamp_ns) * 1e-9, self.images(frame)
        motion = HeadMotion(before.velocity, dt, self._motion)
        particles = before.particles.with_model(model)
        expected = _expected(images, templates, motion.predicted(before.pose), particles)
        filtered = self._filter.step(particles, motion, expected, frame.rng)
        nearest = nearest_templates(templates, filtered.pose.facing)
        compared = ComparedFrame(images, nearest, before.templates, self._settings)
        refined = refine(compared, model, filtered.pose, filtered.coefficients)
        places = model.shapes(refined.coefficients)
        correlations, score = agreement(refined.correlations, refined.visibility)
        settings, start = self._settings, before.shape
        # without iterations the points stay at the model's places, and only their correlations are computed
        if not self._recalculates(refined.pose, score):
            settings, start = settings.model_copy(update={"recalculation_iterations": 0}), places
        own = recalculate(refined.scene, refined.pose, places, start, settings)
        track = TrackState(
            frame.stamp_ns,
            refined.pose,
            velocity_between(before.pose, refined.pose, dt),
            filtered.particles.moved_to(refined.pose, refined.coefficients),
            own.shape,
            take_templates(images, refined.pose, own.shape, own.pixels),
        )
        at_own_places, _ = agreement(own.correlations, refined.visibility)
        return FrameFit(
            track,
            refined.coefficients,
            (refined.coefficients - particles.coefficients) / dt,
            track.particles.variance(),
            dt,
            at_own_places,
            refined.visibility.max(axis=0) * np.clip(np.nan_to_num(correlations), 0.0, 1.0),
            score,
            own.pixels,
            filtered.effective_sample_size,
            by_camera=own.correlations,
        )

    def _recalculates(self, pose: HeadPose, score: float) -> bool:
        """Whether points may leave the model; as printed, only in frames that pass the gate (4.4.3)."""
        gate = self._gate
        return gate is None or (off_axis_deg(pose) < gate.facing_deg and score > gate.score)


def _expected(
    images: RigImages, templates: Sequence[TemplateSet], pose: HeadPose, particles: HeadParticles
) -> PatchObservation:
    """Predict templates and visibilities of the points at a pose."""
    shape = particles.model.shapes(particles.coefficients)
    projection = project(images.cameras, pose.points(shape))
    patches, known = warped(nearest_templates(templates, pose.facing)[-1], tangents(projection, pose))
    return PatchObservation(images.images, template_images(patches), visibility(projection, pose) * known)


def initial_fit(track: TrackState, score: float, pixels: FloatArray) -> FrameFit:
    """Return the fit of the frame in which a head was first found.

    Args:
        track: of the head, at rest.
        score: of the initialisation.
        pixels: (C, K, 2) of the detected points.
    """
    particles = track.particles
    nothing = np.zeros(particles.model.size)  # the deformation is not observed yet
    return FrameFit(
        track,
        coefficients=nothing,
        coefficient_rate=nothing,
        variance=particles.variance(),
        dt=FRAME_S,
        correlations=np.full(len(track.shape), score),
        weights=np.full(len(track.shape), score),
        score=score,
        pixels=pixels,
        effective_sample_size=float(len(particles.weights)),
    )


def agreement(correlations: FloatArray, seen: FloatArray) -> tuple[FloatArray, float]:
    """Return each point's best correlation (K,) over cameras and their visibility-weighted mean.

    Args:
        correlations: (C, K); NaN where a camera has no comparison.
        seen: (C, K) visibility, 0 to 1.
    """
    known = np.where(np.isnan(correlations) | (seen <= 0.0), -np.inf, correlations)
    best = known.max(axis=0)
    weights = np.where(np.isfinite(best), seen.max(axis=0), 0.0)
    total = float(weights.sum())
    score = float(weights @ np.where(np.isfinite(best), best, 0.0)) / total if total > 0.0 else 0.0
    return np.where(np.isfinite(best), best, np.nan), score
