"""Configuration of the head trackers; ``configs/head-*.toml`` are generated from it."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from posetrack_cli.arrays import FloatArray
from posetrack_cli.configuration import Settings, setting
from posetrack_cli.head.face.points import of_kinds
from posetrack_cli.tracking.confidence import PROBABLY
from posetrack_cli.tracking.options import Deviation, PrintedSetting, deviations

# Generous physical limits, narrow enough that squares and quotients of the values cannot overflow.
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


class DetectionSettings(Settings):
    """Face detection in one image.

    `detector` finds faces; `yunet` requires its ONNX file in `model`. `points = "learned"` fits the ten
    points jointly with a learned appearance model **[ours]**, read from `features` (default: the shipped
    file, written by `scripts/build face-features`). `points = "corners"` takes the strongest corner near the
    expected place of each point, which suits calibrated rigs because their cameras measure the points'
    places.
    """

    file_keys: ClassVar[tuple[str, ...]] = ("model", "features")

    detector: Literal["haar", "yunet"] = setting(
        "haar", 'face detector: "haar" (OpenCV cascade) or "yunet" (needs model)'
    )
    model: str | None = setting(None, "YuNet ONNX file", example="face_detection_yunet_2023mar.onnx")
    points: Literal["learned", "corners"] = setting(
        "corners",
        'point localisation: "learned" (joint fit of an appearance model) or "corners" (strongest '
        "corner near the expected place)",
    )
    features: str | None = setting(
        None, 'appearance model for points = "learned"; default: the shipped one', example="appearance.npz"
    )
    least_face_score: Fraction = setting(0.5, "minimum detector score; 0.5 is the detectors' own threshold")
    least_point_score: Fraction = setting(0.3, "minimum mean response of the ten points")
    least_face_px: Annotated[int, Field(ge=24, le=10_000)] = setting(
        50, "minimum face width for the Haar cascade, pixels"
    )


class StereoInitialisationSettings(Settings):
    """Acceptance of a detected head **[ours]**."""

    detection: DetectionSettings = DetectionSettings()
    reprojection_px: Positive = setting(3.0, "maximum reprojection error of a triangulated point, pixels")


class PointSettings(Settings):
    """One value per kind of feature point, in the unit of the key."""

    eyes: Positive
    mouth: Positive
    nostrils: Positive
    brows: Positive

    @property
    def values(self) -> FloatArray:
        """(K,) value for each point's kind."""
        return of_kinds(**self.model_dump())


class ModelSettings(Settings):
    """Face deformation model, learned while tracking (thesis, 3.2.4).

    The model has `components` (B) principal components. During the first `rigid_frames` frames the face is
    rigid and its mean shape is refined **[ours]**. With `rigid_phase = "printed"` those frames use the shape
    found at initialisation and already train the deformation model (3.4); the mean is then the average over
    all frames that face the camera, starting with the initial shape (3.20).

    A frame trains the model only if every point correlates above `correlation`. A shape that differs from the
    model's by at least `align_above_mm` (norm of its 3K coordinates) is first aligned to the mean, weighting
    each kind of point by how little it moves in expressions (`expression_mm`).
    """

    kind: Literal["deformable", "rigid"] = setting("deformable", '"deformable" or "rigid"')
    components: Annotated[int, Field(ge=1, le=20)] = setting(5, "B, number of deformation components")
    rigid_frames: Annotated[int, Field(ge=0)] = setting(120, "frames tracked with a rigid face at the start")
    rigid_phase: Literal["mean", "printed"] = setting(
        "mean",
        'what rigid_frames learn: "mean" refines the mean shape; "printed" keeps the initial shape and '
        "trains the deformation model (3.4)",
    )
    correlation: Fraction = setting(0.5, "a frame trains the model only if every point correlates above this")
    align_above_mm: NotNegative = setting(
        0.0, "align a shape to the mean if it differs from the model by at least this (norm of 3K values)"
    )
    expression_mm: PointSettings = setting(
        PointSettings(eyes=1.0, mouth=8.0, nostrils=1.5, brows=8.0),
        "typical motion of each kind of point in expressions; sets its weight in the alignment",
    )


class RefinementSettings(Settings):
    """Refinement of pose, deformation and points after the particle filter **[ours]**.

    `recalculation = "printed"` is the thesis's method: raw intensities with `rho` and `epsilon`, (3.3) and
    (3.5). The comparison with the previous frame is weighted by the point's best correlation with a stored
    template, raised to `previous_likeness`, so that a point that slid off its feature, or that something
    covers, does not stay there. With `expressions`, named actions such as raised brows are unknowns next to
    the deformation, so that points moved by them do not turn the head.
    """

    joint: bool = setting(True, "refine the pose; false keeps the filter's pose")
    recalculation: Literal["joint", "printed"] = setting(
        "joint", 'point refinement: "joint", or "printed" for (3.3), (4.42) to (4.52)'
    )
    recalculation_iterations: Count = setting(2, "maximum iterations of the point refinement")
    rho: NotNegative = setting(4.0, 'weight of the previous frame, "printed" only')
    epsilon: NotNegative = setting(2000.0, 'weight of the model\'s shape, "printed" only')
    previous_likeness: NotNegative = setting(
        0.0,
        "exponent: weight the previous frame by the correlation with stored templates to this power; "
        "0 disables the weighting",
    )
    expressions: bool = setting(
        False, "add the named actions to the deformations of the face model in the refinement of the pose"
    )
    keyframe_deg: Positive = setting(
        10.0, "minimum angle between a new keyframe and all stored ones, degrees"
    )


class StereoRefinementSettings(RefinementSettings):
    """Refinement with several cameras **[ours]**.

    After initialisation each point moves along its ray until the cameras agree.
    """

    settling_mm: Positive = setting(20.0, "standard deviation of the depth correction of an initial shape")


class ParticleSettings(Settings):
    """Particle filter over pose and deformation (thesis, 3.3).

    `weighting = "patches"` models the noise of normalised patches **[ours]**; `"printed"` is (3.27) with
    `sigma`, which barely separates good matches from fair ones. `sampling = "weighted"` is halfway
    partitioned sampling with the importance weights required to keep its target distribution **[ours]**.
    """

    count: Count = setting(1000, "number of particles")
    weighting: Literal["patches", "printed"] = setting(
        "patches", 'likelihood: "patches" (noise of normalised patches) or "printed" (3.27), (4.41)'
    )
    sigma: Positive = setting(3.0, 'sigma of (3.27), "printed" only')
    kappa: Positive = setting(
        0.5, "diffusion of the deformation per 1/30 s, in units of its standard deviations"
    )
    sampling: Literal["weighted", "printed"] = setting(
        "weighted", 'partitioned sampling: "weighted" (importance weights) or "printed" (none)'
    )
    resampling: Literal["systematic", "multinomial", "residual", "stratified"] = setting(
        "systematic", '"systematic", "multinomial", "residual" or "stratified"'
    )
    lookup: Literal["bilinear", "nearest"] = setting(
        "bilinear", 'interpolation in the correlation maps: "bilinear" or "nearest"'
    )
    gap_max_s: Positive = setting(0.2, "longest time step of the motion model; longer gaps use this value")


class HeadStatusSettings(Settings):
    """Status of a frame: tracking or lost **[ours]**.

    A frame's score is the mean correlation of its visible points. Below `check_below`, the motion of the
    whole face since the previous frame is tried. Confidence is the probability that the frame is right; a
    frame below `doubtful_below` is reported as lost, but tracking continues from it.
    """

    tracking_above: Fraction = setting(
        0.6, "minimum score (mean correlation of the visible points); below it the frame is lost"
    )
    doubtful_below: Fraction = setting(
        PROBABLY, "report frames with a lower confidence as lost, but keep tracking"
    )
    lost_after_frames: Count = setting(3, "search for the face again after this many lost frames in a row")
    check_below: Fraction = setting(0.6, "below this score, try the motion of the whole face")


class FaceSettings(Settings):
    """Dense face: points of lips, jaw, lids, irises and brows, actions, blinks and gaze **[ours]**."""

    use: bool = setting(True, "measure the dense face; false tracks the ten points only")


class HeadSmoothingSettings(Settings):
    """Smoothed track written with `--smooth` **[ours]**.

    `velocity_mm` and `velocity_rad` are the process noise of the velocity, per square root of a second.
    """

    velocity_mm: Positive = setting(
        100.0, "process noise of the linear velocity, mm/s per sqrt(s); lower is smoother"
    )
    velocity_rad: Positive = setting(
        0.3, "process noise of the angular velocity, rad/s per sqrt(s); lower is smoother"
    )
    bridge_s: NotNegative = setting(0.5, "interpolate across gaps up to this long, s")


class RunSettings(Settings):
    """Passes over the recording.

    With two passes, the second pass starts with the model and templates learned in the first and is the
    result.
    """

    passes: Annotated[int, Field(ge=1, le=2)] = setting(
        1, "2 tracks twice: the first pass learns the face, the second is the result"
    )


class HeadOutputSettings(Settings):
    """Result file."""

    flush_frames: Count = setting(30, "frames between two checkpoints")


class SkinSettings(Settings):
    """Skin texture between the feature points, used by the second pass to refine the pose **[ours]**."""

    use: bool = setting(True, "use the skin texture; false uses the feature points only")


class HeadStereoConfig(Settings):
    """Configuration of ``head stereo``: everything a run depends on except recording and seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("start.detection.model", "start.detection.features")

    start: StereoInitialisationSettings = setting(
        StereoInitialisationSettings(), "initialisation: detection and acceptance of a head"
    )
    model: ModelSettings = setting(ModelSettings(), "face deformation model, learned while tracking")
    particles: ParticleSettings = ParticleSettings()
    refinement: StereoRefinementSettings = setting(
        StereoRefinementSettings(previous_likeness=1.0, expressions=True),
        "Gauss-Newton over pose, deformation and a residual for each point",
    )
    status: HeadStatusSettings = HeadStatusSettings()
    skin: SkinSettings = setting(SkinSettings(), "skin texture between the feature points (second pass)")
    face: FaceSettings = setting(FaceSettings(), "dense face: lips, jaw, lids, irises, brows")
    smoothing: HeadSmoothingSettings = setting(
        HeadSmoothingSettings(), "--smooth: additional track, smoothed over the whole recording"
    )
    run: RunSettings = RunSettings()
    output: HeadOutputSettings = HeadOutputSettings()


LARGEST_SCALE = 4.0
"""Maximum image magnification: faces with an eye distance of 20 pixels reach the default 80."""


class MonoInitialisationSettings(Settings):
    """Initialisation from several frames (thesis, 4.4.1).

    The face is detected in `frames` frames, which are then adjusted together. Images are scaled so that the
    eye distance is about `eye_distance_px`: large faces are reduced, small ones enlarged by at most
    `largest_scale` **[ours]**. Detected points are weighted as `pixel_sd` times noisier than tracked ones.
    """

    detection: DetectionSettings = DetectionSettings(points="learned", least_point_score=0.6)
    frames: Annotated[int, Field(ge=1, le=30)] = setting(
        5, "n, frames with a detected face that are adjusted together"
    )
    eye_distance_px: Positive = setting(
        80.0, "eye distance to which images are scaled, pixels; suits patches of 16 x 16 pixels"
    )
    largest_scale: Annotated[float, Field(ge=1.0, le=LARGEST_SCALE)] = setting(
        LARGEST_SCALE, "maximum magnification of small faces; 1 disables it"
    )
    pixel_sd: Positive = setting(2.0, "noise of a detected point relative to a tracked one")


class FaceModelSettings(Settings):
    """Multilinear face model (thesis, 4.2), written by `head build-model`."""

    file_keys: ClassVar[tuple[str, ...]] = ("file",)

    file: str | None = setting(
        None, "face model written by head build-model; default: the shipped model", example="face.npz"
    )


class AdjustmentSettings(Settings):
    """Incremental bundle adjustment of the person and recent frames (thesis, 4.3).

    `when = "never"` keeps the mean person. With `whole`, the first of two passes ends with an adjustment over
    the whole recording and the second pass keeps that person **[ours]**. The adjusted frames are the `views`
    (n) whose face directions spread most; `spread = "angles"` uses yaw and pitch as printed (4.3.2). Identity
    and deformation stay within `bound` standard deviations of the mean. The starting identity is the mean of
    the last `average` adjustments (N_s).

    **[ours]** `prior` weights the squares of the whitened s and a, in addition to the bounds. `offsets`
    estimates a constant offset for each point. `huber` bounds the influence of a point, in units of its
    `pixel_sd`; `pixel_sd` is twice the tracking error because errors in similar frames are correlated.
    Adjustments over the whole recording multiply it by `whole_share` because frames with different directions
    are less correlated.

    A frame is used if the face is within `facing_deg` of the camera, its score exceeds `score`, and its
    deformation is below `neutral_mm` (norm of 3K coordinates): the adjustment would otherwise absorb
    unmodelled expressions into the identity. With `gates_points`, direction and score also decide whether
    points are refined (4.4.3); in other frames they stay at the model's places.
    """

    when: Literal["always", "start", "never"] = setting(
        "always", 'when to adjust: "always" (after every suitable frame), "start" or "never"'
    )
    whole: bool = setting(
        True, "adjust over the whole recording after the first pass; the second pass keeps that person"
    )
    views: Annotated[int, Field(ge=2, le=200)] = setting(20, "n, number of frames adjusted together")
    spread: Literal["directions", "angles"] = setting(
        "directions", 'how frames are chosen: spread of "directions", or of "angles" as printed (4.3.2)'
    )
    iterations: Count = setting(5, "maximum iterations of each stage (poses only, then everything)")
    start_iterations: Count = setting(10, "the same at initialisation and over the whole recording")
    average: Count = setting(15, "N_s, number of adjustments averaged for the starting identity (4.36)")
    bound: Positive = setting(
        4.0, "bound on identity and deformation, standard deviations from the mean (4.35), (4.37)"
    )
    prior: NotNegative = setting(2.0, "weight of the prior on s and a, in addition to the bounds")
    offsets: bool = setting(True, "estimate a constant offset of each point from the model's vertex")
    huber: Positive = setting(1.5, "Huber threshold, in standard deviations of a point")
    pixel_sd: PointSettings = setting(
        PointSettings(eyes=1.4, mouth=3.0, nostrils=2.4, brows=4.0),
        "standard deviation of a point, pixels: twice its tracking error, as errors are correlated",
    )
    whole_share: Annotated[float, Field(ge=0.05, le=1.0)] = setting(
        0.35, "factor on pixel_sd for adjustments over the whole recording"
    )
    facing_deg: Positive = setting(
        45.0, "use frames whose face is within this angle of the camera direction, degrees"
    )
    score: Fraction = setting(0.6, "use frames with a higher score")
    gates_points: bool = setting(
        False, "refine points only in frames that pass facing_deg and score, as printed (4.4.3)"
    )
    neutral_mm: Positive = setting(6.0, "use frames with a smaller deformation (norm of 3K values)")


class MonoStatusSettings(HeadStatusSettings):
    """Status of a frame: tracking or lost **[ours]**.

    Like `HeadStatusSettings`, with a lower score threshold because a blink changes four of the ten points. A
    score below `check_below` triggers a whole-face motion search and, if that does not help, a new detection.
    """

    tracking_above: Fraction = setting(
        0.45, "minimum score (mean correlation of the visible points); below it the frame is lost"
    )
    lost_after_frames: Count = setting(1, "search for the face again after this many lost frames in a row")
    check_below: Fraction = setting(
        0.7, "below this score, try the motion of the whole face, then a new detection"
    )


class PersonSettings(Settings):
    """Prior knowledge of the (first) person **[ours]**.

    `interpupillary_mm` is the distance between the pupils when looking into the distance; it fixes the scale,
    which one camera cannot observe.
    """

    interpupillary_mm: Annotated[float, Field(ge=40.0, le=90.0)] | None = setting(
        None, "interpupillary distance when looking into the distance; fixes the scale", example=63.0
    )
    interpupillary_sd_mm: NotNegative = setting(0.5, "standard deviation of that measurement")


class LensSettings(Settings):
    """Camera without calibration and without --fov **[ours]**."""

    estimate: bool = setting(
        True, "estimate its focal length from the face; false assumes a field of view of 53 degrees"
    )


class HeadMonoConfig(Settings):
    """Configuration of ``head mono``: everything a run depends on except recording and seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("start.detection.model", "start.detection.features", "model.file")

    start: MonoInitialisationSettings = setting(
        MonoInitialisationSettings(), "initialisation from several frames"
    )
    model: FaceModelSettings = setting(FaceModelSettings(), "face model: identities and deformations")
    particles: ParticleSettings = ParticleSettings(count=750, kappa=0.2, sigma=1.0)
    refinement: RefinementSettings = setting(
        RefinementSettings(previous_likeness=1.0),
        "Gauss-Newton over pose, deformation and a residual for each point",
    )
    adjustment: AdjustmentSettings = setting(
        AdjustmentSettings(), "bundle adjustment of the person and recent frames (4.3)"
    )
    status: MonoStatusSettings = MonoStatusSettings()
    person: PersonSettings = setting(PersonSettings(), "prior knowledge of the (first) person")
    skin: SkinSettings = setting(SkinSettings(), "skin texture between the feature points (second pass)")
    lens: LensSettings = setting(LensSettings(), "focal length of a camera without calibration")
    face: FaceSettings = setting(FaceSettings(), "dense face: lips, jaw, lids, irises, brows")
    smoothing: HeadSmoothingSettings = setting(
        HeadSmoothingSettings(velocity_mm=300.0, velocity_rad=2.0),
        "--smooth: additional track, smoothed over the whole recording",
    )
    run: RunSettings = RunSettings(passes=2)
    output: HeadOutputSettings = HeadOutputSettings()


# The thesis's settings (Sugano: chapter 3 for several cameras, chapter 4 for one), and what still deviates
# from it. ``deviations_from_print`` lists both in the run record of a configuration that follows the thesis.

ALIKE = PointSettings(eyes=1.0, mouth=1.0, nostrils=1.0, brows=1.0)
BOTH = (
    PrintedSetting("3.3.2", "particles.sampling", "printed"),
    PrintedSetting("3.3.1", "particles.resampling", "multinomial"),
    PrintedSetting("(3.28)", "particles.lookup", "nearest"),
    PrintedSetting("(3.29)", "refinement.joint", False),
    PrintedSetting("3.2.3, 4.4.3", "refinement.recalculation", "printed"),
    PrintedSetting("(3.5)", "refinement.rho", 4.0),
    PrintedSetting("3.2.1", "refinement.keyframe_deg", 360.0),
    PrintedSetting("3.2.1", "skin.use", False),
    PrintedSetting("3.4, 4.5", "run.passes", 1),
    PrintedSetting("5.2", "face.use", False),
)
STEREO = (
    PrintedSetting("3.2.1", "model.components", 5),
    PrintedSetting("3.4", "model.rigid_frames", 120),
    PrintedSetting("3.4, (3.20)", "model.rigid_phase", "printed"),
    PrintedSetting("3.2.3", "model.expression_mm", ALIKE),
    PrintedSetting("3.2.4", "model.correlation", 0.0),
    PrintedSetting("3.4", "particles.count", 1000),
    PrintedSetting("(3.27)", "particles.weighting", "printed"),
    PrintedSetting("(3.27)", "particles.sigma", 3.0),
    PrintedSetting("3.3.1", "particles.kappa", 0.5),
    PrintedSetting("(3.3)", "refinement.epsilon", 2000.0),
    PrintedSetting("(3.4)", "refinement.previous_likeness", 0.0),
    PrintedSetting("(3.1)", "refinement.expressions", False),
    PrintedSetting("3.3", "status.check_below", 0.0),
    PrintedSetting("3.2.2", "refinement.settling_mm", 0.01),
)
MONO = (
    PrintedSetting("4.4.1", "start.frames", 5),
    PrintedSetting("4.5", "start.eye_distance_px", 1000.0),
    PrintedSetting("4.5", "start.largest_scale", 1.0),
    PrintedSetting("(4.18)", "start.pixel_sd", 1.0),
    PrintedSetting("4.5", "particles.count", 750),
    PrintedSetting("(4.41)", "particles.weighting", "printed"),
    PrintedSetting("(4.41)", "particles.sigma", 1.0),
    PrintedSetting("4.4.2", "particles.kappa", 0.2),
    PrintedSetting("(4.42)", "refinement.epsilon", 4000.0),
    PrintedSetting("(4.43)", "refinement.previous_likeness", 0.0),
    PrintedSetting("4.3.2", "adjustment.views", 5),
    PrintedSetting("4.3.2", "adjustment.spread", "angles"),
    PrintedSetting("4.5", "adjustment.iterations", 5),
    PrintedSetting("4.5", "adjustment.start_iterations", 10),
    PrintedSetting("(4.36)", "adjustment.average", 15),
    PrintedSetting("(4.35), (4.37)", "adjustment.bound", 2.0),
    PrintedSetting("(4.18)", "adjustment.prior", 0.0),
    PrintedSetting("(4.18)", "adjustment.offsets", False),
    PrintedSetting("(4.18)", "adjustment.huber", 1e6),
    PrintedSetting("(4.18)", "adjustment.pixel_sd", ALIKE),
    PrintedSetting("4.4.3", "adjustment.neutral_mm", 1e6),
    PrintedSetting("4.4.3", "adjustment.gates_points", True),
    PrintedSetting("4.5", "lens.estimate", False),
    PrintedSetting("4.4", "status.check_below", 0.0),
)
ALWAYS_BOTH = (
    Deviation("3.2.1", "templates are warped to the predicted pose"),
    Deviation("(3.28)", "points turned away from the camera have a lower weight"),
    Deviation("(3.26)", "rotations diffuse as rotation vectors, not as angles"),
    Deviation("(3.31)", "the velocity in results is estimated from the poses up to the next frame"),
    Deviation("(3.29)", "motion noise and the radius d are ours; the thesis states none"),
    Deviation("3.3", "a frame may be lost (status); the face is then detected again"),
)
ALWAYS_STEREO = (
    Deviation("3.2.2", "OpenCV detects face and points, not OKAO Vision"),
    Deviation("(3.18), (3.19)", "the factor 2 of (3.16) is kept"),
    Deviation("3.2.4", "implausible shapes do not train the model"),
    Deviation("(3.24)", "the basis is orthogonalised after every update"),
    Deviation("3.2.3, 3.2.4", "angle and distance gates are ours; the thesis states none"),
)
ALWAYS_MONO = (
    Deviation("4.4.1", "learned responses locate face and points, not OKAO Vision"),
    Deviation("4.4.1", "the adjustment starts from each frame's own pose, not from the image centre"),
    Deviation("(4.21) to (4.24)", "the signs of the normal equations are corrected"),
    Deviation("(4.37)", "the box bounds s, not a"),
    Deviation("(4.51), (4.52)", "the factor 2 applies to both terms"),
    Deviation("4.4.3", "the score is the estimate's mean correlation, not the best particle's"),
    Deviation("4.3, 4.4.3", "boxes, angle and score thresholds are ours; the thesis states none"),
)
SHIPPED_MODEL = Deviation("4.2", "the shipped face model was built from ICT-FaceKit")


def deviations_from_print(config: HeadStereoConfig | HeadMonoConfig) -> list[str] | None:
    """Return the deviations of a configuration that follows the thesis; None for other configurations.

    A configuration follows the thesis if it uses the printed particle weights (3.27), (4.41) and reports the
    filter's estimate as the pose.
    """
    if config.particles.weighting != "printed" or config.refinement.joint:
        return None
    if isinstance(config, HeadStereoConfig):
        return deviations(config, (*STEREO, *BOTH), (*ALWAYS_STEREO, *ALWAYS_BOTH))
    model = (SHIPPED_MODEL,) if config.model.file is None else ()
    return deviations(config, (*MONO, *BOTH), (*model, *ALWAYS_MONO, *ALWAYS_BOTH))
