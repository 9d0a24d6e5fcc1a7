"""A result as protobuf: generic readers read all of it, and posetrack reads it as the result itself."""

from __future__ import annotations

import json
import struct
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap_protobuf.decoder import DecoderFactory

from posetrack_cli.cli.main import run
from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.reading.truth_tables import load_csv_track
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import ResultWriter, read_result
from posetrack_cli.results.copying import Copied, copied_result, unchanged
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA, ESTIMATE_SCHEMA_NAME, estimate_to_json
from posetrack_cli.results.export.export import export_file
from posetrack_cli.results.export.source import export_source
from support.results import CAMERA, RUN, SUBJECT, make_estimate, with_fields

FRAMES = 6
NAMES = ("forearm_x", "sign_cost")
INTEGERS = ("frame_index", "stamp_ns", "evaluations")


def estimates() -> list[Any]:
    """One without velocity, one without optional numbers, one with all of them."""
    made = [with_fields(make_estimate(k), numbers=np.array([0.5 * k, np.nan])) for k in range(FRAMES)]
    made[1] = with_fields(made[1], pose_rate=None, twist=None, twist_variance=None)
    made[2] = with_fields(made[2], effective_sample_size=None, cost=1.5, evaluations=7, milliseconds=0.25)
    return made


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("result") / "r.mcap"
    schema = json.dumps(ESTIMATE_SCHEMA).encode()
    with ResultWriter(path, replace(SUBJECT, number_names=NAMES), CAMERA, RUN) as writer:
        for one in estimates():
            told = estimate_to_json(with_fields(one, numbers=None))
            truth = "/truth/hand/estimate", ESTIMATE_SCHEMA_NAME, "jsonschema", schema, "json"
            writer.add_truth(TruthMessage(*truth, one.stamp_ns, told))
            writer.write(one)
        for one in reversed(estimates()):
            writer.write_smoothed(one)
        writer.attach("model.npz", "application/x-npz", b"learned")
        writer.finish({"remarks": "none"})
    return path


@pytest.fixture(scope="module")
def twin(result: Path) -> Path:
    out = result.with_name("twin.mcap")
    assert export_file(export_source(read_result(result)), "protobuf", out) == ()
    return out


def test_a_generic_reader_reads_every_message_and_the_same_values(result: Path, twin: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from mcap_protobuf.reader import read_protobuf_messages

        counts = [sum(1 for _ in McapFile(path).messages()) for path in (result, twin)]
        assert len(list(read_protobuf_messages(twin))) == counts[0] == counts[1]
    found = 0
    with twin.open("rb") as stream:
        for _, channel, message, decoded in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            if not channel.topic.endswith("/estimate"):
                continue
            told = MessageToDict(decoded, preserving_proto_field_name=True)
            told |= {
                name: int(told[name]) for name in ("frame_index", "stamp_ns", "evaluations") if name in told
            }
            own = [
                m.data
                for _, _, m in McapFile(result).messages([channel.topic])
                if m.log_time == message.log_time
            ]
            assert [told] == [json.loads(data) for data in own]
            found += 1
    assert found == 3 * FRAMES


def test_it_is_read_as_the_result_itself(result: Path, twin: Path) -> None:
    one, other = read_result(result), read_result(twin)
    assert (other.run, other.summary, other.tracks) == (one.run, one.summary, one.tracks)
    assert other.attachment("model.npz") == b"learned"
    assert other.camera() == one.camera()
    for topic in ("/hand/estimate", "/smoothed/hand/estimate", "/truth/hand/estimate"):
        mine, theirs = one.columns(topic), other.columns(topic)
        assert mine.keys() == theirs.keys()
        for name, column in mine.items():
            np.testing.assert_array_equal(column, theirs[name], err_msg=f"{topic} {name}")
        assert len(list(other.estimates(topic))) == FRAMES


def test_all_else_is_kept_and_in_order_of_time(result: Path, twin: Path) -> None:
    def kept(path: Path) -> list[Any]:
        items = McapFile(path).messages(lambda topic: not topic.endswith("/estimate"))
        return sorted((c.topic, m.log_time, m.data, s.name) for s, c, m in items)

    assert kept(result) == kept(twin)
    extras = [list(McapFile(path).extras()) for path in (result, twin)]
    for kind in (Metadata, Attachment):
        assert [e for e in extras[0] if isinstance(e, kind)] == [e for e in extras[1] if isinstance(e, kind)]
    times = [m.log_time for _, _, m in McapFile(twin).messages(in_file_order=True)]
    assert times == sorted(times)


def test_a_twin_of_a_twin_is_the_same(twin: Path) -> None:
    again = twin.with_name("again.mcap")
    export_file(export_source(read_result(twin)), "protobuf", again)
    assert again.read_bytes() == twin.read_bytes()


def test_other_encodings_and_damaged_messages_are_left_out_and_told(tmp_path: Path) -> None:
    path, out = tmp_path / "r.mcap", tmp_path / "t.mcap"
    schema = json.dumps({"properties": {"i": {"type": "integer"}}}).encode()
    with ResultWriter(path, SUBJECT, CAMERA, RUN) as writer:
        cdr = "/truth/hand/note", "std_msgs/msg/Float64", "ros2msg", b"float64 data", "cdr", 0
        writer.add_truth(TruthMessage(*cdr, b"\0\1\0\0" + struct.pack("<d", 1.5)))
        for data in (b'{"i":1}', b'{"i":"one"}'):
            count = "/truth/hand/count", "custom.Count", "jsonschema", schema, "json", 0
            writer.add_truth(TruthMessage(*count, data))
        writer.write(make_estimate(0))
        writer.finish({})
    notes = export_file(export_source(read_result(path)), "protobuf", out)
    assert notes == (
        "/truth/hand/note is left out: it is not JSON with a schema",
        "message left out, message is not a custom.Count: 1, first /truth/hand/count",
    )
    topics = [channel.topic for _, channel, _ in McapFile(out).messages()]
    assert "/truth/hand/note" not in topics and topics.count("/truth/hand/count") == 1


@pytest.mark.parametrize("options", [("--no-lost",), ("--track", "smoothed")])
def test_a_part_cannot_be_asked_for(
    result: Path, tmp_path: Path, options: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["export", str(result), "--schemas", "protobuf", "-o", str(tmp_path / "t.mcap")]
    assert run([*asked, *options]) == 2
    assert "exports all frames and topics" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert run(asked) == 0
    assert capsys.readouterr().out.startswith(f"{tmp_path / 't.mcap'}: protobuf, ")


def test_estimates_of_another_layout_are_one_line(twin: Path, tmp_path: Path) -> None:
    """As a version with other fields would write."""

    def choice(schema: Schema | None, channel: Channel) -> Copied:
        copied = unchanged(schema, channel)
        renamed = copied.schema._replace(data=copied.schema.data.replace(b"stamp_ns", b"stomp_ns"))
        return copied._replace(schema=renamed)

    path = tmp_path / "t.mcap"
    with McapSink(path) as sink, copied_result(McapFile(twin), sink, choice):
        pass
    told = "estimate cannot be read, found protobuf layout of another version: export the result again"
    for read in (read_result(path).columns, lambda: list(read_result(path).estimates())):
        with pytest.raises(ResultError, match=f"/hand/estimate: {told}"):
            read()


def test_points_are_read_as_truth(result: Path, tmp_path: Path) -> None:
    """Annotated joints in the result's truth, evaluated against before and after."""
    from posetrack_cli.evaluation.reading.truth_topics import points_messages
    from posetrack_cli.results.export.table import point_columns

    columns = point_columns(SUBJECT.point_names)
    rows = [",".join(["stamp_ns", *columns])]
    for k in range(FRAMES):
        one = make_estimate(k)
        rows.append(",".join([str(one.stamp_ns), *map(str, (one.points + 3.0).ravel())]))
    (tmp_path / "joints.csv").write_text("\n".join(rows) + "\n")
    path = tmp_path / "r.mcap"
    with ResultWriter(path, SUBJECT, CAMERA, RUN) as writer:
        for message in points_messages(load_csv_track(tmp_path / "joints.csv", SUBJECT), "hand"):
            writer.add_truth(message)
        for k in range(FRAMES):
            writer.write(make_estimate(k))
        writer.finish({})
    assert run(["export", str(path), "--schemas", "protobuf", "-o", str(tmp_path / "t.mcap")]) == 0
    reports = []
    for name in ("r", "t"):
        assert run(["eval", str(tmp_path / f"{name}.mcap"), "--json", str(tmp_path / f"{name}.json")]) == 0
        (report,) = json.loads((tmp_path / f"{name}.json").read_text())["results"]
        reports.append(report["metrics"])
    assert reports[0] == reports[1]
    assert reports[0]["joint_error_mm"]["mean"] == pytest.approx(3.0 * 3**0.5)
