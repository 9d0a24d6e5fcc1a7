"""Joint errors against truth, on results small enough to work out by hand."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.joints import joint_errors
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import (
    ESTIMATE_SCHEMA_NAME,
    Estimate,
    ResultWriter,
    Status,
    Subject,
    estimate_to_json,
)

CAMERA = Camera(512, 424, 365.0, 365.0, 255.5, 211.5)
SUBJECT = Subject("hand", "camera", (), ("wrist", "tip"), (-1, 0))
AT_ORIGIN = [[0.0, 0.0, 600.0], [0.0, 100.0, 600.0]]
Points = list[list[float]]


def estimate(stamp_ns: int, points: Points, status: Status = Status.TRACKING) -> Estimate:
    nothing = np.zeros(6)
    return Estimate(
        frame_index=stamp_ns,
        stamp_ns=stamp_ns,
        status=status,
        confidence=1.0,
        position=np.zeros(3),
        quaternion=np.array([0.0, 0.0, 0.0, 1.0]),
        shape=np.empty(0),
        pose_rate=np.zeros(7),
        twist=nothing,
        pose_variance=nothing,
        twist_variance=nothing,
        points=np.array(points),
        effective_sample_size=1.0,
        resampled=False,
    )


def truth(stamp_ns: int, points: Points, topic: str = "/truth/hand/estimate") -> TruthMessage:
    data = estimate_to_json(estimate(stamp_ns, points))
    return TruthMessage(topic, ESTIMATE_SCHEMA_NAME, "jsonschema", b"{}", "json", stamp_ns, data)


def moved(x: float, y: float, z: float) -> Points:
    """Both joints moved."""
    return (np.array(AT_ORIGIN) + np.array([x, y, z])).tolist()


def result(
    folder: Path, estimates: list[Estimate], true: Mapping[int, Points], topic: str = "/truth/hand/estimate"
) -> Path:
    path = folder / "result.mcap"
    with ResultWriter(path, SUBJECT, CAMERA, {}) as writer:
        for stamp_ns, points in true.items():
            writer.add_truth(truth(stamp_ns, points, topic))
        for one in estimates:
            writer.write(one)
        writer.finish({})
    return path


def test_distances_are_euclidean_joint_by_joint(tmp_path: Path) -> None:
    tip_bent = [AT_ORIGIN[0], [0.0, 100.0, 588.0]]
    path = result(
        tmp_path,
        [estimate(10, moved(3.0, 4.0, 0.0)), estimate(20, tip_bent)],
        {10: AT_ORIGIN, 20: AT_ORIGIN},
    )
    errors = joint_errors(path)
    np.testing.assert_allclose(errors.distances_mm, [[5.0, 5.0], [0.0, 12.0]])
    assert errors.unmatched == 0 and errors.lost.tolist() == [False, False]


def test_only_equal_stamps_are_compared_and_the_others_counted(tmp_path: Path) -> None:
    estimates = [estimate(stamp, moved(float(stamp), 0.0, 0.0)) for stamp in (10, 20, 30, 41)]
    # 41 has no truth within a nanosecond, 10 none at all; 15 and 40 are truth without an estimate
    path = result(tmp_path, estimates, {15: AT_ORIGIN, 20: AT_ORIGIN, 30: AT_ORIGIN, 40: AT_ORIGIN})
    errors = joint_errors(path)
    np.testing.assert_allclose(errors.distances_mm, [[20.0, 20.0], [30.0, 30.0]])
    assert errors.unmatched == 2 and len(errors.lost) == 2


def test_lost_frames_are_counted_and_their_errors_too(tmp_path: Path) -> None:
    path = result(
        tmp_path,
        [
            estimate(10, moved(2.0, 0.0, 0.0)),
            estimate(20, moved(0.0, 0.0, 400.0), Status.LOST),
            estimate(30, moved(0.0, 6.0, 0.0), Status.REINITIALISED),
            estimate(99, AT_ORIGIN, Status.LOST),  # no truth: in neither count
        ],
        {10: AT_ORIGIN, 20: AT_ORIGIN, 30: AT_ORIGIN},
    )
    errors = joint_errors(path)
    assert errors.lost.tolist() == [False, True, False]
    np.testing.assert_allclose(errors.distances_mm[:, 0], [2.0, 400.0, 6.0])


def test_the_summary_s_numbers(tmp_path: Path) -> None:
    statuses = {10: Status.TRACKING, 20: Status.LOST, 30: Status.TRACKING}
    estimates = [estimate(s, moved(float(s), 0.0, 0.0), status) for s, status in statuses.items()]
    path = result(tmp_path, [*estimates, estimate(40, AT_ORIGIN)], dict.fromkeys(statuses, AT_ORIGIN))
    # of 10 10 20 20 30 30 mm the 95th percentile lies a quarter beyond place 4.75: between the last two, 30
    assert joint_errors(path).summary() == (
        "joint error over 3 frames: mean 20.0 mm, median 20.0 mm, 95 % below 30.0 mm; 1 lost, 1 without truth"
    )


def test_a_result_without_truth_is_refused(tmp_path: Path) -> None:
    path = result(tmp_path, [estimate(10, AT_ORIGIN)], {})
    with pytest.raises(ResultError, match="no estimates on topic '/truth/hand/estimate'"):
        joint_errors(path)


def test_the_truth_of_another_subject_is_none(tmp_path: Path) -> None:
    path = result(tmp_path, [estimate(10, AT_ORIGIN)], {10: AT_ORIGIN}, "/truth/head/estimate")
    with pytest.raises(ResultError, match="no estimates on topic '/truth/hand/estimate'"):
        joint_errors(path)


def test_truth_at_none_of_the_stamps_is_refused(tmp_path: Path) -> None:
    path = result(tmp_path, [estimate(10, AT_ORIGIN)], {11: AT_ORIGIN})
    with pytest.raises(ResultError, match="no truth at any of the stamps"):
        joint_errors(path)


def test_truth_of_other_joints_is_refused(tmp_path: Path) -> None:
    path = result(tmp_path, [estimate(10, AT_ORIGIN)], {10: [*AT_ORIGIN, [0.0, 0.0, 1.0]]})
    with pytest.raises(ResultError, match=r"truth has other joints.*found 3.*expected 2"):
        joint_errors(path)
