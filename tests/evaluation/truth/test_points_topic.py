"""True points without poses: written, read, and measured by."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.measuring.evaluate import evaluate
from posetrack_cli.evaluation.reading.tracks import Track, track_of_result
from posetrack_cli.evaluation.reading.truth import load_truth
from posetrack_cli.evaluation.reading.truth_topics import points_messages, points_topic
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results.reader import read_result
from support.metrics import SINGLE_MM
from support.truth import HAND, HEAD, estimates, write_result

FRAMES = 5


def joints(seed: int = 1) -> Track:
    own = estimates(HAND, FRAMES, seed=seed)
    return Track(
        "joints",
        "hand",
        (),
        HAND.point_names,
        HAND.point_parents,
        stamp_ns=np.array([one.stamp_ns for one in own]),
        points=np.array([one.points for one in own]),
    )


def with_truth(path: Path, messages: list[TruthMessage]) -> Path:
    return write_result(path, HAND, estimates(HAND, FRAMES), messages)


def test_points_come_back_to_the_last_bit_and_nothing_else(tmp_path: Path) -> None:
    result = read_result(with_truth(tmp_path / "r.mcap", list(points_messages(joints(), "hand"))))
    truth = load_truth(result)
    assert truth is not None and truth.position is None and truth.quaternion is None and truth.shape is None
    np.testing.assert_array_equal(truth.points, joints().points)
    np.testing.assert_array_equal(truth.stamp_ns, joints().stamp_ns)
    assert truth.point_names == HAND.point_names and truth.point_parents == HAND.point_parents


def test_a_result_is_measured_by_them(tmp_path: Path) -> None:
    path = with_truth(tmp_path / "r.mcap", list(points_messages(joints(), "hand")))
    found = evaluate(path)
    own = track_of_result(read_result(path), "r").points
    assert own is not None
    expected = np.linalg.norm(own - joints().points, axis=2)
    assert found.metrics["joint_error_mm"].mean == pytest.approx(expected.mean(), abs=SINGLE_MM)
    assert found.absent["wrist_rotation_deg"] == "the ground truth has no rotation"
    assert found.curve is not None


def test_points_in_another_order_are_matched_by_name(tmp_path: Path) -> None:
    turned = replace(joints(), point_names=HAND.point_names[::-1], points=joints().points[:, ::-1])
    truth = load_truth(read_result(with_truth(tmp_path / "r.mcap", list(points_messages(turned, "hand")))))
    assert truth is not None
    np.testing.assert_array_equal(truth.points, joints().points)
    assert truth.point_names == HAND.point_names


def test_a_recording_s_points_are_a_truth_given_by_path(tmp_path: Path) -> None:
    plain = read_result(write_result(tmp_path / "plain.mcap", HAND, estimates(HAND, FRAMES)))
    from posetrack_cli.mcap.sink import McapSink, SchemaText

    with McapSink(tmp_path / "in.mcap") as sink:
        for message in points_messages(joints(), "hand"):
            if message.log_time_ns == 0:
                channel = sink.raw_channel(
                    message.topic, SchemaText(message.schema_name, "jsonschema", message.schema_data), "json"
                )
            sink.write(channel, message.log_time_ns, message.data)
        sink.finish()
    truth = load_truth(plain, tmp_path / "in.mcap")
    assert truth is not None
    np.testing.assert_array_equal(truth.points, joints().points)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda fields: fields.pop("points"), "message is not a posetrack.Points"),
        (lambda fields: fields["points"][3].pop("x"), "message is not a posetrack.Points"),
        (lambda fields: fields["points"][3].update(x="far"), "message is not a posetrack.Points"),
        (lambda fields: fields["points"][3].update(name="sixth"), "point names change within the topic"),
    ],
)
def test_damage_is_one_line_with_its_place(tmp_path: Path, change, told: str) -> None:
    messages = list(points_messages(joints(), "hand"))
    fields = json.loads(messages[2].data)
    change(fields)
    messages[2] = replace(messages[2], data=json.dumps(fields).encode())
    result = read_result(with_truth(tmp_path / "r.mcap", messages))
    with pytest.raises(TruthError, match=f"{points_topic('hand')} at {messages[2].log_time_ns} ns") as error:
        load_truth(result)
    assert told in str(error.value)


def test_points_of_another_hand_are_refused(tmp_path: Path) -> None:
    few = replace(joints(), point_names=("a", "b"), points=joints().points[:, :2])
    result = read_result(with_truth(tmp_path / "r.mcap", list(points_messages(few, "hand"))))
    with pytest.raises(TruthError, match="ground truth has other points than the result"):
        load_truth(result)


def test_some_of_the_joints_are_compared_by_name(tmp_path: Path) -> None:
    chosen = [7, 2, 20]
    some = tuple(HAND.point_names[k] for k in chosen)
    few = replace(joints(), point_names=some, points=joints().points[:, chosen])
    path = with_truth(tmp_path / "r.mcap", list(points_messages(few, "hand")))
    own = track_of_result(read_result(path), "r").points
    assert own is not None
    expected = np.linalg.norm(own - joints().points, axis=2)[:, chosen]
    assert evaluate(path).metrics["joint_error_mm"].mean == pytest.approx(expected.mean(), abs=SINGLE_MM)


def test_a_track_without_points_has_no_messages() -> None:
    with pytest.raises(TruthError, match="has no points"):
        list(points_messages(replace(joints(), points=None), "hand"))
    assert points_topic(HEAD.name) == "/truth/head/points"
