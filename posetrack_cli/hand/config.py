"""The hand tracker's configuration, of which ``configs/hand.toml`` is written."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from posetrack_cli.configuration import Settings, setting
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

    side: Literal["auto", "right", "left"] = setting(
        "auto", 'found out from the first seconds; or "right" or "left"'
    )
    scale: Size = setting(1.0, "1 is the average adult hand, 179 mm from wrist to middle fingertip")
    finger_lengths: PerFinger = setting((1.0, 1.0, 1.0, 1.0, 1.0), "further factors, thumb first, 0.7 to 1.4")
    finger_widths: PerFinger = setting((1.0, 1.0, 1.0, 1.0, 1.0), "on the fingers' radii")
    palm_width: Proportion = setting(1.0, "`posetrack hand calibrate` finds these numbers from a recording")
    palm_length: Proportion = 1.0
    palm_thickness: Proportion = 1.0
    wrist_width: Proportion = 1.0
    thumb_place: Annotated[float, Field(ge=0.5, le=2.5)] = setting(
        1.0, "how far along the palm the thumb begins, 0.5 to 2.5"
    )
    coefficients: Annotated[tuple[Coefficient, ...], Field(max_length=COEFFICIENTS)] = setting(
        (), "of the modes of people's hands, in standard deviations, strongest first, up to 24"
    )
    padding_mm: Annotated[float, Field(ge=0.0, le=MOST_PADDING_MM)] = setting(
        0.0, "by how much the skin stands out, where a sensor smears edges or in a glove, up to 12"
    )
    mesh: str | None = setting(
        None, "a skinned glTF hand instead of the average one; the factors apply to it", example="my-hand.glb"
    )

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

    kind: Literal["rbpf", "pf", "pso"] = setting(
        "rbpf", 'Rao-Blackwellized with velocity, or "pf": the plain particle filter'
    )
    particles: Annotated[int, Field(ge=1, le=1_000_000)] = setting(
        256, "a guided proposal needs few; the others some 512"
    )
    proposal: Literal["guided", "marginal", "paper"] = setting(
        "guided",
        'local fits to the frame and the prior, weighed by (24); or "marginal": variance N of '
        '(55), or "paper": dt Q^n as (51) prints it',
    )
    discretisation: Literal["exact", "euler"] = setting(
        "exact", 'velocity wanders within a step too, or "euler": the paper\'s (44)'
    )
    gain: Literal["corrected", "printed"] = setting(
        "corrected", 'L = dt P / N, or "printed": P / N of (56), which few noise densities allow'
    )
    rotations: Literal["manifold", "additive"] = setting(
        "manifold", 'they turn by rotation vectors, or "additive": quaternions add as in (44), (62)'
    )
    joint_limits: bool = setting(True, "particles drawn from the motion stay within them; the paper has none")
    resampling: Literal["systematic", "multinomial", "residual", "stratified"] = setting(
        "systematic", "or multinomial, residual, stratified"
    )
    ess_threshold: Annotated[float, Field(ge=0.0, le=1.0)] = setting(
        0.5, "resample below this share of effective particles; 1 is always"
    )


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

    pose: ComponentSettings = setting(
        ComponentSettings(position_mm=40.0, rotation_rad=0.8, flexion_rad=1.5, abduction_rad=0.3),
        "square root of Q^n: random walk of the pose beside its velocity",
    )
    pose_alone: ComponentSettings = setting(
        ComponentSettings(position_mm=60.0, rotation_rad=0.8, flexion_rad=1.5, abduction_rad=0.4),
        "the same for the plain particle filter, where it explains all motion",
    )
    velocity: ComponentSettings = setting(
        ComponentSettings(position_mm=600.0, rotation_rad=1.0, flexion_rad=0.1, abduction_rad=0.05),
        "square root of Q^l: random walk of the velocity, per second",
    )
    gap_max_s: Positive = setting(0.5, "the hand is predicted over no longer a time without an observation")


class VelocitySettings(Settings):
    """The velocity that a result states (``tracking/velocity.py``) **[ours]**.

    ``next-frame`` estimates it from the tracked poses up to the next frame's, ``filter`` states the
    particles' own velocity, (63).
    """

    method: Literal["next-frame", "filter"] = setting(
        "next-frame", "from the tracked poses up to the next frame's; or \"filter\": the particles', (63)"
    )


class MixtureSettings(Settings):
    """How a pixel's reading comes about (``rendering/pixel_model.py``); only the cost "mixture" asks.

    The noise's standard deviation is near_sd_mm + sd_mm_per_m2 z^2, z in metres: a reading's and the hand
    model's together. Errors are alike over patches of ``correlation_mm`` squared, which count as one
    reading each **[ours]**.
    """

    near_sd_mm: Positive = setting(
        3.0, "noise of readings and skin: near_sd_mm + sd_mm_per_m2 z^2, z in metres"
    )
    sd_mm_per_m2: NotNegative = 1.42
    occluded_share: Annotated[float, Field(ge=0.0, le=0.5)] = setting(
        0.1, "of readings that are of unknown things in front of the hand"
    )
    outlier_share: Annotated[float, Field(ge=1e-6, le=0.4)] = setting(
        0.01, "of readings that nothing explains"
    )
    outline_sd_mm: Positive = setting(5.0, "of where the hand's outline is seen against where it is drawn")
    correlation_mm: Positive = setting(7.0, "errors are alike over such a patch, which counts as one reading")


class ObservationSettings(Settings):
    """How an image scores a pose (paper, section 4; hand.md, observation model)."""

    cost: Literal["mixture", "union", "paper"] = setting(
        "mixture",
        'union of regions, a mixture per pixel; or "union": D over the union of regions, or '
        '"paper": eq. (4), rendered pixels only',
    )
    likelihood: Literal["gaussian", "exponential"] = setting(
        "gaussian", 'of union and paper: exp(-D^2 / (2 sigma^2)) (47), or "exponential" (3)'
    )
    sigma_mm: Positive = setting(1.0, "for the guided proposal; about 4 for particles drawn from the motion")
    clamp_mm: Positive = setting(40.0, "c_max: no pixel counts more")
    window_mm: Positive = setting(240.0, "the window's side at the hand's depth ...")
    window_px: Annotated[int, Field(ge=8, le=4096)] | None = setting(
        None, "... or fixed in pixels", example=128
    )
    tile_px: Annotated[int, Field(ge=8, le=1024)] = setting(64, "it is sampled by so many pixels across")
    unread_weight: Fraction = setting(0.2, "what a rendered pixel counts where the sensor has no reading")
    mixture: MixtureSettings = setting(MixtureSettings(), 'the pixel\'s model of cost = "mixture"')

    @property
    def models_pixels(self) -> bool:
        """Whether the likelihood has a model of how each pixel's reading comes about."""
        return self.cost == "mixture"


class DetectionSettings(Settings):
    """At which distances from the camera a hand is searched for that no prediction tells of."""

    nearest_mm: Positive = setting(120.0, "from the camera")
    farthest_mm: Positive = 1500.0


class InitSettings(Settings):
    """Where a run starts, and the prior of its first frame.

    ``auto`` finds the hand in the image; ``center`` is the paper's start (7.3): palm to the sensor, in the
    middle of the image, ``depth_mm`` away or where the nearest surface is. With ``shape`` ``auto`` the hand's
    size and shape are estimated from the recording before a run begins, unless ``[hand]`` tells them.
    """

    method: Literal["auto", "center"] = setting(
        "auto",
        'find the hand; or "center": an open hand in the middle of the image, palm to the '
        "sensor, at depth_mm or where the nearest surface is",
    )
    shape: Literal["auto", "given"] = setting(
        "auto",
        "estimate the hand's size and shape from the recording where [hand] leaves them as "
        'they are; or "given": as [hand] says',
    )
    depth_mm: Positive | None = setting(
        None, 'of "center"; by default where the nearest surface is', example=600.0
    )
    velocity: ComponentSettings = setting(
        ComponentSettings(position_mm=200.0, rotation_rad=1.5, flexion_rad=2.0, abduction_rad=0.3),
        "and of the first velocity, per second",
    )


class PsoSettings(Settings):
    """The optimiser of Oikonomidis et al. 2011 (``hand/swarm.py``); only the filter "pso" asks.

    ``cognitive`` and ``social`` are c_1 and c_2 of the swarm, ``clamp_mm`` and ``match_mm`` are d_M and d_m
    of the objective, ``overlap_mm`` lambda and ``crossing_mm_per_rad`` lambda_k.
    """

    particles: Annotated[int, Field(ge=1, le=1_000_000)] = setting(
        64, "64 x 25 hands drawn a frame are the published budget"
    )
    generations: Annotated[int, Field(ge=1, le=100_000)] = setting(25, "of the swarm; its start is the first")
    cognitive: NotNegative = setting(2.8, "c_1: towards a particle's own best")
    social: NotNegative = setting(1.3, "c_2: towards the best of all; together psi = 4.1, constriction .7298")
    redraw_every: Annotated[int, Field(ge=0)] = setting(
        3, "generations; then one finger angle is redrawn over its range ..."
    )
    redraw_share: Fraction = setting(0.5, "... in half of the particles")
    clamp_mm: Positive = setting(40.0, "d_M: no pixel's depth counts more")
    match_mm: Positive = setting(10.0, "d_m: depths that differ by less agree")
    overlap_mm: NotNegative = setting(20.0, "lambda, with depth in mm; in cm (200) it tracks no better")
    crossing_mm_per_rad: NotNegative = setting(10.0, "lambda_k, likewise")
    reach_mm: Positive = setting(250.0, "the search goes no farther from the last solution")
    spread: ComponentSettings = setting(
        ComponentSettings(position_mm=10.0, rotation_rad=0.2, flexion_rad=0.2, abduction_rad=0.06),
        "perturbations of the last solution that the swarm starts from (sd); not published "
        'but "experimentally determined": tuned on synthetic hands',
    )


class FitSettings(Settings):
    """Local fits of the pose to the frame, from which the guided proposal is made."""

    starts: Annotated[int, Field(ge=1, le=64)] = setting(
        7, "the prediction, the last pose, and scattered ones"
    )
    iterations: Annotated[int, Field(ge=1, le=100)] = setting(6, "of Gauss-Newton from each")
    polish: Annotated[int, Field(ge=0, le=100)] = setting(2, "from the best fit with fingers of the others")


class AcquisitionSettings(Settings):
    """How a hand is found without a prediction: of all hypotheses the best are fitted.

    That is to some of the pixels, but for the last ``finished`` fits.
    """

    fitted: Annotated[int, Field(ge=1, le=1000)] = setting(
        32, "... the best and most different are fitted, their fingers exchanged ..."
    )
    refined: Annotated[int, Field(ge=0, le=64)] = setting(
        4, "... and the best of all tried with other fingers"
    )
    scattered: Annotated[int, Field(ge=1, le=64)] = 8
    finished: Annotated[int, Field(ge=1, le=64)] = setting(
        6, "so many of which are fitted to all pixels, not to every fourth alone"
    )


class StatusSettings(Settings):
    """When a track is doubted, and when it counts as lost.

    A hand whose cost D is far above that of well-tracked frames (``hand/policy.py``), or above ``sure_mm``,
    is reconsidered. A share 1 - D / c_max that stays below ``lost_below`` for ``lost_after_frames`` is a
    loss; the hand is then searched for in the whole image. A fit that costs more than good ones of the
    recording, and more than ``well_mm``, is looked for anew where it is. Confidence falls by what a fit costs
    over ``good_mm``, too, what good ones of the whole recording cost: 0 for unknown, which a shape that is
    estimated from the recording replaces.
    """

    sure_mm: NotNegative = setting(
        6.0, "a hand whose cost is above this is reconsidered, however well it is tracked"
    )
    well_mm: NotNegative = setting(2.2, "a fit that costs no more is never looked for anew where it is")
    good_mm: NotNegative = setting(
        0.0, "what good fits of the recording cost, for confidence; 0: a shape that is estimated tells"
    )
    lost_below: Fraction = setting(0.5, "1 - D / c_max of a frame that is missed")
    lost_after_frames: Annotated[int, Field(ge=1)] = setting(
        5, "misses in a row; then the hand is looked for in the whole image"
    )


class OutputSettings(Settings):
    """What goes into the result."""

    mesh: Literal["lean", "medium", "none"] = setting("lean", "drawn in /hand/scene: lean, medium or none")
    flush_frames: Annotated[int, Field(ge=1)] = setting(10, "after so many frames the result is safe on disk")


class HandConfig(Settings):
    """Everything that a hand run depends on besides its recording and its seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("hand.mesh",)

    hand: HandSettings = HandSettings()
    filter: FilterSettings = FilterSettings()
    motion: MotionSettings = MotionSettings()
    velocity: VelocitySettings = setting(VelocitySettings(), "that a result states")
    observation: ObservationSettings = ObservationSettings()
    detection: DetectionSettings = setting(
        DetectionSettings(), "where a hand is searched for that no prediction tells of"
    )
    init: InitSettings = InitSettings()
    fit: FitSettings = setting(FitSettings(), "local fits to a frame, for the guided proposal")
    acquisition: AcquisitionSettings = setting(
        AcquisitionSettings(), "finding a hand without a prediction: of many hypotheses ..."
    )
    pso: PsoSettings = setting(
        PsoSettings(), 'the optimiser of Oikonomidis, Kyriazis and Argyros, BMVC 2011; only kind = "pso" asks'
    )
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
