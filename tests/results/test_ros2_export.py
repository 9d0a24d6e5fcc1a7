"""An exported track of ROS 2 messages, read back by a library of others."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.results import ResultWriter, Status, read_result
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.export.export import export_file
from posetrack_cli.results.export.source import export_source
from posetrack_cli.results.messages import odometry
from support.results import CAMERA, RUN, SUBJECT, make_estimate, with_fields

FRAMES = 8
OTHER = replace(
    CAMERA,
    name="9 left/ü",
    camera_T_reference=((1.0, 0.0, 0.0, -118.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 5.0)),
)
NO_VELOCITY: dict[str, object] = {"pose_rate": None, "twist": None, "twist_variance": None}


def write(
    path: Path, estimates: list[Estimate], subject: Subject = SUBJECT, others: tuple[Camera, ...] = ()
) -> Path:
    with ResultWriter(path, subject, CAMERA, RUN, others=others) as writer:
        for estimate in estimates:
            writer.write(estimate)
        for estimate in reversed(estimates):
            writer.write_smoothed(estimate)
        writer.finish({})
    return path


def exported(path: Path, topic: str | None = None, **options: bool) -> dict[str, list[Any]]:
    out = path.with_name("ros2.mcap")
    export_file(export_source(read_result(path), topic, **options), "mcap", out, overwrite=True)
    found = defaultdict(list)
    with out.open("rb") as stream:
        for _, channel, message, decoded in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found[channel.topic].append(decoded)
            assert message.log_time == message.publish_time
    return found


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = [with_fields(make_estimate(i), **(NO_VELOCITY if i == 1 else {})) for i in range(FRAMES)]
    return write(tmp_path_factory.mktemp("result") / "r.mcap", made)


def xyz(value: Any) -> list[float]:
    return [value.x, value.y, value.z]


def test_every_topic_says_what_the_estimate_says(path: Path) -> None:
    found = exported(path)
    names = ("odometry", "joint_states", "points", "markers", "confidence", "status")
    assert sorted(found) == sorted(["/tf", "/camera/camera_info", *(f"/hand/{name}" for name in names)])
    assert {len(of) for of in found.values()} == {FRAMES}
    for i in range(FRAMES):
        estimate, poses = make_estimate(i), found["/hand/odometry"][i]
        stamp = poses.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == estimate.stamp_ns
        assert (poses.header.frame_id, poses.child_frame_id) == ("kinect", "hand")
        np.testing.assert_allclose(xyz(poses.pose.pose.position), estimate.position / 1e3, rtol=1e-12)
        orientation = poses.pose.pose.orientation
        assert [*xyz(orientation), orientation.w] == estimate.quaternion.tolist()
        cloud = np.frombuffer(found["/hand/points"][i].data, "<f4").reshape(-1, 3)
        np.testing.assert_allclose(cloud * 1e3, estimate.points, rtol=1e-6)  # single precision
        assert found["/hand/points"][i].row_step == 12 * len(estimate.points)
        assert found["/hand/confidence"][i].data == estimate.confidence
        assert found["/hand/status"][i].data == estimate.status.value
        assert found["/hand/joint_states"][i].position == pytest.approx(estimate.shape.tolist(), rel=0)
        expected = odometry(estimate, SUBJECT)
        assert list(poses.pose.covariance) == list(expected.pose_covariance)
    assert list(found["/hand/odometry"][1].twist.covariance) == [0.0] * 36, "no velocity is known"
    assert found["/hand/joint_states"][1].velocity == []
    assert len(found["/hand/joint_states"][2].velocity) == len(SUBJECT.shape_names)


def test_frames_lead_from_the_camera_to_every_point(path: Path) -> None:
    for message, i in zip(exported(path)["/tf"], range(FRAMES), strict=True):
        placed = {"kinect": np.zeros(3)}
        turned, estimate = np.eye(3), make_estimate(i)
        for each in message.transforms:
            shift = xyz(each.transform.translation)
            placed[each.child_frame_id] = placed[each.header.frame_id] + turned @ shift
            if each.child_frame_id == "hand":
                x, y, z, w = estimate.quaternion
                turned = np.array(
                    [
                        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
                    ]
                )
        found = [placed[f"hand/{name}"] for name in SUBJECT.point_names]
        np.testing.assert_allclose(np.array(found) * 1e3, estimate.points, atol=1e-9)


def test_markers_join_points_and_are_faint_while_lost(path: Path) -> None:
    found, bones = exported(path)["/hand/markers"], [(0, 1), (1, 2), (0, 3)]
    for i in range(FRAMES):
        estimate, (lines, balls) = make_estimate(i), found[i].markers
        ends = [estimate.points[end] / 1e3 for bone in bones for end in bone]
        np.testing.assert_allclose([xyz(point) for point in lines.points], ends, rtol=1e-12)
        np.testing.assert_allclose([xyz(point) for point in balls.points], estimate.points / 1e3, rtol=1e-12)
        assert (lines.type, balls.type, lines.id, balls.id) == (5, 7, 0, 1)
        assert (lines.color.a < 0.5) == (estimate.status is Status.LOST)
        assert lines.pose.orientation.w == 1.0 and lines.scale.x > 0.0 < balls.scale.z


def test_a_smoothed_track_has_topics_and_frames_of_its_own(path: Path) -> None:
    found = exported(path, "/smoothed/hand/estimate", lost=False)
    stamps = [message.header.stamp.nanosec for message in found["/smoothed/hand/odometry"]]
    tracked = [e.stamp_ns % 10**9 for i in range(FRAMES) if (e := make_estimate(i)).status is not Status.LOST]
    assert stamps == tracked, "in order, without the lost"
    assert found["/smoothed/hand/odometry"][0].child_frame_id == "smoothed_hand"
    assert "/hand/odometry" not in found


def test_further_cameras_have_names_that_ros_takes_and_a_place(tmp_path: Path) -> None:
    path = write(tmp_path / "r.mcap", [make_estimate(0)], replace(SUBJECT, name="head"), (OTHER,))
    found = exported(path)
    assert {topic for topic in found if "info" in topic} == {
        "/camera/camera/camera_info",
        "/camera/_9_left/_/camera_info",
    }
    (placed,) = [each for each in found["/tf"][0].transforms if each.child_frame_id == OTHER.name]
    assert placed.header.frame_id == "kinect"
    assert xyz(placed.transform.translation) == pytest.approx([0.118, 0.0, -0.005])
    assert "/head/joint_states" not in found, "a head's shape is no angles"


def test_the_file_is_one_of_ros2(path: Path) -> None:
    exported(path)
    with path.with_name("ros2.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}


def test_rosbags_reads_it_and_writes_the_same_bytes(path: Path) -> None:
    """By its own definitions of ROS 2 Humble, which are those in the file."""
    exported(path)
    types, count = get_typestore(Stores.ROS2_HUMBLE), 0
    with path.with_name("ros2.mcap").open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages():
            assert schema is not None
            decoded = types.deserialize_cdr(message.data, schema.name)
            again = bytes(types.serialize_cdr(decoded, schema.name))
            assert again.rstrip(b"\0") == message.data.rstrip(b"\0")  # it may pad the end
            assert types.generate_msgdef(schema.name, ros_version=2)[0].strip() == schema.data.decode()
            count += 1
    assert count == 8 * FRAMES
    with AnyReader([path.with_name("ros2.mcap")]) as reader:
        assert sum(1 for _ in reader.messages()) == count


def test_a_stamp_that_ros_has_no_room_for_is_told(tmp_path: Path) -> None:
    late = with_fields(make_estimate(0), stamp_ns=(1 << 31) * 10**9)
    path = write(tmp_path / "r.mcap", [late])
    with pytest.raises(
        ResultError, match="stamp does not fit into a ROS message, found 2147483648000000000 ns"
    ):
        exported(path)
    assert [each.name for each in tmp_path.iterdir()] == ["r.mcap"]
