"""Metrics of hands: 21 joints, finger angles, comparison with depth images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.measuring.hand_metrics import STATE_PARTS, WITHIN_MM, hand_metrics
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, Metric
from posetrack_cli.evaluation.measuring.pose_metrics import INSIDE_50, INSIDE_90
from posetrack_cli.evaluation.measuring.subjects.kind import SubjectKind
from posetrack_cli.evaluation.reading.alignment import JointOffsets, OffsetFrame, remove_joint_offsets
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.hand.confidence import RIGHT_MM
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, FINGERS, JOINT_NAMES
from posetrack_cli.results.reader import Result

if TYPE_CHECKING:
    from posetrack_cli.recording.recording import Recording

FAR_MM = 40.0
"""Mean joint error above which the estimate is at another place or flipped."""
# Direction of the positive palm axes.
_PALM_AXES = {
    "x": "towards the thumb of a right hand",
    "y": "towards the wrist",
    "z": "out of the back of the hand",
}


def _within(threshold_mm: int, which: str) -> Metric:
    name = f"within_{threshold_mm}mm"
    meaning = (
        f"Share of the frames with ground truth, including missed ones, whose {which} joint error is below "
        f"{threshold_mm} mm."
    )
    if which == "mean":
        return Metric(f"frames_mean_{name}", "", meaning, better="higher", scalar=True, pooled=True)
    spoken = f"frames within {threshold_mm} mm"
    return Metric(f"frames_{name}", "", meaning, better="higher", scalar=True, spoken=spoken, pooled=True)


def _bias(axis: str, meaning: str) -> Metric:
    name = f"joint_bias_{f'{axis}_' if axis else ''}mm"
    return Metric(name, "mm", meaning, part="joint", better="neither" if axis else "lower", scalar=True)


def _without_offsets(
    result: Result, matched: Matched, frame: OffsetFrame
) -> tuple[Track, JointOffsets | None]:
    from posetrack_cli.evaluation.reading.recording_of import hand_of

    anatomy = hand_of(result).anatomy
    return remove_joint_offsets(matched.estimate, matched.truth, matched.pairs, anatomy, frame)


def _joints_by_pose(measures: Measures, result: Result, matched: Matched) -> None:
    from posetrack_cli.evaluation.measuring.hand_metrics import joints_by_pose
    from posetrack_cli.evaluation.reading.recording_of import anatomy_of

    joints_by_pose(measures, matched, lambda: anatomy_of(result))


def _inside(percent: int, half_width: float, prefix: str, spoken: str, stated: str) -> Metric:
    meaning = (
        f"Share of the true coordinates of {spoken} within +-{half_width:.3f} standard deviations, "
        f"propagated from those of the {stated}; {percent / 100:g} for independent Gaussian errors."
    )
    return Metric(
        f"{prefix}_inside_{percent}",
        "",
        meaning,
        "joint",
        "covariance",
        "neither",
        scalar=True,
        spoken=f"{spoken} inside {percent} % interval",
        pooled=True,
    )


def _compared(result: Result, recording: Recording, which: str) -> Mapping[str, FloatArray]:
    from posetrack_cli.evaluation.measuring.image_consistency import image_consistency

    return image_consistency(result, recording, which=which)


_METRICS = (
    Metric(
        "joint_error_mm",
        "mm",
        "Distance between estimated and true joint position, over frames (including lost ones) and joints.",
        "joint",
    ),
    Metric("joint_error_tracked_mm", "mm", "Joint error over the frames that are not lost."),
    Metric(
        "finger_error_mm",
        "mm",
        "Joint error over the joints of one finger, or of all fingers (all joints except the wrist).",
        "finger",
    ),
    Metric("fingertip_error_mm", "mm", "Joint error over the fingertips."),
    Metric("largest_joint_error_mm", "mm", "Largest joint error of each frame."),
    *(_within(threshold, "largest") for threshold in WITHIN_MM),
    *(_within(threshold, "mean") for threshold in WITHIN_MM),
    _bias("", "Norm of a joint's mean error vector over tracked frames; mean norm for all joints."),
    *(
        _bias(axis, f"Mean joint error along the palm's {axis} axis ({towards}) over tracked frames.")
        for axis, towards in _PALM_AXES.items()
    ),
    Metric(
        "wrist_position_mm",
        "mm",
        "Distance between estimated and true wrist position.",
        spoken="wrist position error",
    ),
    Metric(
        "wrist_rotation_deg",
        "deg",
        "Angle of the rotation between estimated and true hand orientation, 0 to 180.",
        spoken="wrist rotation error",
    ),
    Metric("angle_error_deg", "deg", "Absolute error of the finger angles, over frames and angles.", "angle"),
    Metric(
        "angle_velocity_error_deg_s",
        "deg/s",
        "Absolute error of the finger angle velocities, over frames and angles.",
        "angle",
        "velocity",
    ),
    Metric(
        "joint_velocity_error_mm_s",
        "mm/s",
        "Norm of the difference between a joint's estimated velocity and the central difference of its true "
        "positions.",
        "joint",
        "velocity",
    ),
    *(
        _inside(percent, half_width, *about)
        for about in (("joint", "joints", "pose"), ("joint_velocity", "joint velocities", "velocity"))
        for percent, half_width in ((50, INSIDE_50), (90, INSIDE_90))
    ),
)

HAND = SubjectKind(
    name="hand",
    body="Wrist",
    metrics=_METRICS,
    measure=hand_metrics,
    parts={
        "joint": JOINT_NAMES,
        "finger": FINGERS,
        "angle": ANGLE_NAMES,
        "state": STATE_PARTS,
    },
    point_part="joint",
    shape_part="angle",
    point_metric="joint_error_mm",
    key_figures=(
        "coverage",
        "joint_error_mm.mean",
        "joint_error_mm.p95",
        "fingertip_error_mm.mean",
        "largest_joint_error_mm.median",
        "wrist_position_mm.mean",
        "wrist_rotation_deg.mean",
        "angle_error_deg.mean",
    ),
    studied_figures=(
        "frames_within_40mm",
        "velocity_error_mm_s.mean",
        "angular_velocity_error_deg_s.mean",
        "angle_velocity_error_deg_s.mean",
        "inside_90",
        "jitter_mm.mean",
        "ms_per_frame.median",
    ),
    lead=("joint_error_mm",),
    readings=("joint_error_mm", "largest_joint_error_mm"),
    worst_by=("joint_error_mm",),
    right={"joint_error_mm": RIGHT_MM},
    far={"joint_error_mm": FAR_MM},
    measure_of_result=_joints_by_pose,
    remove_offsets=_without_offsets,
    compare_images=_compared,
)
