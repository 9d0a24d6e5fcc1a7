"""The head trackers' configuration.

``configs/head-stereo.toml`` and ``configs/head-mono.toml`` state these defaults with their reasons.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from posetrack_cli.configuration import Settings
from posetrack_cli.tracking.confidence import PROBABLY

# Wider than any head, camera or time, and narrow enough that no arithmetic on them overflows.
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Triple = tuple[Positive, Positive, Positive]


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

    A point found in one image is matched in another if its correlation reaches ``correlation`` and it is
    found again, on the way back, within ``return_mm``; ``matched_points`` must be. Points in space must fall
    within ``reprojection_px`` of their pixels and lie like a face's: a root mean square of at most
    ``deviation`` standard deviations from an average face of ``least_size`` to ``most_size`` times its size.
    """

    detection: DetectionSettings = DetectionSettings()
    correlation: Fraction = 0.5
    return_mm: Positive = 4.0
    matched_points: Annotated[int, Field(ge=6, le=10)] = 7
    reprojection_px: Positive = 3.0
    deviation: Positive = 1.1
    least_size: Positive = 0.7
    most_size: Positive = 1.3


class PointSettings(Settings):
    """One number for each kind of feature point, mm."""

    eyes: Positive
    mouth: Positive
    nostrils: Positive
    brows: Positive


class ModelSettings(Settings):
    """How the face may deform, and how its model is learnt while tracking (thesis, 3.2.4).

    ``components`` is B. The first ``rigid_frames`` frames are tracked with a rigid face, whose mean shape
    moves towards what is measured at ``mean_rate`` a frame **[ours]**; with ``rigid_phase = "printed"`` they
    are tracked with the shape that was found, and learnt from as all others (3.4); the mean is then that of
    all frames that face the camera, from the shape found on (3.20). A deformation is learnt from a frame
    where the face is turned from the camera by less than ``facing_deg``, the shape differs from the mean by
    ``least_mm`` to ``most_mm`` (the length of its 3K numbers) and every point correlates above
    ``correlation``. Shapes are laid on the mean by points that move little: ``expression_mm`` is how far a
    kind moves in expressions. They are laid on it where they differ from the model's by ``align_above_mm``.
    """

    kind: Literal["deformable", "rigid"] = "deformable"
    components: Annotated[int, Field(ge=1, le=20)] = 5
    rigid_frames: Annotated[int, Field(ge=0)] = 120
    rigid_phase: Literal["mean", "printed"] = "mean"
    mean_rate: Fraction = 0.02
    facing_deg: Positive = 25.0
    least_mm: NotNegative = 3.0
    most_mm: Positive = 40.0
    correlation: Fraction = 0.5
    align_above_mm: NotNegative = 0.0
    expression_mm: PointSettings = PointSettings(eyes=1.0, mouth=8.0, nostrils=1.5, brows=8.0)


class RefinementSettings(Settings):
    """The refinement of pose, deformation and points after the particle filter **[ours]**.

    Patches are compared as vectors of zero mean and unit norm; each comparison has a weight (``reference``,
    ``previous``, ``between_cameras``, ``keyframe``), times the point's visibility (a cosine) to the power
    ``visibility_power``, times ((ncc - ``correlation_floor``) / (1 - floor)) ^ ``correlation_power``.
    The comparison with the frame before also counts by the point's best correlation with a stored template,
    to the power ``previous_likeness``: a point that left its feature must not follow what it left it for.
    ``patch_sd`` is the standard deviation of one such vector's difference per unit of weight. A point's
    residual is Student-t of ``degrees_of_freedom`` with the sd of ``residual_mm``; in the recalculation of
    points, with the pose held, of ``recalculation_mm``; of a shape that was just found of ``settling_mm``.
    Without ``joint`` the filter's pose stays. ``recalculation = "printed"`` is the thesis's: raw
    intensities, ``rho`` and ``epsilon`` of (3.3) and (3.5).
    """

    joint: bool = True
    iterations: Count = 3
    recalculation_iterations: Count = 2
    reference: NotNegative = 1.0
    keyframe: NotNegative = 2.0
    previous: NotNegative = 1.0
    between_cameras: NotNegative = 4.3
    correlation_floor: Fraction = 0.2
    correlation_power: NotNegative = 6.0
    previous_likeness: NotNegative = 0.0
    patch_sd: Positive = 0.4
    visibility_power: Positive = 0.3
    degrees_of_freedom: Positive = 4.0
    residual_mm: PointSettings = PointSettings(eyes=0.8, mouth=2.5, nostrils=3.0, brows=0.9)
    recalculation_mm: PointSettings = PointSettings(eyes=1.0, mouth=12.0, nostrils=2.5, brows=2.0)
    settling_mm: Positive = 20.0
    recalculation: Literal["joint", "printed"] = "joint"
    rho: NotNegative = 4.0
    epsilon: NotNegative = 2000.0
    keyframe_deg: Positive = 10.0
    keyframe_neutral_mm: Positive = 3.0
    keyframe_correlation: Fraction = 0.7


class ParticleSettings(Settings):
    """The particle filter over pose and deformation (thesis, 3.3).

    ``floor_mm`` (camera x, y, z) and ``floor_rad`` (about camera x, y, z: pitch, yaw, roll) are the least
    standard deviations of what a pose does beyond its prediction within a thirtieth of a second; ``gain``
    times the way that the present velocity goes in that time replaces them where it is larger. ``kappa`` is
    the same for the deformation, in units of its deviations mu.

    ``weighting`` is by patches with ``patch_noise`` **[ours]**, or as printed, (3.27) with ``sigma``, which
    hardly tells a pixel from none. ``local_radius`` is d of (3.29), in units of the diffusion's standard
    deviations. ``sampling`` is halfway partitioned sampling with the weights that it needs to keep its target
    **[ours]**, or as printed. ``gap_max_s`` is the longest time without a frame that is predicted, and counts
    for all longer ones; ``speed_mm_s`` and ``speed_rad_s`` are the same for velocities, so that one wild
    frame is not followed.
    """

    count: Count = 1000
    weighting: Literal["patches", "printed"] = "patches"
    patch_noise: Positive = 0.35
    sigma: Positive = 3.0
    kappa: Positive = 0.5
    floor_mm: tuple[Positive, Positive, Positive] = (0.8, 0.8, 1.5)
    floor_rad: tuple[Positive, Positive, Positive] = (0.008, 0.010, 0.006)
    gain: NotNegative = 0.4
    local_radius: Positive = 6.0
    sampling: Literal["weighted", "printed"] = "weighted"
    resampling: Literal["systematic", "multinomial", "residual", "stratified"] = "systematic"
    lookup: Literal["bilinear", "nearest"] = "bilinear"
    gap_max_s: Positive = 0.2
    speed_mm_s: Positive = 2000.0
    speed_rad_s: Positive = 12.0


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


class HeadVelocitySettings(Settings):
    """The velocity that a result states, from the tracked poses up to the next frame's **[ours]**.

    ``acceleration_mm`` and ``acceleration_rad`` are the square root of the density of a head's acceleration,
    ``pose_mm`` and ``pose_rad`` the standard deviations of its poses' errors from frame to frame. See
    ``tracking/velocity.py``.
    """

    acceleration_mm: Positive = 40.0
    acceleration_rad: Positive = 0.5
    pose_mm: Positive = 0.1
    pose_rad: Positive = 0.001


class HeadSmoothingSettings(Settings):
    """The smoothed track of ``--smooth`` **[ours]**; see ``head.smoothing``.

    A head's velocity wanders by ``velocity_mm`` and ``velocity_rad`` in the square root of a second, and by
    ``gain`` times its speed. Deformations are explained as far as ``deformation`` times their standard
    deviations go, 0 not at all; beside that points move in expressions by ``expression_mm``. They are found
    to ``noise_mm`` across the ray and, by several cameras, to ``depth_noise_mm`` along it. What they leave is
    Student-t with ``freedom``, and what a frame says counts by ``share``, as the errors of its neighbours are
    like its own. Places of points in the face are smoothed over ``places_s`` (standard
    deviation). A head that is lost for no longer than ``bridge_s`` is bridged.
    """

    velocity_mm: Positive = 100.0
    velocity_rad: Positive = 0.3
    gain: NotNegative = 1.0
    deformation: NotNegative = 0.0
    expression_mm: PointSettings = PointSettings(eyes=0.3, mouth=5.0, nostrils=1.0, brows=2.0)
    noise_mm: Positive = 0.25
    depth_noise_mm: Positive = 0.5
    freedom: Positive = 4.0
    share: Annotated[float, Field(ge=1e-6, le=1.0)] = 0.1
    places_s: Annotated[float, Field(ge=1e-3, le=10.0)] = 0.05
    bridge_s: NotNegative = 0.5


class AccuracySettings(Settings):
    """What a whole track is wrong by, alike in all frames, and so no particle tells **[ours]**.

    ``position_mm`` (camera x, y, z) and ``rotation_deg`` (about the head's x, y, z: pitch, yaw, roll) are
    standard deviations of where a person's points are taken to be in the head. They are added to the
    variances that a result states. Those of several cameras are root mean squares of twelve rendered people.
    """

    position_mm: Triple = (2.6, 2.3, 3.3)
    rotation_deg: Triple = (2.3, 1.8, 1.4)


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
    refinement: RefinementSettings = RefinementSettings()
    status: HeadStatusSettings = HeadStatusSettings()
    accuracy: AccuracySettings = AccuracySettings()
    velocity: HeadVelocitySettings = HeadVelocitySettings()
    smoothing: HeadSmoothingSettings = HeadSmoothingSettings()
    run: RunSettings = RunSettings()
    output: HeadOutputSettings = HeadOutputSettings()


LARGEST_SCALE = 4.0
"""No image can be enlarged by more: faces whose eyes are 20 pixels apart are."""


class MonoInitialisationSettings(Settings):
    """When a face counts as found (thesis, 4.4.1).

    It is found when it was detected in ``frames`` frames (n). A detection is rejected where the slopes of the
    K/2 segments between left and right points differ by more than ``slope_deg`` (standard deviation). The
    frames lie no more than ``span_s`` apart, so that a face seen now and then is not made one **[ours]**.
    Images in which the eyes are farther apart than ``eye_distance_px`` are reduced to it, and about a face
    with eyes less far apart they are enlarged, ``largest_scale`` times at most **[ours]**.
    Points count as detected with ``pixel_sd`` times the noise of tracked ones. They must lie within
    ``residual`` (root mean square, of the eyes' distance in the image) of an average face's, and once
    adjusted of the person's **[ours]**.
    """

    detection: DetectionSettings = DetectionSettings(points="learned", least_point_score=0.6)
    frames: Annotated[int, Field(ge=1, le=30)] = 5
    slope_deg: Positive = 4.0
    span_s: Positive = 2.0
    eye_distance_px: Positive = 80.0
    largest_scale: Annotated[float, Field(ge=1.0, le=LARGEST_SCALE)] = LARGEST_SCALE
    pixel_sd: Positive = 2.0
    residual: Positive = 0.12


class FaceModelSettings(Settings):
    """Which multilinear model; ``file`` is what ``head build-model`` writes, none is the shipped one."""

    file_keys: ClassVar[tuple[str, ...]] = ("file",)

    file: str | None = None


class OffsetSettings(Settings):
    """Standard deviations (x, y, z) mm in the head's frame of the constant offset of each kind of point."""

    eyes: Triple = (1.8, 1.4, 2.0)
    mouth: Triple = (2.5, 1.4, 2.0)
    nostrils: Triple = (2.8, 1.4, 5.0)
    brows: Triple = (2.1, 1.4, 3.5)


class AdjustmentSettings(Settings):
    """The bundle adjustment (thesis, 4.3).

    ``when``: after every frame that faces the camera, only at the start, or never (the mean person).
    ``whole``: the first of two passes ends with an adjustment of the person over the whole recording, which
    the second one holds; without, the second one goes on adjusting **[ours]**.
    ``views`` is n, chosen by the ``spread`` of face directions, or of their angles as printed (4.3.2);
    ``iterations`` of each of the two stages, ``start_iterations`` at the start. Boxes:
    ``pose_mm`` (camera x, y, z) and ``pose_rad`` (about camera x, y, z), lambda_p; ``deformation`` and
    ``identity``, lambda_a and lambda_s in standard deviations about the start, and ``bound`` standard
    deviations about the mean. The identity's start is the mean of the last ``average`` adjustments (N_s).

    **[ours]** ``prior`` weighs the squares of whitened s and a beside the boxes, ``offsets`` adds the
    constant offsets of points with the deviations ``offset_mm``, ``huber`` bounds the influence of a point
    in units of its ``pixel_sd``, which is twice what a point errs by in a frame: points err alike in like
    frames. Over a whole recording, and of a person whom that has told, it is ``whole_share`` of that: frames
    of many directions err less alike. A frame is adjusted with if the face is turned from the camera by less
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
    pose_mm: Triple = (20.0, 20.0, 60.0)
    pose_rad: Triple = (0.2, 0.2, 0.1)
    deformation: Positive = 1.0
    identity: Positive = 0.5
    bound: Positive = 4.0
    prior: NotNegative = 2.0
    offsets: bool = True
    offset_mm: OffsetSettings = OffsetSettings()
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
    too, with that of a face detected anew, every ``check_every_s`` at most.
    """

    tracking_above: Fraction = 0.45
    lost_after_frames: Count = 1
    check_below: Fraction = 0.7
    check_every_s: Positive = 0.5


class OneCameraAccuracySettings(AccuracySettings):
    """The same of one camera, which does not see how large a head is **[ours]**.

    ``scale`` is the standard deviation of the logarithm of all lengths, with which the place on the ray errs.
    Chosen on twelve people, ten of whom were tracked with what was learned from the others.
    """

    scale: NotNegative = 0.035
    position_mm: Triple = (1.0, 1.0, 3.0)
    rotation_deg: Triple = (1.7, 1.1, 0.45)


class PersonSettings(Settings):
    """What is known of the person before anything is seen; of the first, if there are several **[ours]**.

    ``interpupillary_mm`` is the distance of the pupils of somebody who looks far away, measured with the
    standard deviation ``interpupillary_sd_mm``; the middles of eyes' corners, where they are followed, tell
    the same distance to ``corners_sd_mm``, by nine of ten people of the study. See ``head.tracker.size``.
    """

    interpupillary_mm: Annotated[float, Field(ge=40.0, le=90.0)] | None = None
    interpupillary_sd_mm: NotNegative = 0.5
    corners_sd_mm: Positive = 1.1


class SkinSettings(Settings):
    """The skin between the feature points, which tells a second pass where a head is, too **[ours]**.

    ``use`` without: the feature points alone. The first pass keeps a frame every ``every_s``, and up to four
    times as many while the head turns by ``turned_deg`` from one to the next; ``views`` at most (of more
    every second goes, and the time doubles). In each of them up to ``points`` corners of skin are chosen,
    ``distance_mm`` apart, and looked for in ``linked`` views that are near in time and as many that are
    turned alike; ``rounds`` times poses and points are adjusted to what was found, in ``steps``. A frame is
    compared with ``near`` and ``alike`` of them. The skin's poses err by about ``error_deg``; they count
    nothing with ``least_points`` found, and in full from ``enough_points`` on.
    """

    use: bool = True
    every_s: Positive = 0.25
    turned_deg: Positive = 10.0
    views: Annotated[int, Field(ge=4, le=400)] = 120
    points: Annotated[int, Field(ge=1, le=200)] = 40
    distance_mm: Positive = 9.0
    linked: Annotated[int, Field(ge=1, le=50)] = 6
    rounds: Annotated[int, Field(ge=1, le=10)] = 2
    steps: Annotated[int, Field(ge=1, le=50)] = 8
    near: Annotated[int, Field(ge=0, le=20)] = 2
    alike: Annotated[int, Field(ge=0, le=20)] = 1
    error_deg: Positive = 1.5
    least_points: Annotated[int, Field(ge=6)] = 15
    enough_points: Annotated[int, Field(ge=7)] = 60


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
    accuracy: OneCameraAccuracySettings = OneCameraAccuracySettings()
    skin: SkinSettings = SkinSettings()
    velocity: HeadVelocitySettings = HeadVelocitySettings(
        acceleration_mm=90.0, acceleration_rad=0.8, pose_mm=0.3, pose_rad=0.003
    )
    smoothing: HeadSmoothingSettings = HeadSmoothingSettings(
        velocity_mm=300.0,
        velocity_rad=2.0,
        deformation=1.0,
        expression_mm=PointSettings(eyes=0.5, mouth=1.2, nostrils=0.9, brows=1.5),
    )
    run: RunSettings = RunSettings(passes=2)
    output: HeadOutputSettings = HeadOutputSettings()
