"""Where truth comes from: what a result carries, a recording, another result, a CSV file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli import tables
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, TruthError, UsageError
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.measuring.evaluation import Statistics
from posetrack_cli.evaluation.reading import truth_tables
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.evaluation.reading.truth import load_truth
from posetrack_cli.evaluation.reading.truth_tables import load_csv_track, open_table
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA, ESTIMATE_SCHEMA_NAME, estimate_to_json
from posetrack_cli.results.reader import Result, read_result
from support.metrics import SINGLE_MM
from support.truth import (
    FRAME_NS,
    HAND,
    HEAD,
    estimates,
    point_columns,
    pose_columns,
    write_csv,
    write_result,
)

METRES = 1e-12
"""Relative: millimetres go to metres and back, and through two rotations."""


def of(array: Any) -> FloatArray:
    assert array is not None
    return np.asarray(array)


def carried(own: Sequence[Estimate], topic: str = "/truth/hand/estimate") -> list[TruthMessage]:
    """Complete estimates as truth."""
    kind = (ESTIMATE_SCHEMA_NAME, "jsonschema", b"{}", "json")
    return [TruthMessage(topic, *kind, one.stamp_ns, estimate_to_json(one)) for one in own]


def result_of(tmp_path: Path, subject: Subject = HAND, truth: Sequence[TruthMessage] = ()) -> Result:
    return read_result(write_result(tmp_path / "result.mcap", subject, estimates(subject, 8, seed=9), truth))


def recording_of(path: Path, subject: Subject, own: Sequence[Estimate], topics: Sequence[str]) -> Path:
    """An MCAP file that is no result, with truth on some of its topics."""
    with McapSink(path) as sink:
        write_topics(sink, subject, own, topics)
        sink.finish()
    return path


def write_topics(sink: McapSink, subject: Subject, own: Sequence[Estimate], topics: Sequence[str]) -> None:
    kinds = {"odometry": messages.Odometry, "joint_states": messages.JointStates}
    makers: Any = {"odometry": messages.odometry, "joint_states": messages.joint_states}
    prefix = f"/truth/{subject.name}"
    channels = {name: sink.channel(f"{prefix}/{name}", kinds[name]) for name in topics if name in kinds}
    if "estimate" in topics:
        channels["estimate"] = sink.json_channel(f"{prefix}/estimate", ESTIMATE_SCHEMA_NAME, ESTIMATE_SCHEMA)
    for one in own:
        for name, channel in channels.items():
            data = (
                estimate_to_json(one)
                if name == "estimate"
                else makers[name](one, subject).SerializeToString(deterministic=True)
            )
            sink.write(channel, one.stamp_ns, data)
        sink.flush()


def truth_of(result: Result, path: Path | None = None, **options: Any) -> Track:
    truth = load_truth(result, path, **options)
    assert truth is not None
    return truth


def assert_same(track: Track, own: Sequence[Estimate], *names: str) -> None:
    assert track.stamp_ns.tolist() == [one.stamp_ns for one in own]
    for name in names:
        np.testing.assert_allclose(
            of(getattr(track, name)),
            [getattr(one, name) for one in own],
            rtol=METRES,
            atol=1e-9,
            err_msg=name,
        )


EVERYTHING = ("position", "quaternion", "shape", "twist", "points")


def test_the_truth_that_a_result_carries(tmp_path: Path) -> None:
    own = estimates(HAND, 8)
    track = truth_of(result_of(tmp_path, HAND, carried(own)))
    assert_same(track, own, *EVERYTHING)
    assert (track.name, track.subject) == ("ground truth", "hand")
    assert (track.shape_names, track.point_names) == (HAND.shape_names, HAND.point_names)
    assert (track.lost, track.pose_variance, track.confidence, track.cost) == (None,) * 4


def test_no_truth_is_none(tmp_path: Path) -> None:
    assert load_truth(result_of(tmp_path)) is None


def test_the_truth_of_another_subject_is_none(tmp_path: Path) -> None:
    other = carried(estimates(HAND, 3), "/truth/head/estimate")
    assert load_truth(result_of(tmp_path, HAND, other)) is None


def test_a_truth_without_velocity_has_none(tmp_path: Path) -> None:
    own = estimates(HAND, 4, velocity=False)
    track = truth_of(result_of(tmp_path, HAND, carried(own)))
    assert track.twist is None
    assert_same(track, own, "position", "points")


@pytest.mark.parametrize("topics", [("estimate",), ("odometry", "joint_states", "estimate")])
def test_the_truth_of_a_recording(tmp_path: Path, topics: tuple[str, ...]) -> None:
    own = estimates(HAND, 8)
    path = recording_of(tmp_path / "recording.mcap", HAND, own, topics)
    losses = LossLog()
    track = truth_of(result_of(tmp_path), path, losses=losses)
    assert_same(track, own, *EVERYTHING)
    assert track.name == "recording.mcap" and losses.losses == ()


def test_odometry_and_joint_states_are_pose_velocity_and_shape(tmp_path: Path) -> None:
    own = estimates(HAND, 8)
    path = recording_of(tmp_path / "recording.mcap", HAND, own, ("odometry", "joint_states"))
    track = truth_of(result_of(tmp_path), path)
    assert_same(track, own, "position", "quaternion", "shape", "twist")
    assert track.shape_names == HAND.shape_names
    assert (track.points, track.point_names) == (None, ())


def test_odometry_alone_has_no_shape(tmp_path: Path) -> None:
    own = estimates(HEAD, 8)
    path = recording_of(tmp_path / "recording.mcap", HEAD, own, ("odometry",))
    track = truth_of(result_of(tmp_path, HEAD), path)
    assert_same(track, own, "position", "quaternion")
    np.testing.assert_allclose(of(track.twist), [of(one.twist)[:6] for one in own], rtol=METRES, atol=1e-9)
    assert (track.shape_names, track.shape) == ((), None)


def test_odometry_s_velocity_is_in_the_body_s_axes_and_metres(tmp_path: Path) -> None:
    """By scipy from the message: v_camera = R v_body; a velocity that is left out is NaN."""
    turn = Rotation.from_euler("xyz", [0.3, -0.8, 1.9])
    moving = messages.Odometry(frame_id="camera", body_frame_id="head")
    moving.timestamp.FromNanoseconds(5)
    moving.pose.position.z = 0.7
    q = moving.pose.orientation
    q.x, q.y, q.z, q.w = (-turn.as_quat()).tolist()
    moving.linear_velocity.x, moving.linear_velocity.y = 0.1, -0.2
    moving.angular_velocity.z = 1.5
    still = messages.Odometry()
    still.CopyFrom(moving)
    still.timestamp.FromNanoseconds(6)
    still.ClearField("linear_velocity")
    with McapSink(tmp_path / "o.mcap") as sink:
        channel = sink.channel("/truth/head/odometry", messages.Odometry)
        for message in (moving, still):
            sink.write(channel, 99, message.SerializeToString())
        sink.finish()
    track = truth_of(result_of(tmp_path, HEAD), tmp_path / "o.mcap")
    assert track.stamp_ns.tolist() == [5, 6]  # their own, not the log times
    np.testing.assert_allclose(of(track.position)[0], [0.0, 0.0, 700.0])
    expected = turn.apply([100.0, -200.0, 0.0])
    np.testing.assert_allclose(of(track.twist)[0], [*expected, 0.0, 0.0, 1.5], atol=1e-9)
    np.testing.assert_array_equal(np.isnan(of(track.twist)[1]), [True] * 3 + [False] * 3)
    assert np.all(of(track.quaternion)[:, 3] >= 0.0)


def test_a_quaternion_that_was_never_set_is_refused(tmp_path: Path) -> None:
    with McapSink(tmp_path / "o.mcap") as sink:
        message = messages.Odometry()
        message.timestamp.FromNanoseconds(7)
        sink.write(sink.channel("/truth/head/odometry", messages.Odometry), 7, message.SerializeToString())
        sink.finish()
    with pytest.raises(
        TruthError, match=r"o\.mcap, pose at 7 ns: quaternion is not normalised, found length 0"
    ):
        load_truth(result_of(tmp_path, HEAD), tmp_path / "o.mcap")


def test_poses_without_joint_states_are_a_loss(tmp_path: Path) -> None:
    own = estimates(HAND, 6)
    with McapSink(tmp_path / "r.mcap") as sink:
        odometry = sink.channel("/truth/hand/odometry", messages.Odometry)
        joints = sink.channel("/truth/hand/joint_states", messages.JointStates)
        for i, one in enumerate(own):
            sink.write(odometry, one.stamp_ns, messages.odometry(one, HAND).SerializeToString())
            if i not in (2, 4):
                sink.write(joints, one.stamp_ns, messages.joint_states(one, HAND).SerializeToString())
        sink.finish()
    losses = LossLog()
    track = truth_of(result_of(tmp_path), tmp_path / "r.mcap", losses=losses)
    assert_same(track, [own[i] for i in (0, 1, 3, 5)], "position", "shape")
    assert [(loss.count, loss.first) for loss in losses.losses] == [(2, f"at {2 * FRAME_NS} ns")]


def test_joint_states_are_matched_by_name(tmp_path: Path) -> None:
    own = estimates(HAND, 4)
    turned = Subject("hand", "camera", HAND.shape_names[::-1], HAND.point_names, HAND.point_parents)
    other = [
        replace(one, shape=one.shape[::-1], twist=np.r_[of(one.twist)[:6], of(one.twist)[:5:-1]])
        for one in own
    ]
    path = recording_of(tmp_path / "r.mcap", turned, other, ("odometry", "joint_states"))
    track = truth_of(result_of(tmp_path), path)
    assert track.shape_names == HAND.shape_names
    assert_same(track, own, "shape", "twist")


def test_another_result_is_truth_by_its_own_estimates(tmp_path: Path) -> None:
    own = estimates(HAND, 8, lost=(3, 4))
    path = write_result(tmp_path / "stereo.mcap", HAND, own, carried(estimates(HAND, 8, seed=5)))
    track = truth_of(result_of(tmp_path), path)
    assert_same(track, [own[i] for i in (0, 1, 2, 5, 6, 7)], *EVERYTHING)
    assert track.name == "stereo.mcap without its 2 lost frames" and track.lost is None


def test_points_and_shape_of_another_result_are_put_in_order(tmp_path: Path) -> None:
    own = estimates(HEAD, 5)
    order = [2, 0, 1]
    more = Subject("head", "camera", ("b2", "b1"), ("ear", *(HEAD.point_names[i] for i in order)), (-1,) * 4)
    other = [
        replace(
            one,
            points=np.vstack([np.zeros(3), one.points[order]]),
            shape=one.shape[::-1],
            twist=np.r_[of(one.twist)[:6], of(one.twist)[[7, 6]]],
        )
        for one in own
    ]
    track = truth_of(result_of(tmp_path, HEAD), write_result(tmp_path / "other.mcap", more, other))
    assert (track.point_names, track.shape_names) == (HEAD.point_names, HEAD.shape_names)
    assert track.point_parents == HEAD.point_parents
    assert_same(track, own, *EVERYTHING)


def test_a_shape_of_other_coefficients_keeps_its_names(tmp_path: Path) -> None:
    mono = Subject("head", "camera", ("identity",), HEAD.point_names, HEAD.point_parents)
    path = write_result(tmp_path / "mono.mcap", mono, estimates(mono, 5))
    assert truth_of(result_of(tmp_path, HEAD), path).shape_names == ("identity",)


@pytest.mark.parametrize(
    ("subject", "message"),
    [
        (Subject("head", "camera", (), ("eye", "jaw"), (-1, -1)), "found jaw, expected also nose, mouth"),
        (HAND, r"other\.mcap: wrong subject, found hand, expected head"),
    ],
)
def test_a_result_of_something_else_is_refused(tmp_path: Path, subject: Subject, message: str) -> None:
    path = write_result(tmp_path / "other.mcap", subject, estimates(subject, 3))
    with pytest.raises(TruthError, match=message):
        load_truth(result_of(tmp_path, HEAD), path)


def test_estimates_of_other_sizes_are_refused(tmp_path: Path) -> None:
    small = Subject("hand", "camera", ("a",), ("wrist",), (-1,))
    with pytest.raises(
        TruthError, match=r"/truth/hand/estimate: ground truth has a different .* found 1 and 1, expected 15"
    ):
        load_truth(result_of(tmp_path, HAND, carried(estimates(small, 3))))


def test_a_csv_is_matched_by_name(tmp_path: Path) -> None:
    own = estimates(HAND, 5)
    columns = pose_columns(own) | point_columns(HAND, np.array([one.points for one in own]))
    track = truth_of(result_of(tmp_path), write_csv(tmp_path / "t.csv", columns))
    assert_same(track, own, "position", "quaternion", "points")
    assert (track.shape_names, track.twist) == ((), None)


@pytest.mark.parametrize("offset", [0.25, -0.0000000125])
def test_the_offset_is_added_to_the_truth_s_stamps(tmp_path: Path, offset: float) -> None:
    own = estimates(HAND, 5)
    track = truth_of(result_of(tmp_path, HAND, carried(own)), time_offset_s=offset)
    assert track.stamp_ns.tolist() == [one.stamp_ns + round(offset * 1e9) for one in own]


def test_an_offset_beyond_64_bits_is_refused(tmp_path: Path) -> None:
    result = result_of(tmp_path, HAND, carried(estimates(HAND, 2)))
    with pytest.raises(UsageError, match="time offset exceeds the range of 64-bit stamps"):
        load_truth(result, time_offset_s=1e11)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_a_truncated_recording_is_a_truth_as_far_as_it_goes(tmp_path: Path, share: float) -> None:
    own = estimates(HAND, 20)
    whole = recording_of(tmp_path / "r.mcap", HAND, own, ("estimate",)).read_bytes()
    (tmp_path / "r.mcap").write_bytes(whole[: int(share * len(whole))])
    losses = LossLog()
    track = truth_of(result_of(tmp_path), tmp_path / "r.mcap", losses=losses)
    assert 0 < len(track) < 20
    assert_same(track, own[: len(track)], *EVERYTHING)
    assert losses.losses


def test_a_truncated_result_is_a_truth_as_far_as_it_goes(tmp_path: Path) -> None:
    own = estimates(HAND, 40)
    path = write_result(tmp_path / "other.mcap", HAND, own)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    losses = LossLog()
    track = truth_of(result_of(tmp_path), path, losses=losses)
    assert 0 < len(track) < 40
    assert_same(track, own[: len(track)], *EVERYTHING)
    assert losses.losses


def test_a_damaged_chunk_of_truth_is_a_loss(tmp_path: Path) -> None:
    own = estimates(HAND, 20)
    path = recording_of(tmp_path / "r.mcap", HAND, own, ("odometry", "joint_states"))
    data = bytearray(path.read_bytes())
    middle = len(data) // 3
    data[middle : middle + 40] = bytes(40)
    path.write_bytes(data)
    losses = LossLog()
    track = truth_of(result_of(tmp_path), path, losses=losses)
    assert 15 <= len(track) < 20 and losses.losses


def test_faults_of_the_path_are_one_line(tmp_path: Path) -> None:
    result = result_of(tmp_path)
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.mcap").symlink_to(result.path)
    cases: list[tuple[str, type[Exception], str]] = [
        ("none.csv", TruthError, "no such file"),
        ("folder", TruthError, "not a file"),
        ("empty.mcap", TruthError, "is empty"),
        ("result.mcap", UsageError, "a result cannot be its own ground truth"),
        ("link.mcap", UsageError, "a result cannot be its own ground truth"),
    ]
    for name, kind, message in cases:
        with pytest.raises(kind, match=message) as caught:
            load_truth(result, tmp_path / name)
        assert str(tmp_path / name) in str(caught.value) and "\n" not in str(caught.value)


def test_a_recording_without_truth_of_the_subject_lists_what_it_has(tmp_path: Path) -> None:
    result = result_of(tmp_path)
    path = recording_of(tmp_path / "r.mcap", HEAD, estimates(HEAD, 2), ("odometry",))
    with pytest.raises(
        TruthError, match="no ground truth of a hand, found /truth/head/odometry, expected /truth/hand"
    ):
        load_truth(result, path)
    empty = recording_of(tmp_path / "e.mcap", HEAD, [], ())
    with pytest.raises(TruthError, match="found no /truth topics"):
        load_truth(result, empty)


def test_stamps_of_truth_must_increase(tmp_path: Path) -> None:
    own = estimates(HAND, 3)
    own[2] = replace(own[2], stamp_ns=own[1].stamp_ns)
    with pytest.raises(ResultError, match=f"truth, row 2: duplicate stamp, found {FRAME_NS} ns"):
        load_truth(result_of(tmp_path, HAND, carried(own)))


def test_an_unreadable_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_csv(tmp_path / "t.csv", {"t_s": [0.0]})

    def refuse(path: Path) -> Any:
        raise PermissionError(13, "Permission denied")

    result = result_of(tmp_path)
    monkeypatch.setattr(tables, "open_input", refuse)
    with pytest.raises(TruthError, match=r"t\.csv: cannot be read, found Permission denied"):
        load_truth(result, path)


def test_names_of_files_may_be_any(tmp_path: Path) -> None:
    own = estimates(HAND, 3)
    path = recording_of(tmp_path / "Größe 手.mcap", HAND, own, ("estimate",))
    assert truth_of(result_of(tmp_path), path).name == "Größe 手.mcap"


@pytest.mark.parametrize("person", ["person-a", "person-b"])
def test_the_rendered_heads_against_themselves(tmp_path: Path, measured_data: Path, person: str) -> None:
    """A track that is the truth has no error: but for rounding."""
    path = measured_data / "heads" / person / "truth.csv"
    columns = [name for name in open_table(path).names if name.endswith("_x_mm")]
    names = tuple(name.removesuffix("_x_mm") for name in columns)
    head = Subject("head", "left", (), names, (-1,) * len(names))
    true = load_csv_track(path, head)
    blank = estimates(head, len(true), velocity=False)
    own = [
        replace(one, stamp_ns=int(stamp), position=position, quaternion=quaternion, points=points)
        for one, stamp, position, quaternion, points in zip(
            blank, true.stamp_ns, of(true.position), of(true.quaternion), of(true.points), strict=True
        )
    ]
    result = write_result(tmp_path / "head.mcap", head, own)
    measured = evaluate(result, EvalOptions(truth=path))
    assert measured.coverage.share == 1.0 and measured.coverage.frames == len(true)
    for name in (
        "x_mm",
        "y_mm",
        "z_mm",
        "roll_deg",
        "pitch_deg",
        "yaw_deg",
        "rotation_deg",
        "point_error_mm",
    ):
        figures = measured.metrics[name]
        assert isinstance(figures, Statistics)
        assert figures.max < (SINGLE_MM if name == "point_error_mm" else 1e-9), name
    aligned = evaluate(result, EvalOptions(truth=path, align="rigid+points"))
    assert aligned.notes[0].startswith("removed constant rigid offset: 0.0 0.0 0.0 mm, 0.0 deg")


def test_truth_without_shape_entries_measures_a_head_whose_model_is_its_own(tmp_path: Path) -> None:
    """A synthetic head's truth tells its deformation by its points only."""
    bare = replace(HEAD, shape_names=())
    truth = carried(estimates(bare, 8, seed=9), "/truth/head/estimate")
    track = truth_of(result_of(tmp_path, HEAD, truth))
    assert track.shape_names == () and of(track.shape).shape == (8, 0) and of(track.twist).shape == (8, 6)
    other = replace(HEAD, shape_names=("b1",))
    (tmp_path / "other").mkdir()
    wrong = carried(estimates(other, 8), "/truth/head/estimate")
    with pytest.raises(TruthError, match="different number of shape entries"):
        truth_of(result_of(tmp_path / "other", HEAD, wrong))


@pytest.mark.parametrize(
    "content", [b"a" * (2 << 20), b"t_s," + b"c," * 20_000 + b"\n", b"t_s,x_mm\n0,1e13\n"]
)
def test_lines_and_numbers_without_end_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "t.csv").write_bytes(content)
    with pytest.raises(TruthError, match=r"^[^\n]{1,400}$"):
        truth_tables.read_columns(open_table(tmp_path / "t.csv"), ["x_mm"])
