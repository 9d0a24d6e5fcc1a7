"""One frame of a head's track: pose, points, confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
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

# How probable it is that a head's estimate is right **[ours]**.
#
# Confidence is the probability that the head's rotation is right to ``RIGHT_DEG`` and its points, on average,
# to ``RIGHT_MM`` in the head (``head.subject``). Where the head's frame sits and which places its points mark
# are conventions: the errors meant are those beside their constant offsets. It is a logistic regression on
# running means (``tracking.confidence``) of
#
#     misfit          log (r + .4)    r the root mean square distance of the points from where the face's
#                                     model has them, % of the eyes' distance
#     smallness       log (80 / e)    e the eyes' distance, pixels, of a face that looks at the camera
#     unsteadiness    log (u + .2)    u how many degrees off the head is from where its velocity led
#     unseen          1 - W           W how much the points counted on average, 0 (hidden or unlike) to 1
#     unmatched       1 - M           M how much of the skin looked for was found again; in the second pass of
#                                     one camera, else 0 with a weight of 0
#
# The weights were fitted (``scripts/build confidence``) to twelve rendered heads (person-a to person-l of the
# study) and five drawn ones, as they are, which count four times, and the rendered ones also at .3 of their
# size and with their eyes 44, 31 and 22 pixels apart, blurred and three times as fast, with something passing
# before the face, and dark and noisy, for as they are few frames are wrong: none with one camera that knows
# the skin, 2 % without and with two. One camera was told nothing that was learned from the person tracked
# (but a and b), and went over all of them in two passes, with the skin and without. With it four videos of
# real faces count a quarter as much as all of these, three of them also at every second and fourth frame:
# rendered heads alone make one doubt real ones, of which right frames fit worse. Their reference are the
# points of another detector and the pose that they tell; that errs by 1.4 to 4 degrees, so frames that differ
# by 6 to 9 do not count. Each person left out in turn, the area under the ROC curve of one camera with skin
# is .88 in all (.83 without the fifth sign; calibration error .004) and .96 (.04) of the real ones alone,
# without skin .78 (.02) in all and .86 (.04) as they are. With two cameras they are .81 (.02) in all and .84
# (.01).


MONO = Regression(4.43, np.array([-0.75, -0.59, -0.17, -9.04, 0.0]))
MONO_WITH_SKIN = Regression(7.64, np.array([0.0, -0.12, -0.03, -5.27, -7.24]))
STEREO = Regression(3.70, np.array([-1.22, -1.00, -1.54, -7.07, 0.0]))
_USUAL_PX, _STEADY_DEG, _EXACT = 80.0, 0.2, 0.4
_LONGEST_S = 0.2
"""A gap counts for no longer, as velocities do not last."""


NO_SIGNS: FloatArray = np.full(len(SIGNS), np.nan)
NO_SIGNS.setflags(write=False)
DOUBTFUL_SHARE, LONG_S = 0.1, 1.0
"""More doubtful frames than this, and a head that was gone for longer, are told at a run's end."""


def doubts(record: TrackRecord) -> tuple[str, ...]:
    """Return what to know of a track at its end, in one line with what may help; () of a good one."""
    found = []
    if record.doubtful > DOUBTFUL_SHARE * record.frames:
        found.append(
            f"{record.doubtful} of {record.frames} frames are more probably wrong than right (confidence"
            f" below {PROBABLY:g})"
        )
    if record.gap_ns > LONG_S * 1e9:
        found.append(f"no face for {record.gap_ns * 1e-9:.1f} s after frame {record.gap_frame}")
    if not found:
        return ()
    help_ = "posetrack view shows them; larger, sharper images of the whole face help, and so do --landmarks"
    return (f"{'; '.join(found)}: {help_}",)


def signs_of(before: TrackState | None, fit: FrameFit, stated: FrameFit, camera: Camera) -> FloatArray:
    """Return the signs (5,) of a frame in which a head was followed.

    Args:
        before: the head after the frame before; None without.
        fit: of the frame, by its feature points.
        stated: of the frame, where the skin may tell, too.
        camera: of the recorded image, the reference.
    """
    track = fit.track
    beside = track.shape - track.particles.model.shapes(fit.coefficients)
    seen = (fit.weights > 0.0) & np.isfinite(fit.pixels).all(axis=2).any(axis=0)
    rms = float(np.sqrt(np.mean(np.sum(beside[seen] ** 2, axis=1)))) if seen.any() else EYE_DISTANCE_MM
    return np.array(
        [
            np.log(100.0 * rms / EYE_DISTANCE_MM + _EXACT),
            np.log(_USUAL_PX / eye_distance_px(track.pose, camera)),
            np.log(_off_deg(before, fit) + _STEADY_DEG),
            1.0 - float(fit.weights.mean()),
            0.0 if stated.unmatched is None else stated.unmatched,
        ]
    )


def _off_deg(before: TrackState | None, fit: FrameFit) -> float:
    """By how much the head turned otherwise than in the frame before."""
    velocity = np.zeros(3) if before is None else before.velocity[3:]
    turned = np.linalg.norm(fit.track.velocity[3:] - velocity) * min(fit.dt, _LONGEST_S)
    return float(np.degrees(turned))


# A found head followed from frame to frame: filter, refinement, the points' own places


@dataclass(frozen=True, eq=False)
class SeededFrame:
    """A frame, with the randomness that its step draws from.

    Attributes:
        frame: as it is tracked in.
        rng: source of randomness.
    """

    frame: Frame
    rng: np.random.Generator

    @property
    def index(self) -> int:
        """Its number in the recording."""
        return self.frame.index

    @property
    def stamp_ns(self) -> int:
        """When it was taken."""
        return self.frame.stamp_ns


@dataclass(frozen=True, eq=False)
class TrackState:
    """A head that is being followed, after a frame.

    Attributes:
        stamp_ns: of the frame.
        pose: of the head.
        velocity: tangent vector per second.
        particles: about that pose.
        shape: M', the points' own places in the head's frame, mm.
        templates: of this frame; None if the head was put here and not seen here.
    """

    stamp_ns: Stamp
    pose: HeadPose
    velocity: Annotated[FloatArray, floats(POSE_SIZE)]
    particles: Annotated[HeadParticles, PARTICLES]
    shape: Annotated[FloatArray, floats(POINT_COUNT, 3)]
    templates: TemplateSet | None

    def at_rest(self) -> TrackState:
        """Return the head without its velocity, which does not tell where it is next."""
        return replace(self, velocity=np.zeros_like(self.velocity))


@dataclass(frozen=True, eq=False)
class FrameFit:
    """What one frame says about a head.

    Attributes:
        track: to go on with.
        coefficients: (B,) deformation, mm.
        coefficient_rate: (B,) its change since the frame before, mm/s.
        variance: (6 + B,) of pose (tangent vector) and coefficients.
        dt: s since the frame before.
        correlations: (K,) of each point at its own place, the best camera's; NaN where no camera sees it.
        weights: (K,) visibility of each point times its correlation, 0 to 1.
        score: mean correlation of the points, weighted by their visibility; 0 if none is visible.
        pixels: (C, K, 2) where the points are on the images.
        effective_sample_size: of the particles.
        is_anchored: whether the points were found anew, not compared with what they looked like before.
        unmatched: share of the skin looked for that was not found; None where none was looked for.
        skin_share: how far the pose is the skin's, 0 to 1.
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


LONG_AGO_NS = -(2**62)


class TrackRecord(NamedTuple):
    """How a track went since its head was first found.

    Attributes:
        frames: in which it was tracked, or should have been.
        doubtful: of these those that are more probably wrong than right; all others were tracked, or lost.
        gap_ns: the longest time without a head, up to the last frame.
        gap_frame: with which that began, the last one with a head.
        last_frame: with a head.
    """

    frames: int = 0
    doubtful: int = 0
    gap_ns: int = 0
    gap_frame: int = 0
    last_frame: int = 0

    def tracked(self, frame_index: int, *, doubtful: bool) -> TrackRecord:
        """Return the record after a frame with a head."""
        counted = self._replace(frames=self.frames + 1, doubtful=self.doubtful + int(doubtful))
        return counted._replace(last_frame=frame_index)

    def missed(self, gone_ns: int) -> TrackRecord:
        """Return the record after a frame without a head, so long after the last with one."""
        counted = self._replace(frames=self.frames + 1)
        if gone_ns <= self.gap_ns:
            return counted
        return counted._replace(gap_ns=gone_ns, gap_frame=self.last_frame)


NO_EVIDENCE, NO_RECORD = RunningSigns.before(len(SIGNS)), TrackRecord()
"""Before any frame."""


@dataclass(frozen=True, eq=False)
class HeadState:
    """What a head tracker knows after a frame; what it knows of the face is added by subclasses.

    Attributes:
        track: the head when it was last tracked; None before.
        lost: frames in a row, up to the last one, in which it was not.
        search: what looking for a head came to before one was first found.
        first_ns: stamp of the first frame, the one that points were clicked in.
        evidence: of whether the track is right (``head.tracker.frame_tracker``).
        record: how the track went.
    """

    track: TrackState | None = None
    lost: int = 0
    search: Search = field(default_factory=Search)
    first_ns: Stamp = LONG_AGO_NS
    evidence: Annotated[RunningSigns, signs_codec(len(SIGNS))] = NO_EVIDENCE
    record: TrackRecord = NO_RECORD

    @property
    def is_found(self) -> bool:
        """Whether a head was found in any frame so far."""
        return self.track is not None

    def last_seen_ns(self, frame: SeededFrame) -> int:
        """Return when the head was last tracked; if it was not, as long ago as between two frames."""
        return frame.stamp_ns - round(FRAME_S * 1e9) if self.track is None else self.track.stamp_ns

    @property
    def is_continuous(self) -> bool:
        """Whether the head may still be about where it was last tracked."""
        return True


class FrameTracker:
    """One step of the method of chapters 3 and 4, for a head that was found.

    Args:
        config: of the filter, and of the refinement that follows it.
        cameras: of the recording, one or more.
    """

    def __init__(self, config: HeadStereoConfig | HeadMonoConfig, cameras: Sequence[Camera]) -> None:
        self._settings, self._motion, self._cameras = config.refinement, config.particles, cameras
        self._filter = HeadFilter(config.particles, cameras)
        adjustment = config.adjustment if isinstance(config, HeadMonoConfig) else None
        self._gate = adjustment if adjustment is not None and adjustment.gates_points else None

    def images(self, frame: SeededFrame) -> RigImages:
        """Return a frame's images with the cameras that took them."""
        return RigImages(self._cameras, frame.frame.images)

    def start(
        self,
        frame: SeededFrame,
        pose: HeadPose,
        shape: FloatArray,
        model: ShapeModel,
        seen: TemplateSet | None = None,
    ) -> TrackState:
        """Return a head at rest, its points at ``shape`` (K, 3), mm: ``seen`` there, or put there."""
        particles = self._filter.start(pose, model, frame.rng)
        return TrackState(frame.stamp_ns, pose, np.zeros(POSE_SIZE), particles, shape, seen)

    def step(
        self,
        before: TrackState,
        frame: SeededFrame,
        templates: Sequence[TemplateSet],
        model: ShapeModel,
    ) -> FrameFit:
        """Advance by one frame.

        Args:
            before: the head after the frame before.
            frame: one grey image a camera; None where a camera gave none.
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
        )

    def _recalculates(self, pose: HeadPose, score: float) -> bool:
        """Whether points are looked for off their model; as printed, in clear frames alone (4.4.3)."""
        gate = self._gate
        return gate is None or (off_axis_deg(pose) < gate.facing_deg and score > gate.score)


def _expected(
    images: RigImages, templates: Sequence[TemplateSet], pose: HeadPose, particles: HeadParticles
) -> PatchObservation:
    """What the points should look like at a predicted pose, and how far they are visible."""
    shape = particles.model.shapes(particles.coefficients)
    projection = project(images.cameras, pose.points(shape))
    patches, known = warped(nearest_templates(templates, pose.facing)[-1], tangents(projection, pose))
    return PatchObservation(images.images, template_images(patches), visibility(projection, pose) * known)


def initial_fit(track: TrackState, score: float, pixels: FloatArray) -> FrameFit:
    """Return what the frame says in which a head was first found.

    Args:
        track: the head, at rest.
        score: of the start.
        pixels: (C, K, 2) where its points were found.
    """
    particles = track.particles
    nothing = np.zeros(particles.model.size)  # of a face that is not known to deform yet
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
    """Return each point's best correlation (K,) over cameras, and their mean weighted by visibility.

    Args:
        correlations: (C, K); NaN where a camera has nothing to compare.
        seen: (C, K) visibility, 0 to 1.
    """
    known = np.where(np.isnan(correlations) | (seen <= 0.0), -np.inf, correlations)
    best = known.max(axis=0)
    weights = np.where(np.isfinite(best), seen.max(axis=0), 0.0)
    total = float(weights.sum())
    score = float(weights @ np.where(np.isfinite(best), best, 0.0)) / total if total > 0.0 else 0.0
    return np.where(np.isfinite(best), best, np.nan), score
