"""The head trackers' configurations, of which ``configs/head-*.toml`` are written."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from posetrack_cli.arrays import FloatArray
from posetrack_cli.configuration import Settings, setting
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

    detector: Literal["haar", "yunet"] = setting("haar", 'OpenCV\'s cascades, or "yunet" with its model')
    model: str | None = setting(None, "", example="face_detection_yunet_2023mar.onnx")
    points: Literal["learned", "corners"] = setting(
        "corners",
        '"learned": chosen together by what they look like in many faces, or "corners": the '
        "strongest near their places, of cameras that measure where these are",
    )
    features: str | None = setting(
        None,
        'of "learned": what scripts/build face-features writes; none is the shipped file',
        example="appearance.npz",
    )
    least_face_score: Fraction = setting(0.5, "the detectors' own threshold")
    least_point_score: Fraction = setting(0.3, "mean response of the ten points")
    least_face_px: Annotated[int, Field(ge=24, le=10_000)] = setting(
        50, "narrowest face that the cascade looks for"
    )


class StereoInitialisationSettings(Settings):
    """When a head counts as found **[ours]**.

    Points in space must fall within ``reprojection_px`` of their pixels.
    """

    detection: DetectionSettings = DetectionSettings()
    reprojection_px: Positive = setting(
        3.0, "points in space project to within this distance of their pixels"
    )


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

    kind: Literal["deformable", "rigid"] = setting("deformable", 'or "rigid"')
    components: Annotated[int, Field(ge=1, le=20)] = setting(5, "B")
    rigid_frames: Annotated[int, Field(ge=0)] = setting(120, "so long the face is rigid ...")
    rigid_phase: Literal["mean", "printed"] = setting(
        "mean",
        '... and its mean shape is refined; or "printed": it is the shape found, and '
        "deformations are learnt all the same (3.4)",
    )
    correlation: Fraction = setting(0.5, "learnt from are frames all of whose points look like themselves")
    align_above_mm: NotNegative = setting(
        0.0, "a shape this far from the model's is laid on the mean (length of 3K numbers)"
    )
    expression_mm: PointSettings = setting(
        PointSettings(eyes=1.0, mouth=8.0, nostrils=1.5, brows=8.0),
        "how far points move in expressions: those that move little show what is rigid",
    )


class RefinementSettings(Settings):
    """The refinement of pose, deformation and points after the particle filter **[ours]**.

    Without ``joint`` the filter's pose stays. ``recalculation = "printed"`` is the thesis's: raw
    intensities, ``rho`` and ``epsilon`` of (3.3) and (3.5), ``recalculation_iterations`` at most. The
    comparison with the frame before counts by the point's best correlation with a stored template, to the
    power ``previous_likeness``: a point that left its feature must not follow what it left it for. A keyframe
    is kept from a direction that is ``keyframe_deg`` from those of all others.
    """

    joint: bool = setting(True, "without, the filter's pose stays")
    recalculation: Literal["joint", "printed"] = setting(
        "joint", 'or "printed": (3.3), (4.42) to (4.52) with rho and epsilon'
    )
    recalculation_iterations: Count = 2
    rho: NotNegative = 4.0
    epsilon: NotNegative = 2000.0
    previous_likeness: NotNegative = setting(
        0.0, "the frame before counts by likeness to stored templates, to this power; 0: like them or not"
    )
    keyframe_deg: Positive = setting(10.0, "a keyframe is kept where none looks so nearly the same way")


class StereoRefinementSettings(RefinementSettings):
    """The refinement of several cameras **[ours]**.

    The points of a shape that was just found move by ``settling_mm`` (standard deviation) along their rays,
    until the cameras agree.
    """

    settling_mm: Positive = setting(20.0, "how far a shape just found may settle between the cameras")


class ParticleSettings(Settings):
    """The particle filter over pose and deformation (thesis, 3.3).

    ``kappa`` is the least standard deviation of the deformation within a thirtieth of a second, in units of
    its deviations mu. ``weighting`` is by patches **[ours]**, or as printed, (3.27) with ``sigma``, which
    hardly tells a pixel from none. ``sampling`` is halfway partitioned sampling with the weights that it
    needs to keep its target **[ours]**, or as printed. ``gap_max_s`` is the longest time without a frame that
    is predicted, and counts for all longer ones.
    """

    count: Count = setting(1000, "4.5")
    weighting: Literal["patches", "printed"] = setting(
        "patches", 'by patches with noise, or "printed": (3.27), (4.41) with sigma'
    )
    sigma: Positive = setting(3.0, 'only of "printed"')
    kappa: Positive = setting(0.5, "diffusion of the deformation, in units of its standard deviations")
    sampling: Literal["weighted", "printed"] = setting(
        "weighted", 'halfway partitioned sampling that keeps its target, or "printed"'
    )
    resampling: Literal["systematic", "multinomial", "residual", "stratified"] = setting(
        "systematic", "or multinomial, residual, stratified"
    )
    lookup: Literal["bilinear", "nearest"] = setting("bilinear", 'in the correlation maps, or "nearest"')
    gap_max_s: Positive = setting(0.2, "a head is predicted over no longer a time")


class HeadStatusSettings(Settings):
    """When a head counts as tracked **[ours]**.

    A frame's score is the mean correlation of its visible points. Below ``tracking_above`` a frame is lost;
    after ``lost_after_frames`` of them the face is searched for again. A frame whose confidence, the
    probability of being right, is below ``doubtful_below`` is said to be lost, too, and followed on all the
    same.
    """

    tracking_above: Fraction = setting(
        0.6, "mean correlation of the visible points; below it a frame is lost"
    )
    doubtful_below: Fraction = setting(
        PROBABLY, "a frame that is more probably wrong than right is said to be lost, and followed on"
    )
    lost_after_frames: Count = setting(3, "after so many the face is searched for again")


class HeadSmoothingSettings(Settings):
    """The smoothed track of ``--smooth`` **[ours]**; see ``head.smoothing``.

    A head's velocity wanders by ``velocity_mm`` and ``velocity_rad`` in the square root of a second: the
    less, the smoother. A head that is lost for no longer than ``bridge_s`` is bridged.
    """

    velocity_mm: Positive = setting(
        100.0, "a head's velocity changes by so much in the square root of a second ..."
    )
    velocity_rad: Positive = setting(0.3, "... and by so much: less is smoother")
    bridge_s: NotNegative = setting(0.5, "a head that is lost for no longer is bridged")


class RunSettings(Settings):
    """How a recording is gone through.

    With ``passes`` 2 it is tracked twice: the second pass begins with the model and the templates that the
    first one has learned, and is the result.
    """

    passes: Annotated[int, Field(ge=1, le=2)] = setting(
        1, "2: the second pass begins with what the first has learned, and is the result"
    )


class HeadOutputSettings(Settings):
    """How a result is written."""

    flush_frames: Count = 30


class HeadStereoConfig(Settings):
    """Everything that a stereo run depends on besides its recording and its seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("start.detection.model", "start.detection.features")

    start: StereoInitialisationSettings = setting(
        StereoInitialisationSettings(), "when a head counts as found"
    )
    model: ModelSettings = setting(
        ModelSettings(), "how the face may deform, and how that is learnt while tracking"
    )
    particles: ParticleSettings = ParticleSettings()
    refinement: StereoRefinementSettings = setting(
        StereoRefinementSettings(), "Gauss-Newton over pose, deformation and a residual per point"
    )
    status: HeadStatusSettings = HeadStatusSettings()
    smoothing: HeadSmoothingSettings = setting(
        HeadSmoothingSettings(), "--smooth: a track of its own, in which every frame knows all others"
    )
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
    frames: Annotated[int, Field(ge=1, le=30)] = setting(
        5, "n: it is detected in so many frames, and they are adjusted together"
    )
    eye_distance_px: Positive = setting(
        80.0, "faces are reduced or enlarged to it: patches have 16 x 16 pixels;"
    )
    largest_scale: Annotated[float, Field(ge=1.0, le=LARGEST_SCALE)] = setting(
        LARGEST_SCALE, "enlarged by no more; 1 leaves small faces as they are"
    )
    pixel_sd: Positive = setting(2.0, "a detected point is so much less exact than a tracked one")


class FaceModelSettings(Settings):
    """Which multilinear model; ``file`` is what ``head build-model`` writes, none is the shipped one."""

    file_keys: ClassVar[tuple[str, ...]] = ("file",)

    file: str | None = setting(
        None, "what head build-model writes; none is the model that is shipped", example="face.npz"
    )


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

    when: Literal["always", "start", "never"] = setting(
        "always", 'after every frame that allows it, only at the "start", or "never"'
    )
    whole: bool = setting(
        True, "after a first pass over the whole recording; the second one holds the person"
    )
    views: Annotated[int, Field(ge=2, le=200)] = setting(
        20, "n: of the frames kept those whose face directions spread most ..."
    )
    spread: Literal["directions", "angles"] = setting(
        "directions", '... or "angles": yaw and pitch, as printed (4.3.2)'
    )
    iterations: Count = setting(5, "of poses alone, then of all; at the start")
    start_iterations: Count = setting(10, "... so many")
    average: Count = setting(15, "N_s: the person is the mean of so many adjustments (4.36)")
    bound: Positive = setting(4.0, "no deformation or person is further than this from the mean (4.35, 4.37)")
    prior: NotNegative = setting(2.0, "weight of s and a being near the mean, beside the boxes")
    offsets: bool = setting(
        True, "what the camera sees of a point lies beside the model's vertex, always alike"
    )
    huber: Positive = setting(1.5, "points that err by more, in their standard deviations, pull no harder")
    pixel_sd: PointSettings = setting(
        PointSettings(eyes=1.4, mouth=3.0, nostrils=2.4, brows=4.0),
        "how exactly a point is tracked, pixels, twice: in like frames it errs alike",
    )
    whole_share: Annotated[float, Field(ge=0.05, le=1.0)] = setting(
        0.35, "of pixel_sd below: over a whole recording points err less alike"
    )
    facing_deg: Positive = setting(45.0, "adjusted with are frames that face the camera so nearly ...")
    score: Fraction = setting(0.6, "... and look like the face")
    gates_points: bool = setting(
        False, "true: points are recalculated in such frames alone, as printed (4.4.3)"
    )
    neutral_mm: Positive = setting(
        6.0, "... and whose face is deformed less than this (length of 3K numbers)"
    )


class MonoStatusSettings(HeadStatusSettings):
    """When a head counts as tracked **[ours]**; see ``HeadStatusSettings``.

    A blink changes four of ten points: a frame counts with a lower score than a stereo tracker's. A score
    below ``check_below`` is compared with what begins where the whole face went, and if that is below it,
    too, with that of a face detected anew.
    """

    tracking_above: Fraction = setting(
        0.45, "mean correlation of the visible points; below it a frame is lost (a blink changes 4 of 10)"
    )
    lost_after_frames: Count = setting(1, "after so many the face is searched for again")
    check_below: Fraction = setting(
        0.7, "below it the whole face's motion may take over, or a face detected anew"
    )


class PersonSettings(Settings):
    """What is known of the person before anything is seen; of the first, if there are several **[ours]**.

    ``interpupillary_mm`` is the distance of the pupils of somebody who looks far away, measured with the
    standard deviation ``interpupillary_sd_mm``. See ``head.tracker.person``.
    """

    interpupillary_mm: Annotated[float, Field(ge=40.0, le=90.0)] | None = setting(
        None, "distance of the pupils of somebody who looks far away; it tells the scale", example=63.0
    )
    interpupillary_sd_mm: NotNegative = setting(0.5, "how exactly that was measured")


class SkinSettings(Settings):
    """The skin between the feature points, which tells a second pass where a head is, too **[ours]**.

    ``use`` without: the feature points alone.
    """

    use: bool = setting(True, "false: the feature points alone")


class HeadMonoConfig(Settings):
    """Everything that a one-camera run depends on besides its recording and its seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("start.detection.model", "start.detection.features", "model.file")

    start: MonoInitialisationSettings = setting(MonoInitialisationSettings(), "when a face counts as found")
    model: FaceModelSettings = setting(FaceModelSettings(), "which faces there are, and how they deform")
    particles: ParticleSettings = ParticleSettings(count=750, kappa=0.2, sigma=1.0)
    refinement: RefinementSettings = setting(
        RefinementSettings(previous_likeness=1.0),
        "Gauss-Newton over pose, deformation and a residual per point",
    )
    adjustment: AdjustmentSettings = setting(
        AdjustmentSettings(), "bundle adjustment of the person and the last views (4.3)"
    )
    status: MonoStatusSettings = MonoStatusSettings()
    person: PersonSettings = setting(
        PersonSettings(), "what is known of the (first) person before anything is seen"
    )
    skin: SkinSettings = setting(
        SkinSettings(), "between the feature points; it tells a second pass where a head is, too"
    )
    smoothing: HeadSmoothingSettings = setting(
        HeadSmoothingSettings(velocity_mm=300.0, velocity_rad=2.0),
        "--smooth: a track of its own, in which every frame knows all others",
    )
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
