"""The head trackers' configuration.

``configs/head-stereo.toml`` and ``configs/head-mono.toml`` state these defaults with their reasons.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from posetrack_cli.arrays import FloatArray
from posetrack_cli.configuration import Settings
from posetrack_cli.head.face.points import of_kinds
from posetrack_cli.tracking.confidence import PROBABLY
from posetrack_cli.tracking.options import Deviation, PrintedSetting, deviations

# Wider than any head, camera or time, and narrow enough that no arithmetic on them overflows.
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


class DetectionSettings(Settings):
    """How faces are found in an image.

    ``model`` is YuNet's ONNX file. ``points = "learned"`` chooses the ten points together by what they look
    like in many faces, ``features`` is what ``scripts/build face-features`` wrote of that, none the shipped
    file **[ours]**; ``"corners"`` takes the strongest corner near each point's place, for several cameras,
    which measure where it is. A face counts from ``least_face_score`` on (0.5 is the detector's own
    threshold), its points from a mean response of ``least_point_score`` **[ours]**; ``least_face_px`` is the
    narrowest box that the Haar cascade looks for.
    """

    file_keys: ClassVar[tuple[str, ...]] = ("model", "features")

    detector: Literal["haar", "yunet"] = "haar"
    model: str | None = None
    points: Literal["learned", "corners"] = "corners"
    features: str | None = None
    least_face_score: Fraction = 0.5
    least_point_score: Fraction = 0.3
    least_face_px: Annotated[int, Field(ge=24, le=10_000)] = 50


class StereoInitialisationSettings(Settings):
    """When a head counts as found **[ours]**.

    Points in space must fall within ``reprojection_px`` of their pixels.
    """

    detection: DetectionSettings = DetectionSettings()
    reprojection_px: Positive = 3.0


class PointSettings(Settings):
    """One number for each kind of feature point, mm."""

    eyes: Positive
    mouth: Positive
    nostrils: Positive
    brows: Positive

    @property
    def values(self) -> FloatArray:
        """(K,) the number of each point's kind."""
        return of_kinds(**self.model_dump())


class ModelSettings(Settings):
    """How the face may deform, and how its model is learnt while tracking (thesis, 3.2.4).

    ``components`` is B. The first ``rigid_frames`` frames are tracked with a rigid face, whose mean shape
    moves towards what is measured **[ours]**; with ``rigid_phase = "printed"`` they are tracked with the
    shape that was found, and learnt from as all others (3.4); the mean is then that of all frames that face
    the camera, from the shape found on (3.20). A deformation is learnt from a frame where every point
    correlates above ``correlation``. Shapes are laid on the mean by points that move little:
    ``expression_mm`` is how far a kind moves in expressions. They are laid on it where they differ from the
    model's by ``align_above_mm`` (the length of the 3K numbers).
    """

    kind: Literal["deformable", "rigid"] = "deformable"
    components: Annotated[int, Field(ge=1, le=20)] = 5
    rigid_frames: Annotated[int, Field(ge=0)] = 120
    rigid_phase: Literal["mean", "printed"] = "mean"
    correlation: Fraction = 0.5
    align_above_mm: NotNegative = 0.0
    expression_mm: PointSettings = PointSettings(eyes=1.0, mouth=8.0, nostrils=1.5, brows=8.0)


class RefinementSettings(Settings):
    """The refinement of pose, deformation and points after the particle filter **[ours]**.

    Without ``joint`` the filter's pose stays. ``recalculation = "printed"`` is the thesis's: raw
    intensities, ``rho`` and ``epsilon`` of (3.3) and (3.5), ``recalculation_iterations`` at most. The
    comparison with the frame before counts by the point's best correlation with a stored template, to the
    power ``previous_likeness``: a point that left its feature must not follow what it left it for. A keyframe
    is kept from a direction that is ``keyframe_deg`` from those of all others.
    """

    joint: bool = True
    recalculation: Literal["joint", "printed"] = "joint"
    recalculation_iterations: Count = 2
    rho: NotNegative = 4.0
    epsilon: NotNegative = 2000.0
    previous_likeness: NotNegative = 0.0
    keyframe_deg: Positive = 10.0


class StereoRefinementSettings(RefinementSettings):
    """The refinement of several cameras **[ours]**.

    The points of a shape that was just found move by ``settling_mm`` (standard deviation) along their rays,
    until the cameras agree.
    """

    settling_mm: Positive = 20.0


class ParticleSettings(Settings):
    """The particle filter over pose and deformation (thesis, 3.3).

    ``kappa`` is the least standard deviation of the deformation within a thirtieth of a second, in units of
    its deviations mu. ``weighting`` is by patches **[ours]**, or as printed, (3.27) with ``sigma``, which
    hardly tells a pixel from none. ``sampling`` is halfway partitioned sampling with the weights that it
    needs to keep its target **[ours]**, or as printed. ``gap_max_s`` is the longest time without a frame that
    is predicted, and counts for all longer ones.
    """

    count: Count = 1000
    weighting: Literal["patches", "printed"] = "patches"
    sigma: Positive = 3.0
    kappa: Positive = 0.5
    sampling: Literal["weighted", "printed"] = "weighted"
    resampling: Literal["systematic", "multinomial", "residual", "stratified"] = "systematic"
    lookup: Literal["bilinear", "nearest"] = "bilinear"
    gap_max_s: Positive = 0.2


class HeadStatusSettings(Settings):
    """When a head counts as tracked **[ours]**.

    A frame's score is the mean correlation of its visible points. Below ``tracking_above`` a frame is lost;
    after ``lost_after_frames`` of them the face is searched for again. A frame whose confidence, the
    probability of being right, is below ``doubtful_below`` is said to be lost, too, and followed on all the
    same.
    """

    tracking_above: Fraction = 0.6
    doubtful_below: Fraction = PROBABLY
    lost_after_frames: Count = 3


class HeadSmoothingSettings(Settings):
    """The smoothed track of ``--smooth`` **[ours]**; see ``head.smoothing``.

    A head's velocity wanders by ``velocity_mm`` and ``velocity_rad`` in the square root of a second: the
    less, the smoother. A head that is lost for no longer than ``bridge_s`` is bridged.
    """

    velocity_mm: Positive = 100.0
    velocity_rad: Positive = 0.3
    bridge_s: NotNegative = 0.5


class RunSettings(Settings):
    """How a recording is gone through.

    With ``passes`` 2 it is tracked twice: the second pass begins with the model and the templates that the
    first one has learned, and is the result.
    """

    passes: Annotated[int, Field(ge=1, le=2)] = 1


class HeadOutputSettings(Settings):
    """How a result is written."""

    flush_frames: Count = 30


class HeadStereoConfig(Settings):
    """Everything that a stereo run depends on besides its recording and its seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("start.detection.model", "start.detection.features")

    start: StereoInitialisationSettings = StereoInitialisationSettings()
    model: ModelSettings = ModelSettings()
    particles: ParticleSettings = ParticleSettings()
    refinement: StereoRefinementSettings = StereoRefinementSettings()
    status: HeadStatusSettings = HeadStatusSettings()
    smoothing: HeadSmoothingSettings = HeadSmoothingSettings()
    run: RunSettings = RunSettings()
    output: HeadOutputSettings = HeadOutputSettings()


LARGEST_SCALE = 4.0
"""No image can be enlarged by more: faces whose eyes are 20 pixels apart are."""


class MonoInitialisationSettings(Settings):
    """When a face counts as found (thesis, 4.4.1).

    It is found when it was detected in ``frames`` frames (n). Images in which the eyes are farther apart than
    ``eye_distance_px`` are reduced to it, and about a face with eyes less far apart they are enlarged,
    ``largest_scale`` times at most **[ours]**. Points count as detected with ``pixel_sd`` times the noise of
    tracked ones.
    """

    detection: DetectionSettings = DetectionSettings(points="learned", least_point_score=0.6)
    frames: Annotated[int, Field(ge=1, le=30)] = 5
    eye_distance_px: Positive = 80.0
    largest_scale: Annotated[float, Field(ge=1.0, le=LARGEST_SCALE)] = LARGEST_SCALE
    pixel_sd: Positive = 2.0


class FaceModelSettings(Settings):
    """Which multilinear model; ``file`` is what ``head build-model`` writes, none is the shipped one."""

    file_keys: ClassVar[tuple[str, ...]] = ("file",)

    file: str | None = None


class AdjustmentSettings(Settings):
    """The bundle adjustment (thesis, 4.3).

    ``when``: after every frame that faces the camera, only at the start, or never (the mean person).
    ``whole``: the first of two passes ends with an adjustment of the person over the whole recording, which
    the second one holds; without, the second one goes on adjusting **[ours]**.
    ``views`` is n, chosen by the ``spread`` of face directions, or of their angles as printed (4.3.2);
    ``iterations`` of each of the two stages, ``start_iterations`` at the start. No deformation or identity is
    more than ``bound`` standard deviations from the mean. The identity's start is the mean of the last
    ``average`` adjustments (N_s).

    **[ours]** ``prior`` weighs the squares of whitened s and a beside the boxes, ``offsets`` adds the
    constant offsets of points, ``huber`` bounds the influence of a point in units of its ``pixel_sd``, which
    is twice what a point errs by in a frame: points err alike in like frames. Over a whole recording, and of
    a person whom that has told, it is ``whole_share`` of that: frames of many directions err less alike. A
    frame is adjusted with if the face is turned from the camera by less
    than ``facing_deg``, its score is above ``score``, and it is deformed by less than ``neutral_mm`` (the
    length of its 3K numbers): an expression that the model does not know would be taken for the person. With
    ``gates_points`` direction and score also decide whether a frame's points are recalculated (4.4.3); in
    other frames they are where the model has them.
    """

    when: Literal["always", "start", "never"] = "always"
    whole: bool = True
    views: Annotated[int, Field(ge=2, le=200)] = 20
    spread: Literal["directions", "angles"] = "directions"
    iterations: Count = 5
    start_iterations: Count = 10
    average: Count = 15
    bound: Positive = 4.0
    prior: NotNegative = 2.0
    offsets: bool = True
    huber: Positive = 1.5
    pixel_sd: PointSettings = PointSettings(eyes=1.4, mouth=3.0, nostrils=2.4, brows=4.0)
    whole_share: Annotated[float, Field(ge=0.05, le=1.0)] = 0.35
    facing_deg: Positive = 45.0
    score: Fraction = 0.6
    gates_points: bool = False
    neutral_mm: Positive = 6.0


class MonoStatusSettings(HeadStatusSettings):
    """When a head counts as tracked **[ours]**; see ``HeadStatusSettings``.

    A blink changes four of ten points: a frame counts with a lower score than a stereo tracker's. A score
    below ``check_below`` is compared with what begins where the whole face went, and if that is below it,
    too, with that of a face detected anew.
    """

    tracking_above: Fraction = 0.45
    lost_after_frames: Count = 1
    check_below: Fraction = 0.7


class PersonSettings(Settings):
    """What is known of the person before anything is seen; of the first, if there are several **[ours]**.

    ``interpupillary_mm`` is the distance of the pupils of somebody who looks far away, measured with the
    standard deviation ``interpupillary_sd_mm``. See ``head.tracker.person``.
    """

    interpupillary_mm: Annotated[float, Field(ge=40.0, le=90.0)] | None = None
    interpupillary_sd_mm: NotNegative = 0.5


class SkinSettings(Settings):
    """The skin between the feature points, which tells a second pass where a head is, too **[ours]**.

    ``use`` without: the feature points alone.
    """

    use: bool = True


class HeadMonoConfig(Settings):
    """Everything that a one-camera run depends on besides its recording and its seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("start.detection.model", "start.detection.features", "model.file")

    start: MonoInitialisationSettings = MonoInitialisationSettings()
    model: FaceModelSettings = FaceModelSettings()
    particles: ParticleSettings = ParticleSettings(count=750, kappa=0.2, sigma=1.0)
    refinement: RefinementSettings = RefinementSettings(previous_likeness=1.0)
    adjustment: AdjustmentSettings = AdjustmentSettings()
    status: MonoStatusSettings = MonoStatusSettings()
    person: PersonSettings = PersonSettings()
    skin: SkinSettings = SkinSettings()
    smoothing: HeadSmoothingSettings = HeadSmoothingSettings(velocity_mm=300.0, velocity_rad=2.0)
    run: RunSettings = RunSettings(passes=2)
    output: HeadOutputSettings = HeadOutputSettings()


# Where a run differs from Sugano's thesis: chapter 3 of several cameras, chapter 4 of one


ALIKE = PointSettings(eyes=1.0, mouth=1.0, nostrils=1.0, brows=1.0)
BOTH = (
    PrintedSetting("3.3.2", "particles.sampling", "printed"),
    PrintedSetting("3.3.1", "particles.resampling", "multinomial"),
    PrintedSetting("(3.28)", "particles.lookup", "nearest"),
    PrintedSetting("(3.29)", "refinement.joint", False),
    PrintedSetting("3.2.3, 4.4.3", "refinement.recalculation", "printed"),
    PrintedSetting("(3.5)", "refinement.rho", 4.0),
    PrintedSetting("3.2.1", "refinement.keyframe_deg", 360.0),
    PrintedSetting("3.4, 4.5", "run.passes", 1),
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
    PrintedSetting("3.2.1", "skin.use", False),
    PrintedSetting("4.4", "status.check_below", 0.0),
)
ALWAYS_BOTH = (
    Deviation("3.2.1", "templates are warped to the predicted pose"),
    Deviation("(3.28)", "points weigh less where they are turned away from the camera"),
    Deviation("(3.26)", "rotations move by rotation vectors, not by angles"),
    Deviation("(3.31)", "the velocity in results is estimated from the poses up to the next frame's"),
    Deviation("(3.29)", "motion noise and the radius d are ours; none are printed"),
    Deviation("3.3", "a frame may be lost (status); the face is then searched for"),
)
ALWAYS_STEREO = (
    Deviation("3.2.2", "OpenCV's detector finds face and points, not OKAO Vision"),
    Deviation("(3.18), (3.19)", "the factor 2 of (3.16) is kept"),
    Deviation("3.2.4", "a shape far from a face's is not learnt from"),
    Deviation("(3.24)", "the basis is made orthogonal after every update"),
    Deviation("3.2.3, 3.2.4", "angle and distances of the gates are ours; none are printed"),
)
ALWAYS_MONO = (
    Deviation("4.4.1", "learned responses find face and points, not OKAO Vision"),
    Deviation("4.4.1", "the adjustment begins with each frame's own pose, not in the middle of the image"),
    Deviation("(4.21) to (4.24)", "the signs of the normal equations are corrected"),
    Deviation("(4.37)", "the box is about s, not about a"),
    Deviation("(4.51), (4.52)", "the factor 2 is that of both terms"),
    Deviation("4.4.3", "the score is the estimate's mean correlation, not the best particle's"),
    Deviation("4.3, 4.4.3", "boxes, angle and score are ours; none are printed"),
)
SHIPPED_MODEL = Deviation("4.2", "the shipped face model is learned from ICT-FaceKit")


def deviations_from_print(config: HeadStereoConfig | HeadMonoConfig) -> list[str] | None:
    """Return where a configuration that follows the thesis differs from it; None of any other.

    It follows the thesis where the particles' weights (3.27), (4.41) are the thesis's, and their estimate is
    the pose.
    """
    if config.particles.weighting != "printed" or config.refinement.joint:
        return None
    if isinstance(config, HeadStereoConfig):
        return deviations(config, (*STEREO, *BOTH), (*ALWAYS_STEREO, *ALWAYS_BOTH))
    model = (SHIPPED_MODEL,) if config.model.file is None else ()
    return deviations(config, (*MONO, *BOTH), (*model, *ALWAYS_MONO, *ALWAYS_BOTH))
