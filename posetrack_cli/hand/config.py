"""The hand tracker's configuration; ``configs/hand.toml`` states these defaults with their reasons."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from posetrack_cli.configuration import Settings
from posetrack_cli.hand.model.anatomy import COEFFICIENTS, MOST_COEFFICIENT, MOST_PADDING_MM, HandShape
from posetrack_cli.tracking.options import Deviation, PrintedSetting, deviations

# Wider than any hand, camera or time, and narrow enough that no arithmetic on them overflows.
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Size = Annotated[float, Field(ge=0.1, le=10.0)]
# Beyond what hands differ by; within it the skin has no folds.
Proportion = Annotated[float, Field(ge=0.7, le=1.4)]
PerFinger = tuple[Proportion, Proportion, Proportion, Proportion, Proportion]
Coefficient = Annotated[float, Field(ge=-MOST_COEFFICIENT, le=MOST_COEFFICIENT)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class HandSettings(Settings):
    """Which hand, how large, and of what proportions; with ``mesh``, those of the file's hand.

    A side ``auto`` is determined before a run begins (``hand.autodetect``).
    """

    side: Literal["auto", "right", "left"] = "auto"
    scale: Size = 1.0
    finger_lengths: PerFinger = (1.0, 1.0, 1.0, 1.0, 1.0)
    finger_widths: PerFinger = (1.0, 1.0, 1.0, 1.0, 1.0)
    palm_width: Proportion = 1.0
    palm_length: Proportion = 1.0
    palm_thickness: Proportion = 1.0
    wrist_width: Proportion = 1.0
    thumb_place: Annotated[float, Field(ge=0.5, le=2.5)] = 1.0
    coefficients: Annotated[tuple[Coefficient, ...], Field(max_length=COEFFICIENTS)] = ()
    padding_mm: Annotated[float, Field(ge=0.0, le=MOST_PADDING_MM)] = 0.0
    mesh: str | None = None

    @field_validator("mesh")
    @classmethod
    def _without_coefficients(cls, mesh: str | None, info: ValidationInfo) -> str | None:
        """Modes are of the hand that is shipped; how a file's hand differs, factors tell."""
        if mesh is not None and info.data.get("coefficients"):
            expected = "no hand.coefficients beside it, which no file's hand has"
            raise PydanticCustomError("coefficients", expected)
        return mesh

    @property
    def shape(self) -> HandShape:
        """Size and proportions."""
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
    """The Bayesian filter (method: paper, section 6; hand.md).

    As printed, ``gain`` is P / N without dt, which few noise densities allow (``filtering.model``),
    quaternions add like all other numbers (``hand.model.hand``), and there are no ``joint_limits``. The last
    two hold for poses drawn from the motion; local fits stay on the manifold and within the limits.
    """

    kind: Literal["rbpf", "pf", "pso"] = "rbpf"
    particles: Annotated[int, Field(ge=1, le=1_000_000)] = 256
    proposal: Literal["guided", "marginal", "paper"] = "guided"
    discretisation: Literal["exact", "euler"] = "exact"
    gain: Literal["corrected", "printed"] = "corrected"
    rotations: Literal["manifold", "additive"] = "manifold"
    joint_limits: bool = True
    resampling: Literal["systematic", "multinomial", "residual", "stratified"] = "systematic"
    ess_threshold: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5


class ComponentSettings(Settings):
    """One number for each kind of pose component."""

    position_mm: NotNegative
    rotation_rad: NotNegative
    flexion_rad: NotNegative
    abduction_rad: NotNegative


class MotionSettings(Settings):
    """Noise densities of eq. (44): standard deviations after one second of random walk.

    ``pose`` is the square root of Q^n, ``velocity`` that of Q^l (per second). ``pose_alone`` replaces
    ``pose`` when there is no velocity, which then has to explain all motion. ``gap_max_s`` is the longest
    time without an observation that is predicted, and counts for all longer ones **[ours]**.
    """

    pose: ComponentSettings = ComponentSettings(
        position_mm=40.0, rotation_rad=0.8, flexion_rad=1.5, abduction_rad=0.3
    )
    pose_alone: ComponentSettings = ComponentSettings(
        position_mm=60.0, rotation_rad=0.8, flexion_rad=1.5, abduction_rad=0.4
    )
    velocity: ComponentSettings = ComponentSettings(
        position_mm=600.0, rotation_rad=1.0, flexion_rad=0.1, abduction_rad=0.05
    )
    gap_max_s: Positive = 0.5


class VelocitySettings(Settings):
    """The velocity that a result states (``tracking/velocity.py``) **[ours]**.

    ``next-frame`` estimates it from the tracked poses up to the next frame's, ``filter`` states the
    particles' own velocity, (63).
    """

    method: Literal["next-frame", "filter"] = "next-frame"


class MixtureSettings(Settings):
    """How a pixel's reading comes about (``rendering/pixel_model.py``); only the cost "mixture" asks.

    The noise's standard deviation is near_sd_mm + sd_mm_per_m2 z^2, z in metres: a reading's and the hand
    model's together. Errors are alike over patches of ``correlation_mm`` squared, which count as one
    reading each **[ours]**.
    """

    near_sd_mm: Positive = 3.0
    sd_mm_per_m2: NotNegative = 1.42
    occluded_share: Annotated[float, Field(ge=0.0, le=0.5)] = 0.1
    outlier_share: Annotated[float, Field(ge=1e-6, le=0.4)] = 0.01
    outline_sd_mm: Positive = 5.0
    correlation_mm: Positive = 7.0


class ObservationSettings(Settings):
    """How an image scores a pose (paper, section 4; hand.md, observation model)."""

    cost: Literal["mixture", "union", "paper"] = "mixture"
    likelihood: Literal["gaussian", "exponential"] = "gaussian"
    sigma_mm: Positive = 1.0
    clamp_mm: Positive = 40.0
    window_px: Annotated[int, Field(ge=8, le=4096)] | None = None
    window_mm: Positive = 240.0
    tile_px: Annotated[int, Field(ge=8, le=1024)] = 64
    unread_weight: Fraction = 0.2
    mixture: MixtureSettings = MixtureSettings()

    @property
    def models_pixels(self) -> bool:
        """Whether the likelihood has a model of how each pixel's reading comes about."""
        return self.cost == "mixture"


class DetectionSettings(Settings):
    """At which distances from the camera a hand is searched for that no prediction tells of."""

    nearest_mm: Positive = 120.0
    farthest_mm: Positive = 1500.0


class InitSettings(Settings):
    """Where a run starts, and the prior of its first frame.

    ``auto`` finds the hand in the image; ``center`` is the paper's start (7.3): palm to the sensor, in the
    middle of the image, ``depth_mm`` away or where the nearest surface is. With ``shape`` ``auto`` the hand's
    size and shape are estimated from the recording before a run begins, unless ``[hand]`` tells them.
    """

    method: Literal["auto", "center"] = "auto"
    shape: Literal["auto", "given"] = "auto"
    depth_mm: Positive | None = None
    velocity: ComponentSettings = ComponentSettings(
        position_mm=200.0, rotation_rad=1.5, flexion_rad=2.0, abduction_rad=0.3
    )


class PsoSettings(Settings):
    """The optimiser of Oikonomidis et al. 2011 (``hand/swarm.py``); only the filter "pso" asks.

    ``cognitive`` and ``social`` are c_1 and c_2 of the swarm, ``clamp_mm`` and ``match_mm`` are d_M and d_m
    of the objective, ``overlap_mm`` lambda and ``crossing_mm_per_rad`` lambda_k.
    """

    particles: Annotated[int, Field(ge=1, le=1_000_000)] = 64
    generations: Annotated[int, Field(ge=1, le=100_000)] = 25
    cognitive: NotNegative = 2.8
    social: NotNegative = 1.3
    redraw_every: Annotated[int, Field(ge=0)] = 3
    redraw_share: Fraction = 0.5
    clamp_mm: Positive = 40.0
    match_mm: Positive = 10.0
    overlap_mm: NotNegative = 20.0
    crossing_mm_per_rad: NotNegative = 10.0
    reach_mm: Positive = 250.0
    spread: ComponentSettings = ComponentSettings(
        position_mm=10.0, rotation_rad=0.2, flexion_rad=0.2, abduction_rad=0.06
    )


class FitSettings(Settings):
    """Local fits of the pose to the frame, from which the guided proposal is made."""

    starts: Annotated[int, Field(ge=1, le=64)] = 7
    iterations: Annotated[int, Field(ge=1, le=100)] = 6
    polish: Annotated[int, Field(ge=0, le=100)] = 2


class AcquisitionSettings(Settings):
    """How a hand is found without a prediction: of all hypotheses the best are fitted.

    That is to some of the pixels, but for the last ``finished`` fits.
    """

    fitted: Annotated[int, Field(ge=1, le=1000)] = 32
    refined: Annotated[int, Field(ge=0, le=64)] = 4
    scattered: Annotated[int, Field(ge=1, le=64)] = 8
    finished: Annotated[int, Field(ge=1, le=64)] = 6


class StatusSettings(Settings):
    """When a track is doubted, and when it counts as lost.

    A hand whose cost D is far above that of well-tracked frames (``hand/policy.py``), or above ``sure_mm``,
    is reconsidered. A share 1 - D / c_max that stays below ``lost_below`` for ``lost_after_frames`` is a
    loss; the hand is then searched for in the whole image. A fit that costs more than good ones of the
    recording, and more than ``well_mm``, is looked for anew where it is. Confidence falls by what a fit costs
    over ``good_mm``, too, what good ones of the whole recording cost: 0 for unknown, which a shape that is
    estimated from the recording replaces.
    """

    sure_mm: NotNegative = 6.0
    well_mm: NotNegative = 2.2
    good_mm: NotNegative = 0.0
    lost_below: Fraction = 0.5
    lost_after_frames: Annotated[int, Field(ge=1)] = 5


class OutputSettings(Settings):
    """What goes into the result."""

    mesh: Literal["lean", "medium", "none"] = "lean"
    flush_frames: Annotated[int, Field(ge=1)] = 10


class HandConfig(Settings):
    """Everything that a hand run depends on besides its recording and its seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("hand.mesh",)

    hand: HandSettings = HandSettings()
    filter: FilterSettings = FilterSettings()
    motion: MotionSettings = MotionSettings()
    velocity: VelocitySettings = VelocitySettings()
    observation: ObservationSettings = ObservationSettings()
    detection: DetectionSettings = DetectionSettings()
    init: InitSettings = InitSettings()
    fit: FitSettings = FitSettings()
    acquisition: AcquisitionSettings = AcquisitionSettings()
    pso: PsoSettings = PsoSettings()
    status: StatusSettings = StatusSettings()
    output: OutputSettings = OutputSettings()


# Where a run differs from the hand paper (Kajihara and Tanaka)


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
    """Return where a configuration that follows the paper differs from it; None of any other.

    It follows the paper where cost (4) and proposal (51) are the paper's.
    """
    if config.observation.cost != "paper" or config.filter.proposal != "paper":
        return None
    return deviations(config, SETTINGS, ALWAYS)
