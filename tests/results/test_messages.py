from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from posetrack_cli.errors import ResultError
from posetrack_cli.results import ResultWriter, Status
from posetrack_cli.results.messages import (
    frame_transforms,
    joint_states,
    odometry,
)
from posetrack_cli.results.scene import LOST_ALPHA, SceneEncoder, _delimited
from support.results import CAMERA, RUN, SUBJECT, make_estimate, make_vertices, with_fields

ROUNDING = 1e-12  # of a few float64 products of numbers up to 1e3, relative


def xyz(message: object) -> np.ndarray:
    return np.array([message.x, message.y, message.z])


def rotation_of(index: int) -> Rotation:
    return Rotation.from_quat(make_estimate(index).quaternion)


def test_odometry_places_the_body_in_metres() -> None:
    estimate = make_estimate(5)
    message = odometry(estimate, SUBJECT)
    assert (message.frame_id, message.body_frame_id) == ("kinect", "hand")
    assert message.timestamp.ToNanoseconds() == estimate.stamp_ns
    np.testing.assert_allclose(xyz(message.pose.position) * 1e3, estimate.position, rtol=ROUNDING)
    assert message.pose.orientation.w == estimate.quaternion[3]


def test_odometry_gives_the_linear_velocity_in_the_body_frame() -> None:
    estimate = make_estimate(5)
    message = odometry(estimate, SUBJECT)
    expected = rotation_of(5).inv().apply(estimate.twist[:3]) * 1e-3
    np.testing.assert_allclose(xyz(message.linear_velocity), expected, rtol=ROUNDING)
    np.testing.assert_array_equal(xyz(message.angular_velocity), estimate.twist[3:6])


def test_odometry_covariances_are_of_the_rotated_samples() -> None:
    """A covariance is E[x x^T]: rotate the columns of a square root with scipy and multiply out."""
    estimate = make_estimate(5)
    message = odometry(estimate, SUBJECT)
    rotation = rotation_of(5)
    linear = rotation.inv().apply(np.diag(np.sqrt(estimate.twist_variance[:3]))) * 1e-3
    angular = rotation.apply(np.diag(np.sqrt(estimate.pose_variance[3:6])))
    velocity = np.array(message.velocity_covariance).reshape(6, 6)
    pose = np.array(message.pose_covariance).reshape(6, 6)
    np.testing.assert_allclose(velocity[:3, :3], linear.T @ linear, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(velocity[3:, 3:], np.diag(estimate.twist_variance[3:6]), rtol=ROUNDING)
    np.testing.assert_allclose(pose[:3, :3], np.diag(estimate.pose_variance[:3]) * 1e-6, rtol=ROUNDING)
    np.testing.assert_allclose(pose[3:, 3:], angular.T @ angular, rtol=1e-9, atol=1e-12)
    assert not velocity[:3, 3:].any()
    assert not pose[:3, 3:].any()


def test_transforms_chain_from_the_camera_to_every_point() -> None:
    estimate = make_estimate(8)
    frames = {"kinect": (Rotation.identity(), np.zeros(3))}
    for transform in frame_transforms(estimate, SUBJECT).transforms:
        rotation, origin = frames[transform.parent_frame_id]
        q = transform.rotation
        child = rotation * Rotation.from_quat([q.x, q.y, q.z, q.w])
        frames[transform.child_frame_id] = (child, origin + rotation.apply(xyz(transform.translation)))
        assert transform.timestamp.ToNanoseconds() == estimate.stamp_ns
    assert set(frames) == {"kinect", "hand"} | {f"hand/{name}" for name in SUBJECT.point_names}
    for name, point in zip(SUBJECT.point_names, estimate.points, strict=True):
        np.testing.assert_allclose(frames[f"hand/{name}"][1] * 1e3, point, atol=1e-9)


def test_transforms_follow_the_parents() -> None:
    parents = {
        t.child_frame_id: t.parent_frame_id for t in frame_transforms(make_estimate(0), SUBJECT).transforms
    }
    assert parents["hand/wrist"] == "hand"
    assert parents["hand/index_pip"] == "hand/index_mcp"


def test_joint_states_hold_angles_and_their_rates() -> None:
    estimate = make_estimate(2)
    joints = joint_states(estimate, SUBJECT).joints
    assert tuple(joint.name for joint in joints) == SUBJECT.shape_names
    assert [joint.position for joint in joints] == estimate.shape.tolist()
    assert [joint.velocity for joint in joints] == estimate.twist[6:].tolist()


def test_a_velocity_that_is_not_known_is_in_no_message() -> None:
    estimate = with_fields(make_estimate(5), pose_rate=None, twist=None, twist_variance=None)
    message = odometry(estimate, SUBJECT)
    assert not message.HasField("linear_velocity")
    assert not message.HasField("angular_velocity")
    assert (len(message.velocity_covariance), len(message.pose_covariance)) == (0, 36)
    joints = joint_states(estimate, SUBJECT).joints
    assert [joint.position for joint in joints] == estimate.shape.tolist()
    assert not any(joint.HasField("velocity") for joint in joints)


def plain_scene(stamp_ns: int, vertices: np.ndarray, alpha: float) -> SceneUpdate:
    """The same update, one protobuf object at a time."""
    update = SceneUpdate()
    entity = update.entities.add(frame_id="kinect", id="hand")
    entity.timestamp.FromNanoseconds(stamp_ns)
    entity.lifetime.FromNanoseconds(0)
    primitive = entity.triangles.add()
    primitive.pose.position.SetInParent()
    primitive.pose.orientation.w = 1.0
    for x, y, z in (vertices * 1e-3).tolist():
        primitive.points.add(x=x, y=y, z=z)
    color = primitive.color
    color.r, color.g, color.b, color.a = *SUBJECT.colour[:3], alpha
    primitive.indices.extend(SUBJECT.triangles.ravel().tolist())
    return update


@pytest.mark.parametrize("count", [4, 5, 400, 5000])
@pytest.mark.parametrize(("status", "share"), [(Status.TRACKING, 1.0), (Status.LOST, LOST_ALPHA)])
def test_scene_assembled_on_the_wire_equals_protobufs_own(count: int, status: Status, share: float) -> None:
    stamp = 1_500_000_000_123_456_789
    vertices = make_vertices(3, count)
    wire = SceneEncoder(SUBJECT).encode(stamp, status, vertices)
    plain = plain_scene(stamp, vertices, SUBJECT.colour[3] * share)
    assert SceneUpdate.FromString(wire) == plain
    assert wire == plain.SerializeToString(deterministic=True)


@pytest.mark.parametrize("length", [0, 1, 127, 128, 16383, 16384, 2097152])
def test_lengths_are_varints_also_at_their_boundaries(length: int) -> None:
    """SceneUpdate.entities in front of an entity that has only an id: the length of all is known."""
    body = b"\x00" * length
    field = _delimited(b"\x12", body)
    expected = 0
    for shift, byte in enumerate(field[1 : len(field) - length]):
        expected |= (byte & 0x7F) << (7 * shift)
    assert expected == length


def test_scene_refuses_vertices_that_do_not_cover_the_triangles() -> None:
    with pytest.raises(ResultError, match=r"mesh has the wrong shape, found \(3, 3\), expected \(4, 3\)"):
        SceneEncoder(SUBJECT).encode(0, Status.TRACKING, make_vertices(0, 3))


def test_scene_refuses_nan() -> None:
    vertices = make_vertices(0)
    vertices[1, 1] = np.nan
    with pytest.raises(ResultError, match="mesh is not finite"):
        SceneEncoder(SUBJECT).encode(0, Status.TRACKING, vertices)


def test_messages_of_a_file_decode_with_the_schemas_in_it(tmp_path: Path) -> None:
    estimate = with_fields(make_estimate(1), stamp_ns=5_000_000_001)
    with ResultWriter(tmp_path / "r.mcap", SUBJECT, CAMERA, RUN) as writer:
        writer.write(estimate, make_vertices(1))
        writer.finish({})
    with (tmp_path / "r.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        topics = {c.topic for c in reader.get_summary().channels.values()} - {"/hand/estimate"}
        decoded = {c.topic: (s.name, m, d) for s, c, m, d in reader.iter_decoded_messages(topics)}
    assert {topic: name for topic, (name, _, _) in decoded.items()} == {
        "/camera/calibration": "foxglove.CameraCalibration",
        "/tf": "foxglove.FrameTransforms",
        "/hand/odometry": "foxglove.Odometry",
        "/hand/joint_states": "foxglove.JointStates",
        "/hand/scene": "foxglove.SceneUpdate",
    }
    assert {(m.log_time, m.publish_time) for _, m, _ in decoded.values()} == {(5_000_000_001, 5_000_000_001)}
    triangles = decoded["/hand/scene"][2].entities[0].triangles[0]
    np.testing.assert_allclose([xyz(p) * 1e3 for p in triangles.points], make_vertices(1), rtol=ROUNDING)
