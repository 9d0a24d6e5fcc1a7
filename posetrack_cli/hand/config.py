"""Configuration of the hand tracker; ``configs/hand.toml`` is generated from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from posetrack_cli.configuration import Settings, setting
from posetrack_cli.hand.model.anatomy import COEFFICIENTS, MOST_COEFFICIENT, MOST_PADDING_MM, HandShape
from posetrack_cli.tracking.options import Deviation, PrintedSetting, deviations

# Bounds wider than any real hand, camera or time, but narrow enough that no arithmetic overflows.
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Size = Annotated[float, Field(ge=0.1, le=10.0)]
# Beyond the variation between people; within it the skin does not fold.
Proportion = Annotated[float, Field(ge=0.7, le=1.4)]
PerFinger = tuple[Proportion, Proportion, Proportion, Proportion, Proportion]
Coefficient = Annotated[float, Field(ge=-MOST_COEFFICIENT, le=MOST_COEFFICIENT)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


SIDES = ("right", "left")
"""Sides of hands, in this order where both are tracked."""
BOTH, ONE_OF_TWO = "2", "1 of 2"
"""Values of ``hand.count`` with two hands in view."""


class HandSettings(Settings):
    """Side, size and proportions of the hand; with ``mesh``, of the hand in that file.

    Side and count ``auto`` are determined before the run (``hand.autodetect``). ``1 of 2`` tracks one of two
    visible hands and reports nothing of the other.
    """

    side: Literal["auto", "right", "left"] = setting(
        "auto", '"right" or "left", or "auto": detected in the first seconds'
    )
    count: Literal["auto", "1", "2", "1 of 2"] = setting(
        "auto", 'hands to track: "1" or "2", or "auto": as many as the recording shows'
    )
    scale: Size = setting(1.0, "1 is the average adult hand, 179 mm from wrist to middle fingertip")
    finger_lengths: PerFinger = setting(
        (1.0, 1.0, 1.0, 1.0, 1.0), "factors per finger, thumb first, 0.7 to 1.4"
    )
    finger_widths: PerFinger = setting((1.0, 1.0, 1.0, 1.0, 1.0), "factors on the finger radii")
    palm_width: Proportion = setting(
        1.0, "`posetrack hand calibrate` estimates these factors from a recording"
    )
    palm_length: Proportion = 1.0
    palm_thickness: Proportion = 1.0
    wrist_width: Proportion = 1.0
    thumb_place: Annotated[float, Field(ge=0.5, le=2.5)] = setting(
        1.0, "factor on the distance of the thumb's base from the wrist, 0.5 to 2.5"
    )
    coefficients: Annotated[tuple[Coefficient, ...], Field(max_length=COEFFICIENTS)] = setting(
        (), "up to 24 coefficients of the population's shape modes, in standard deviations, strongest first"
    )
    padding_mm: Annotated[float, Field(ge=0.0, le=MOST_PADDING_MM)] = setting(
        0.0, "extra skin thickness, for sensors that smear edges or for gloves, up to 12"
    )
    mesh: str | None = setting(
        None,
        "skinned glTF hand instead of the average one; the factors apply to it",
        example="my-hand.glb",
    )

    @field_validator("mesh")
    @classmethod
    def _without_coefficients(cls, mesh: str | None, info: ValidationInfo) -> str | None:
        """Refuse modes for a hand from a file: they belong to the built-in hand, others have factors only."""
        if mesh is not None and info.data.get("coefficients"):
            expected = "no hand.coefficients together with hand.mesh"
            raise PydanticCustomError("coefficients", expected)
        return mesh

    @property
    def shape(self) -> HandShape:
        """Return size and proportions."""
        palm = (self.palm_width, self.palm_length, self.palm_thickness)
        return HandShape(
            self.scale,
            self.finger_lengths,
            self.finger_widths,
            *palm,
            self.wrist_width,
            self.thumb_place,
            self.coefficients,
            self.padding_mm,
        )


class FilterSettings(Settings):
    """Bayesian filter (paper, section 6; docs/method.md).

    As printed, ``gain`` is P / N without dt, which few noise densities allow (``filtering.model``),
    quaternions are added componentwise (``hand.model.hand``), and there are no ``joint_limits``. The last two
    apply to particles drawn from the motion model; local fits always stay on the manifold and within the
    limits.
    """

    kind: Literal["rbpf", "pf", "pso"] = setting(
        "rbpf",
        'Rao-Blackwellized filter with velocity, or "pf": particle filter, or "pso": swarm',
    )
    particles: Annotated[int, Field(ge=1, le=1_000_000)] = setting(
        256, "enough for the guided proposal; other proposals need about 512"
    )
    proposal: Literal["guided", "marginal", "paper"] = setting(
        "guided",
        'local fits to the frame combined with the prior, weighted by (24); or "marginal": variance N of '
        '(55), or "paper": dt Q^n as printed in (51)',
    )
    discretisation: Literal["exact", "euler"] = setting(
        "exact", 'velocity also diffuses within a step, or "euler": the paper\'s (44)'
    )
    gain: Literal["corrected", "printed"] = setting(
        "corrected", 'L = dt P / N, or "printed": P / N of (56), which few noise densities allow'
    )
    rotations: Literal["manifold", "additive"] = setting(
        "manifold", 'rotation vectors on the manifold, or "additive": quaternions are added as in (44), (62)'
    )
    joint_limits: bool = setting(True, "clamp particles drawn from the motion model; not in the paper")
    resampling: Literal["systematic", "multinomial", "residual", "stratified"] = setting(
        "systematic", "resampling scheme; or multinomial, residual, stratified"
    )
    ess_threshold: Annotated[float, Field(ge=0.0, le=1.0)] = setting(
        0.5, "resample below this share of effective particles; 1 resamples every frame"
    )


class ComponentSettings(Settings):
    """One number for each kind of pose component."""

    position_mm: NotNegative
    rotation_rad: NotNegative
    flexion_rad: NotNegative
    abduction_rad: NotNegative


class MotionSettings(Settings):
    """Noise densities of eq. (44): standard deviations after one second of random walk.

    ``pose`` is the square root of Q^n, ``velocity`` that of Q^l (per second). Without a velocity,
    ``pose_alone`` replaces ``pose`` and has to explain all motion. ``gap_max_s`` is the longest time step
    without an observation; longer gaps count as this long **[ours]**.
    """

    pose: ComponentSettings = setting(
        ComponentSettings(position_mm=40.0, rotation_rad=0.8, flexion_rad=1.5, abduction_rad=0.3),
        "square root of Q^n: random walk of the pose in addition to its velocity",
    )
    pose_alone: ComponentSettings = setting(
        ComponentSettings(position_mm=60.0, rotation_rad=0.8, flexion_rad=1.5, abduction_rad=0.4),
        "the same for the plain particle filter, which has no velocity",
    )
    velocity: ComponentSettings = setting(
        ComponentSettings(position_mm=600.0, rotation_rad=1.0, flexion_rad=0.1, abduction_rad=0.05),
        "square root of Q^l: random walk of the velocity, per second",
    )
    gap_max_s: Positive = setting(0.5, "longest time over which the hand is predicted without an observation")


class VelocitySettings(Settings):
    """Velocity in the result (``tracking/velocity.py``) **[ours]**.

    ``next-frame`` estimates it from the tracked poses up to the next frame; ``filter`` is the velocity of the
    particles, (63).
    """

    method: Literal["next-frame", "filter"] = setting(
        "next-frame", 'from the tracked poses up to the next frame, or "filter": of the particles, (63)'
    )


class MixtureSettings(Settings):
    """Measurement model of a pixel (``rendering/pixel_model.py``), for cost "mixture" only.

    The noise of reading and hand model together has standard deviation near_sd_mm + sd_mm_per_m2 z^2, z in
    metres. Errors are correlated over patches of ``correlation_mm`` squared, each of which counts as one
    reading **[ours]**.
    """

    near_sd_mm: Positive = setting(
        3.0, "noise of readings and skin model: near_sd_mm + sd_mm_per_m2 z^2, z in metres"
    )
    sd_mm_per_m2: NotNegative = 1.42
    occluded_share: Annotated[float, Field(ge=0.0, le=0.5)] = setting(
        0.1, "share of readings on unknown occluders in front of the hand"
    )
    outlier_share: Annotated[float, Field(ge=1e-6, le=0.4)] = setting(0.01, "share of unexplained readings")
    outline_sd_mm: Positive = setting(5.0, "offset between observed and rendered outline")
    correlation_mm: Positive = setting(7.0, "side of the patch that counts as one independent reading")


class ObservationSettings(Settings):
    """Likelihood of a pose given the depth image (paper, section 4; docs/method.md)."""

    cost: Literal["mixture", "union", "paper"] = setting(
        "mixture",
        'mixture model per pixel over the union of rendered and observed pixels; or "union": D over that '
        'union, or "paper": eq. (4), rendered pixels only',
    )
    likelihood: Literal["gaussian", "exponential"] = setting(
        "gaussian", 'for "union" and "paper": exp(-D^2 / (2 sigma^2)) (47), or "exponential": (3)'
    )
    sigma_mm: Positive = setting(1.0, "for the guided proposal; about 4 without it")
    clamp_mm: Positive = setting(40.0, "c_max: largest depth error of a pixel")
    window_mm: Positive = setting(240.0, "side of the window at the hand's depth ...")
    window_px: Annotated[int, Field(ge=8, le=4096)] | None = setting(
        None, "... or a fixed side in pixels", example=128
    )
    tile_px: Annotated[int, Field(ge=8, le=1024)] = setting(64, "side of the tile sampled from the window")
    unread_weight: Fraction = setting(0.2, "weight of a rendered pixel without a sensor reading")
    mixture: MixtureSettings = setting(MixtureSettings(), 'pixel model for cost = "mixture"')

    @property
    def models_pixels(self) -> bool:
        """Return whether the likelihood models each pixel's reading."""
        return self.cost == "mixture"


class DetectionSettings(Settings):
    """Distances from the camera at which hands are detected."""

    nearest_mm: Positive = setting(120.0, "distance from the camera")
    farthest_mm: Positive = 1500.0


class InitSettings(Settings):
    """Start of a run and prior of its first frame.

    ``auto`` detects the hand in the image; ``center`` is the paper's start (7.3): palm facing the sensor, in
    the middle of the image, at ``depth_mm`` or at the nearest surface. With ``shape`` ``auto``, size and
    shape are estimated from the recording before the run, unless ``[hand]`` sets them.
    """

    method: Literal["auto", "center"] = setting(
        "auto",
        'detect the hand, or "center": open hand in the middle of the image, palm facing the '
        "sensor, at depth_mm or at the nearest surface",
    )
    shape: Literal["auto", "given"] = setting(
        "auto",
        "estimate size and shape from the recording where [hand] keeps its defaults, or "
        '"given": use [hand] unchanged',
    )
    depth_mm: Positive | None = setting(
        None, 'for "center"; by default the depth of the nearest surface', example=600.0
    )
    velocity: ComponentSettings = setting(
        ComponentSettings(position_mm=200.0, rotation_rad=1.5, flexion_rad=2.0, abduction_rad=0.3),
        "standard deviation of the first velocity, per second",
    )


class PsoSettings(Settings):
    """Particle swarm optimiser of Oikonomidis et al. 2011 (``hand/swarm.py``), for filter "pso" only.

    ``cognitive`` and ``social`` are c_1 and c_2 of the swarm; ``clamp_mm`` and ``match_mm`` are d_M and d_m
    of the objective, ``overlap_mm`` is lambda and ``crossing_mm_per_rad`` lambda_k.
    """

    particles: Annotated[int, Field(ge=1, le=1_000_000)] = setting(
        64, "the published budget is 64 x 25 rendered hands per frame"
    )
    generations: Annotated[int, Field(ge=1, le=100_000)] = setting(25, "generations, including the start")
    cognitive: NotNegative = setting(2.8, "c_1: attraction to a particle's own best position")
    social: NotNegative = setting(
        1.3, "c_2: attraction to the global best; psi = c_1 + c_2 = 4.1, constriction .7298"
    )
    redraw_every: Annotated[int, Field(ge=0)] = setting(
        3, "generations after which one finger angle is redrawn over its range ..."
    )
    redraw_share: Fraction = setting(0.5, "... in this share of the particles")
    clamp_mm: Positive = setting(40.0, "d_M: largest depth error of a pixel")
    match_mm: Positive = setting(10.0, "d_m: depths that differ by less match")
    overlap_mm: NotNegative = setting(20.0, "lambda, for depth in mm")
    crossing_mm_per_rad: NotNegative = setting(10.0, "lambda_k, for depth in mm")
    reach_mm: Positive = setting(250.0, "largest distance from the last solution")
    spread: ComponentSettings = setting(
        ComponentSettings(position_mm=10.0, rotation_rad=0.2, flexion_rad=0.2, abduction_rad=0.06),
        "standard deviation of the start around the last solution; not published, tuned on synthetic hands",
    )


class FitSettings(Settings):
    """Local fits of the pose to the frame, which form the guided proposal."""

    starts: Annotated[int, Field(ge=1, le=64)] = setting(
        7, "start poses: the prediction, the last pose, and random ones around them"
    )
    iterations: Annotated[int, Field(ge=1, le=100)] = setting(6, "Gauss-Newton iterations per start")
    polish: Annotated[int, Field(ge=0, le=100)] = setting(
        2, "further iterations from the combination of each finger's best fit"
    )


class AcquisitionSettings(Settings):
    """Search for a hand without a prediction: the best of many hypotheses are fitted.

    All fits but the ``finished`` ones use every fourth pixel.
    """

    fitted: Annotated[int, Field(ge=1, le=1000)] = setting(
        32, "hypotheses that are fitted: the best and most different"
    )
    refined: Annotated[int, Field(ge=0, le=64)] = setting(4, "fits that are refined with other finger poses")
    scattered: Annotated[int, Field(ge=1, le=64)] = setting(8, "random starts around each of these")
    finished: Annotated[int, Field(ge=1, le=64)] = setting(
        6, "fits to all pixels at the end; earlier ones use every fourth"
    )


class StatusSettings(Settings):
    """Limits of doubt and loss of a track (``hand/policy.py``).

    A fit whose cost D is far above the track's mean, or above ``doubt_above_mm``, triggers a search, unless D
    is little above a known ``baseline_cost_mm``. A fit that costs more than good fits of the recording, and
    more than ``retry_above_mm``, is retried in place. A hand is lost when 1 - D / c_max stays below
    ``lost_below`` for ``lost_after_frames`` frames; the whole image is then searched. Confidence falls with
    the ratio of a fit's cost to ``baseline_cost_mm``, the cost of good fits in the whole recording; 0 means
    unknown, and a shape estimated from the recording sets it. Confidence is multiplied by
    ``hand_probability``, which is below 1 after an uncertain detection. Its log odds are reduced by
    ``shape_doubt`` where the shape comes from very few frames.
    """

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "sure_mm": "doubt_above_mm",
        "well_mm": "retry_above_mm",
        "good_mm": "baseline_cost_mm",
    }

    doubt_above_mm: NotNegative = setting(
        6.0, "a fit above this cost, and that of good fits, triggers a search"
    )
    retry_above_mm: NotNegative = setting(2.2, "a fit up to this cost is never retried")
    baseline_cost_mm: NotNegative = setting(
        0.0, "cost of good fits in this recording, for confidence and doubt; 0: from the estimated shape"
    )
    hand_probability: Fraction = setting(
        1.0, "probability of the hand's side and size, for confidence; set by their detection"
    )
    shape_doubt: NotNegative = setting(
        0.0, "reduction of the log odds of confidence; set where the shape comes from very few frames"
    )
    lost_below: Fraction = setting(0.5, "1 - D / c_max below which a frame counts as a miss")
    lost_after_frames: Annotated[int, Field(ge=1)] = setting(
        5, "misses in a row until the hand is lost and the whole image is searched"
    )


class OutputSettings(Settings):
    """Contents of the result."""

    mesh: Literal["lean", "medium", "none"] = setting("lean", "mesh in /hand/scene: lean, medium or none")
    flush_frames: Annotated[int, Field(ge=1)] = setting(10, "frames between writes of result and checkpoint")


class HandConfig(Settings):
    """All parameters of a hand run apart from recording and seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("hand.mesh",)

    hand: HandSettings = HandSettings()
    filter: FilterSettings = FilterSettings()
    motion: MotionSettings = MotionSettings()
    velocity: VelocitySettings = setting(VelocitySettings(), "velocity in the result")
    observation: ObservationSettings = ObservationSettings()
    detection: DetectionSettings = setting(
        DetectionSettings(), "where hands are detected without a prediction"
    )
    init: InitSettings = InitSettings()
    fit: FitSettings = setting(FitSettings(), "local fits to a frame, for the guided proposal")
    acquisition: AcquisitionSettings = setting(
        AcquisitionSettings(), "search for a hand without a prediction"
    )
    pso: PsoSettings = setting(
        PsoSettings(), 'swarm of Oikonomidis, Kyriazis and Argyros, BMVC 2011, for kind = "pso"'
    )
    status: StatusSettings = StatusSettings()
    output: OutputSettings = OutputSettings()


# Deviations from the hand paper (Kajihara and Tanaka)

SETTINGS = (
    PrintedSetting("7.2.1", "filter.particles", 512),
    PrintedSetting("(51)", "filter.proposal", "paper"),
    PrintedSetting("(44)", "filter.discretisation", "euler"),
    PrintedSetting("(56)", "filter.gain", "printed"),
    PrintedSetting("(44), (62)", "filter.rotations", "additive"),
    PrintedSetting("A.1", "filter.joint_limits", False),
    PrintedSetting("6 (7)", "filter.resampling", "multinomial"),
    PrintedSetting("6 (7)", "filter.ess_threshold", 1.0),
    PrintedSetting("(4)", "observation.cost", "paper"),
    PrintedSetting("(47)", "observation.likelihood", "gaussian"),
    PrintedSetting("(64)", "observation.sigma_mm", 20.0),
    PrintedSetting("(65)", "observation.clamp_mm", 100.0),
    PrintedSetting("7.1", "observation.window_px", 128),
    PrintedSetting("7.1", "observation.tile_px", 128),
    PrintedSetting("7.3", "init.method", "center"),
    PrintedSetting("(63)", "velocity.method", "filter"),
)
ALWAYS = (
    Deviation("A.1", "the thumb turns about z at joint 3 (CMC), not at joint 2"),
    Deviation("(44)", "quaternions are scaled to length 1, and noise along them is left out"),
    Deviation("4.2", "R lies about the predicted hand, not about the last estimate"),
    Deviation("5.3", "a frame without readings moves particles by the motion alone"),
    Deviation("(45)", "a step counts as motion.gap_max_s at most"),
    Deviation("7.3", "a frame may be lost (status)"),
    Deviation("(45), (46)", "noise densities are ours; none are printed"),
)


def deviations_from_print(config: HandConfig) -> list[str] | None:
    """Return where a configuration that follows the paper deviates from it; None for any other.

    A configuration follows the paper if its cost is (4) and its proposal (51).
    """
    if config.observation.cost != "paper" or config.filter.proposal != "paper":
        return None
    return deviations(config, SETTINGS, ALWAYS)
