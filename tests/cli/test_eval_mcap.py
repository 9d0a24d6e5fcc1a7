"""``posetrack eval --mcap``: the file holds all of the result, and the figures of the report."""

from __future__ import annotations

import hashlib
import json
import re
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Metadata
from mcap_protobuf.decoder import DecoderFactory
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory

from posetrack_cli.cli.main import run
from posetrack_cli.evaluation.measuring.catalogue import catalogue
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.reports import mcap_report
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results.reader import read_result
from support.eval_command import (
    begin,
    damaged,
    killed_run,
    write_frames,
    write_result,
    write_smoothed_frames,
)
from support.markdown import ROOT, blocks
from support.metrics import SINGLE_MM
from support.tracks import hand_track

FRAMES = 90
ROUNDING = 1e-12
"""Relative: a mean of means and the mean of all values differ by the rounding of some hundred sums."""
MODEL = b"what was learned"


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two tracks, lost frames, truth, one message of it in ROS 2's encoding, an attachment."""
    path = tmp_path_factory.mktemp("result") / "r.mcap"
    with begin(path) as writer:
        data = b"\0\1\0\0" + struct.pack("<d", 1.5)
        truth = (
            "/truth/hand/note",
            "std_msgs/msg/Float64",
            "ros2msg",
            b"float64 data",
            "cdr",
            0,
            data,
            {"by": "us"},
        )
        writer.add_truth(TruthMessage(*truth))
        write_frames(writer, FRAMES, lost=range(20, 25))
        writer.attach("model.npz", "application/x-npz", MODEL)
        write_smoothed_frames(writer, FRAMES, 2.0)
        writer.finish({"remarks": "none"})
    return path


@pytest.fixture(scope="module")
def evaluated(result: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result with its metrics; ``r.json`` beside it is the report of both tracks."""
    folder = tmp_path_factory.mktemp("evaluated")
    options = ("--track", "both", "--json", folder / "r.json", "--fail-if", "joint_error_mm.mean > 1000")
    assert evaluate(result, "--mcap", folder / "out.mcap", *options) == 0
    return folder / "out.mcap"


def evaluate(*arguments: object) -> int:
    return run(["eval", "--quiet", *map(str, arguments)])


def contents(path: Path) -> dict[str, Any]:
    """All that is not of an evaluation."""
    file = McapFile(path)
    messages = [
        (c.topic, m.log_time, m.publish_time, m.sequence, m.data, s and (s.name, s.encoding, s.data))
        for s, c, m in file.messages(lambda topic: not topic.startswith("/eval/"), in_file_order=True)
    ]
    channels = {
        (c.topic, c.message_encoding, tuple(c.metadata.items()))
        for _, c in file.channels()
        if not c.topic.startswith("/eval/")
    }
    extras = list(file.extras())
    return {
        "messages": messages,
        "channels": channels,
        "metadata": [
            (e.name, e.metadata) for e in extras if isinstance(e, Metadata) and e.name != "posetrack.eval"
        ],
        "attachments": [e for e in extras if isinstance(e, Attachment)],
    }


def metrics(path: Path, topic: str = "/eval/hand") -> list[dict[str, Any]]:
    """The messages of a track's metrics, each with its log time."""
    return [{**json.loads(m.data), "log": m.log_time} for _, _, m in McapFile(path).messages([topic])]


def record(path: Path) -> dict[str, Any]:
    """The metadata, what is JSON of them read."""
    (found,) = (e for e in McapFile(path).extras() if isinstance(e, Metadata) and e.name == "posetrack.eval")
    return {k: json.loads(v) if v[:1] in "[{" else v for k, v in found.metadata.items()}


def column(messages: list[dict[str, Any]], name: str) -> np.ndarray:
    return np.array([message.get(name, np.nan) for message in messages])


def report(path: Path) -> list[dict[str, Any]]:
    return json.loads(path.read_text())["results"]


def test_all_of_the_result_is_kept(result: Path, evaluated: Path) -> None:
    kept, whole = contents(evaluated), contents(result)
    assert kept == whole
    assert len(kept["messages"]) == 2 + 9 * FRAMES  # note, calibration; truth, and 4 of each track
    assert [a.data for a in kept["attachments"]] == [MODEL]
    assert read_result(evaluated).tracks == ("filtered", "smoothed")
    assert read_result(evaluated).summary == read_result(result).summary


def test_every_estimate_has_a_message_at_its_stamp(evaluated: Path) -> None:
    found = metrics(evaluated)
    stamps, lost = hand_track("", FRAMES, 5.0, 1).stamp_ns, set(range(20, 25))
    assert [m["stamp_ns"] for m in found] == [m["log"] for m in found] == stamps.tolist()
    assert [m["status"] for m in found] == ["lost" if k in lost else "tracking" for k in range(FRAMES)]


@pytest.mark.parametrize(
    ("topic", "sd_mm", "seed"), [("/eval/hand", 5.0, 1), ("/eval/smoothed/hand", 2.0, 3)]
)
def test_errors_are_those_of_each_frame(evaluated: Path, topic: str, sd_mm: float, seed: int) -> None:
    track, truth = hand_track("", FRAMES, sd_mm, seed), hand_track("", FRAMES, 0.0)
    errors = np.linalg.norm(track.points - truth.points, axis=2)
    found = metrics(evaluated, topic)
    np.testing.assert_allclose(column(found, "joint_error_mm"), errors.mean(axis=1), atol=SINGLE_MM)
    np.testing.assert_allclose(
        column(found, "largest_joint_error_mm"), errors.max(axis=1), rtol=0.0, atol=SINGLE_MM
    )
    wrist = np.linalg.norm(track.position - truth.position, axis=1)
    np.testing.assert_allclose(column(found, "wrist_position_mm"), wrist, rtol=1e-9)
    assert column(found, "cost_mm").tolist() == [5.0] * FRAMES
    assert np.flatnonzero(np.isnan(column(found, "jitter_mm"))).tolist() == [0, FRAMES - 1]


def test_messages_have_the_totals_of_the_report(evaluated: Path) -> None:
    """Every metric of the messages is in the report, with the mean that its messages have."""
    compared = set()
    for one in report(evaluated.with_name("r.json")):
        found = metrics(evaluated, "/eval/hand" if one["track"] == "filtered" else "/eval/smoothed/hand")
        for name in found[1].keys() - {"stamp_ns", "status", "log"}:
            values, total = column(found, name), one["metrics"][name]
            assert total["count"] % np.isfinite(values).sum() == 0, name  # so many parts each
            assert np.nanmean(values) == pytest.approx(total["mean"], rel=ROUNDING), name
            compared.add(name)
    assert compared >= {"joint_error_mm", "angle_error_deg", "nees", "ess", "cost_mm", "jitter_mm"}


def test_metadata_are_the_report(evaluated: Path) -> None:
    whole, said = json.loads(evaluated.with_name("r.json").read_text()), record(evaluated)
    for key in ("format", "version", "options", "gates"):
        assert said[key] == whole[key], key
    assert [one["name"] for one in said["results"]] == ["r", "r smoothed"]
    for mine, theirs in zip(said["results"], whole["results"], strict=True):
        assert mine.items() <= theirs.items()
        assert {"coverage", "metrics", "absent", "notes", "losses"} <= mine.keys()
    assert said["gates"][0]["failed"] is False
    assert said["truth.topics"] == ["/truth/hand/estimate", "/truth/hand/note"]
    assert said["losses"] == []


def test_the_schema_says_what_each_number_is(evaluated: Path) -> None:
    schemas = {c.topic: s for s, c in McapFile(evaluated).channels() if c.topic.startswith("/eval/") and s}
    assert schemas.keys() == {"/eval/hand", "/eval/smoothed/hand"}
    for topic, schema in schemas.items():
        assert (schema.name, schema.encoding) == ("posetrack.FrameMetrics", "jsonschema")
        told = json.loads(schema.data)
        known = {name for message in metrics(evaluated, topic) for name in message} - {"log"}
        assert told["properties"].keys() == known
        numbers = {name: of for name, of in told["properties"].items() if of["type"] == "number"}
        assert numbers["nees"]["description"].startswith("Normalised estimation error squared")
        assert all(of["description"].endswith(".") for of in numbers.values())


def test_what_is_measured_again_is_equal_and_replaces_what_was(
    evaluated: Path, result: Path, tmp_path: Path
) -> None:
    again, align = tmp_path / "again.mcap", ("--align", "rigid")
    assert evaluate(evaluated, "--mcap", again, "--json", tmp_path / "j.json") == 0
    assert report(tmp_path / "j.json")[0]["metrics"] == report(evaluated.with_name("r.json"))[0]["metrics"]
    assert contents(again) == contents(result)
    assert [metrics(again, t) for t in ("/eval/hand", "/eval/smoothed/hand")] == [
        metrics(evaluated, t) for t in ("/eval/hand", "/eval/smoothed/hand")
    ]
    assert evaluate(again, "--track", "filtered", *align, "--mcap", tmp_path / "aligned.mcap") == 0
    aligned = tmp_path / "aligned.mcap"
    assert len(metrics(aligned)) == FRAMES and metrics(aligned) != metrics(again)
    assert metrics(aligned, "/eval/smoothed/hand") == []
    assert record(aligned)["options"]["align"] == "rigid"
    assert any(
        note.startswith("removed constant rigid offset") for note in record(aligned)["results"][0]["notes"]
    )
    off = [column(metrics(path), "wrist_position_mm").mean() for path in (again, aligned)]
    assert off[1] < off[0]


def test_without_truth_the_consistency_is_written(tmp_path: Path) -> None:
    path = write_result(tmp_path / "r.mcap", 30, truth=False)
    assert evaluate(path, "--mcap", tmp_path / "out.mcap") == 0
    found = metrics(tmp_path / "out.mcap")
    assert found[1].keys() == {"log", "stamp_ns", "status", "jitter_mm", "cost_mm", "confidence", "ess"}
    said = record(tmp_path / "out.mcap")
    assert not any(key.startswith("truth") for key in said)
    assert said["results"][0]["absent"]["joint_error_mm"].startswith("no ground truth")


def test_a_truth_that_is_given_is_named_and_covers_what_it_covers(tmp_path: Path) -> None:
    """Errors of the frames with truth, and cost of all; the truth that the result carries stays."""
    path, truth = write_result(tmp_path / "r.mcap", 60, lost=[3]), write_result(tmp_path / "t.mcap", 40, 0.0)
    assert evaluate(path, "--truth", truth, "--mcap", tmp_path / "out.mcap") == 0
    found, said = metrics(tmp_path / "out.mcap"), record(tmp_path / "out.mcap")
    assert np.isfinite(column(found, "joint_error_mm")).tolist() == [k < 40 for k in range(60)]
    assert np.isfinite(column(found, "cost_mm")).all()
    totals = said["results"][0]["metrics"]
    assert (totals["joint_error_mm"]["count"], totals["cost_mm"]["count"]) == (40 * 21, 60)
    assert np.nanmean(column(found, "joint_error_mm")) == pytest.approx(
        totals["joint_error_mm"]["mean"], rel=ROUNDING
    )
    assert said["truth.name"] == "t.mcap"
    assert said["truth.sha256"] == hashlib.sha256(truth.read_bytes()).hexdigest()
    assert contents(tmp_path / "out.mcap") == contents(path)


def test_of_several_results_each_has_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    paths = [
        write_result(tmp_path / place, 10, recording=place) for place in ("a/r.mcap", "b/r.mcap", "c.mcap")
    ]
    assert evaluate(*paths, "--mcap", tmp_path / "one.mcap") == 2
    assert "one.mcap: output is not a folder, found 3 results for one file" in capsys.readouterr().err
    assert evaluate(*paths[:2], "--group", f"c={paths[2]}", "--mcap", tmp_path / "out") == 0
    written = sorted((tmp_path / "out").iterdir())
    assert [path.name for path in written] == ["a-r.mcap", "b-r.mcap", "c.mcap"]
    for path, source in zip(written, paths, strict=True):
        assert contents(path) == contents(source)
        assert len(metrics(path)) == 10
    assert [record(path)["results"][0]["name"] for path in written] == ["a/r", "b/r", "c"]


def test_rows_have_the_same_files(tmp_path: Path) -> None:
    """Of many results nothing is kept but figures, so each is measured again."""
    paths = [write_result(tmp_path / f"{k}.mcap", 12, recording=str(k), seed=k) for k in range(5)]
    gate = ("--fail-if", "joint_error_mm.mean > 8", "--fail-if", "p95(joint_error_mm.mean) > 1000")
    rows, alone = tmp_path / "rows", tmp_path / "alone.mcap"
    assert evaluate(*paths, "--mcap", rows, "--json", tmp_path / "j.json", *gate) in (0, 1)
    totals = {one["name"]: one["metrics"] for one in report(tmp_path / "j.json")}
    for path in paths:
        said = record(rows / path.name)
        whole = {name: v for name, v in said["results"][0]["metrics"].items() if "." not in name}
        assert whole == totals[path.stem]
        assert [gate["result"] for gate in said["gates"]] == [path.stem, "pooled"]
    assert evaluate(paths[2], "--mcap", alone) == 0
    assert metrics(rows / "2.mcap") == metrics(alone)


def test_one_of_many_that_cannot_be_read_has_no_file(tmp_path: Path) -> None:
    paths = [write_result(tmp_path / f"{k}.mcap", 6, recording=str(k)) for k in range(5)]
    paths[1].write_bytes(b"no result")
    assert evaluate(*paths, "--mcap", tmp_path / "out") == 1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "0.mcap",
        "2.mcap",
        "3.mcap",
        "4.mcap",
    ]


def test_nothing_is_replaced_that_should_not_be(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, mine = result.read_bytes(), tmp_path / "mine.mcap"
    mine.write_bytes(before)
    link = tmp_path / "link.mcap"
    link.symlink_to(mine)
    refused = {
        mine: "output would replace the result",
        link: "output would replace the result",
        tmp_path / "gone" / "out.mcap": "no folder",
        tmp_path / "out.txt": "a name ending in .mcap",
        tmp_path: "output would replace the result",  # a folder, in which the result is
    }
    for out, why in refused.items():
        assert evaluate(mine, "--mcap", out, "--overwrite") in (1, 2), out
        assert why in capsys.readouterr().err
    other = tmp_path / "other.mcap"
    other.write_bytes(b"precious")
    assert evaluate(mine, "--mcap", other) == 2
    assert "already exists; use --overwrite to replace it" in capsys.readouterr().err
    assert evaluate(mine, "--truth", other, "--mcap", other, "--overwrite") == 2
    assert "report would overwrite an input" in capsys.readouterr().err
    assert (mine.read_bytes(), other.read_bytes()) == (before, b"precious")
    assert evaluate(mine, "--mcap", other, "--overwrite") == 0
    assert len(metrics(other)) == FRAMES
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.mcap", "mine.mcap", "other.mcap"]


def test_an_interruption_leaves_nothing(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(sink: object, evaluation: Evaluation) -> None:
        assert part_path(tmp_path / "out.mcap").exists()
        raise KeyboardInterrupt

    monkeypatch.setattr(mcap_report, "_write_metrics", interrupted)
    assert evaluate(result, "--mcap", tmp_path / "out.mcap") == 130
    assert list(tmp_path.iterdir()) == []


def test_a_failed_gate_writes_the_file(result: Path, tmp_path: Path) -> None:
    assert evaluate(result, "--mcap", tmp_path / "out.mcap", "--fail-if", "coverage < 1") == 1
    (gate,) = record(tmp_path / "out.mcap")["gates"]
    assert gate["failed"] is True and gate["figure"] == pytest.approx(85 / 90)


def test_a_killed_run_is_written_as_far_as_it_goes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    killed, out = killed_run(tmp_path / "r.mcap", 45), tmp_path / "out.mcap"
    assert evaluate(killed, "--mcap", killed.with_name("r.mcap"), "--overwrite") == 2
    assert "output would replace the result" in capsys.readouterr().err
    assert evaluate(killed, "--mcap", out, "--json", tmp_path / "j.json") == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert "only the readable part was measured: file is truncated" in line
    assert contents(out) == contents(killed) and len(metrics(out)) == 40
    assert not read_result(out).finished
    assert [loss["what"] for loss in record(out)["losses"]] == ["file is truncated, the rest is missing"]
    assert evaluate(out, "--json", tmp_path / "again.json") == 0
    first, again = (report(tmp_path / name)[0] for name in ("j.json", "again.json"))
    assert first["metrics"] == again["metrics"] and first["notes"] == again["notes"]


def test_what_only_the_copy_misses_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The smoothed track is damaged, and the filtered one measured."""
    path = write_result(tmp_path / "r.mcap", 20, smoothed_mm=2.0)
    whole = bytearray(path.read_bytes())
    last = max(i.chunk_start_offset + i.chunk_length for i in summary_of(path).chunk_indexes)
    whole[last - 40] ^= 0xFF
    path.write_bytes(whole)
    assert evaluate(path, "--track", "filtered") == 0
    assert evaluate(path, "--track", "filtered", "--mcap", tmp_path / "out.mcap") == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("r: only the readable part was written: chunk is damaged")
    assert contents(tmp_path / "out.mcap") == contents(path)
    assert record(tmp_path / "out.mcap")["losses"][0]["count"] == 1
    assert evaluate(damaged(tmp_path / "d.mcap"), "--mcap", tmp_path / "o.mcap") == 3
    assert len(metrics(tmp_path / "o.mcap")) == 80


def summary_of(path: Path) -> Any:
    with path.open("rb") as stream:
        return make_reader(stream).get_summary()


def test_memory_does_not_grow_with_the_result(tmp_path: Path) -> None:
    """40 MB of messages in chunks of 1 MB; reader and writer have some copies of one each."""
    path, noise = tmp_path / "r.mcap", np.random.default_rng(0)
    with begin(path) as writer:
        for k in range(400):
            data = noise.bytes(100_000)
            writer.add_truth(TruthMessage("/truth/noise", "", "", b"", "raw", k, data))
            write_frames(writer, 1, truth=False)  # the tenth ends a chunk
        writer.finish({})
    tracemalloc.start()
    mcap_report.write_mcap(path, tmp_path / "out.mcap", [], {})
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert path.stat().st_size > 40e6 and peak < 10e6


def test_the_documented_reader_reads_every_message(
    evaluated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The snippet as it stands in the documentation; then a file with a truth in ROS 2, too."""
    monkeypatch.chdir(tmp_path)
    assert evaluate(write_result(tmp_path / "r.mcap", 12, smoothed_mm=2.0), "--mcap", "evaluated.mcap") == 0
    (snippet,) = (b.text for b in blocks(ROOT / "docs" / "eval.md") if "iter_decoded_messages" in b.text)
    names: dict[str, Any] = {}
    exec(snippet, names)
    found = metrics(tmp_path / "evaluated.mcap")
    assert capsys.readouterr().out.splitlines() == [f"{m['log']} {m['joint_error_mm']}" for m in found]
    with evaluated.open("rb") as stream:
        decoders = [DecoderFactory(), names["JsonDecoder"](), Ros2DecoderFactory()]
        reader = make_reader(stream, decoder_factories=decoders)
        read = {(c.topic, m.sequence): value for _, c, m, value in reader.iter_decoded_messages()}
    assert len(read) == len(contents(evaluated)["messages"]) + 2 * FRAMES
    assert read["/truth/hand/note", 0].data == 1.5
    assert read["/hand/odometry", 3].pose.position.z == pytest.approx(0.65, abs=0.1)
    assert read["/eval/hand", 3]["cost_mm"] == 5.0


def test_documented_fields_exist(evaluated: Path) -> None:
    text = (ROOT / "docs" / "eval.md").read_text(encoding="utf-8")
    told = set(re.findall(r"`(/(?:eval/)?hand(?:/estimate)?)\.(\w+)`", text))
    schemas = {
        c.topic: json.loads(s.data)["properties"]
        for s, c in McapFile(evaluated).channels()
        if s and s.encoding == "jsonschema" and c.topic in ("/eval/hand", "/hand/estimate")
    }
    of_images = {("/eval/hand", name) for name in ("residual_mm", "region_overlap")}  # with --recording
    assert len(told) > 6 and {name for _, name in of_images} <= set(catalogue())
    assert all(name in schemas[topic] for topic, name in told - of_images)


def test_protobuf_messages_are_read_by_their_topics(evaluated: Path) -> None:
    with pytest.warns(DeprecationWarning):
        from mcap_protobuf.reader import read_protobuf_messages
    read = list(read_protobuf_messages(evaluated, topics=["/hand/odometry"]))
    assert len(read) == FRAMES
