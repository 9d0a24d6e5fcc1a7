"""``posetrack export`` as a user meets it: names, exit codes, one line for each mistake."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.export import FORMATS
from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_FAILED, EXIT_USAGE
from posetrack_cli.evaluation.reading.truth_tables import load_csv_track
from posetrack_cli.results import ResultWriter, Status, load_arrays
from posetrack_cli.results.export import export as library
from support.results import CAMERA, RUN, SUBJECT, make_estimate, write_result

FRAMES = 26


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_result(tmp_path / "r.mcap", FRAMES)


def told(capfd: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error."""
    captured = capfd.readouterr()
    assert captured.err.count("\n") == 1, captured.err
    return captured.err


def rows(text: str) -> list[str]:
    """The lines of a CSV file below its header row."""
    return text.splitlines()[1:]


def test_formats_are_those_of_the_library() -> None:
    # Hands and heads are no matter of results, BIDS is a folder, and protobuf is chosen by --schemas.
    of_commands = {"bvh", "openface", "arkit", "blinks", "mediapipe", "bids"}
    assert set(FORMATS) == {*library.FORMATS, *of_commands} - {"protobuf"}


def test_csv_goes_to_standard_output_and_nothing_else(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], ["--format", "csv"], ["-o", "-"]):
        assert run(["export", str(path), *arguments]) == EXIT_DONE
        captured = capfd.readouterr()
        assert len(rows(captured.out)) == FRAMES
        assert captured.err == ""
    assert [entry.name for entry in path.parent.iterdir()] == ["r.mcap"]


@pytest.mark.parametrize("name", ["a.csv", "a.tum", "a.json", "a.npz", "A.NPZ", "a"])
def test_format_is_taken_from_the_files_name(
    path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    out = path.with_name(name)
    assert run(["export", str(path), "-o", str(out)]) == EXIT_DONE
    kind = out.suffix[1:].lower() or "csv"
    assert capfd.readouterr().out == f"{out}: {kind}, {out.stat().st_size} bytes\n"
    if kind == "json":
        assert json.loads(out.read_text())["header"]["result"] == "r.mcap"
    elif kind == "npz":
        with np.load(out) as arrays:
            np.testing.assert_array_equal(arrays["points"], load_arrays(path)["points"])
    elif kind == "tum":
        assert np.loadtxt(out).shape == (FRAMES, 8)
    else:
        assert len(rows(out.read_text())) == FRAMES


def test_format_that_is_given_counts_more_than_the_name(path: Path) -> None:
    out = path.with_name("a.csv")
    assert run(["export", str(path), "-o", str(out), "--format", "tum", "--no-lost"]) == EXIT_DONE
    assert len(np.loadtxt(out)) == sum(load_arrays(path)["status"] != "lost") < FRAMES


def test_an_existing_file_is_kept_unless_it_may_be_replaced(
    path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = path.with_name("a.csv")
    out.write_text("precious")
    assert run(["export", str(path), "-o", str(out)]) == EXIT_USAGE
    assert "already exists; use --overwrite to replace it" in told(capfd)
    assert out.read_text() == "precious"
    assert run(["export", str(path), "-o", str(out), "--overwrite"]) == EXIT_DONE
    assert len(rows(out.read_text())) == FRAMES


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["{folder}/gone.mcap"], EXIT_FAILED, "gone.mcap: cannot be read, found No such file"),
        (["{folder}"], EXIT_FAILED, "cannot be read, found Is a directory"),
        (["{folder}/text.mcap"], EXIT_FAILED, "is not an MCAP file"),
        (["{path}", "--format", "npz"], EXIT_USAGE, "npz is not a text format"),
        (["{path}", "--format", "xml"], EXIT_USAGE, "'csv', 'tum', 'npz', 'json', 'parquet', 'nwb', 'bvh'"),
        (
            ["{path}", "-o", "{folder}/a.feather"],
            EXIT_USAGE,
            "found .feather, expected _motion.tsv, .csv, .tum",
        ),
        (["{path}", "-o", "{folder}/a.tsv"], EXIT_USAGE, "--format: csv, tum, npz, json, parquet, nwb"),
        (["{path}", "--format", "nwb"], EXIT_USAGE, "nwb is not a text format"),
        (["{path}", "--format", "bids"], EXIT_USAGE, "bids is not a text format"),
        (
            ["{path}", "--format", "bids", "-o", "{folder}/study"],
            EXIT_USAGE,
            "expected DATASET/sub-01_task-reach",
        ),
        (["{path}", "-o", "{folder}/sub-_task-a_motion.tsv"], EXIT_USAGE, "not a name of BIDS"),
        (["{path}", "--format", "openface"], EXIT_USAGE, "openface requires a result of posetrack head"),
        (["{path}", "--format", "arkit"], EXIT_USAGE, "arkit requires a result with the dense face"),
        (
            ["{path}", "--format", "mediapipe"],
            EXIT_USAGE,
            "mediapipe requires a result of posetrack hand run",
        ),
        (["{path}", "--format", "rom"], EXIT_FAILED, "a hand has no angles"),
        (["{path}", "--session-start", "2026-01-31T10:00:00Z"], EXIT_USAGE, "does not apply to this format"),
        (
            ["{path}", "-o", "{folder}/a.nwb", "--session-start", "2026-01-31T10:00:00"],
            EXIT_USAGE,
            "invalid --session-start, found 2026-01-31T10:00:00, expected date, time and zone",
        ),
        (
            ["{path}", "-o", "{folder}/a.nwb", "--session-start", "2026-01-31T10:00:00Z"],
            EXIT_USAGE,
            "session starts after its first frame",
        ),
        (["{path}", "-o", "{folder}/a.xlsx"], EXIT_USAGE, "or choose one with --format"),
        (["{path}", "-o", "{folder}/a.txt"], EXIT_USAGE, "a.txt: unknown format"),
        (["{path}", "--format", "mcap"], EXIT_USAGE, "mcap is not a text format"),
        (["{path}", "--schemas", "ros2", "-o", "{folder}/a.csv"], EXIT_USAGE, "--schemas requires MCAP"),
        (["{path}", "--schemas", "ros1"], EXIT_USAGE, "'ros1' is not one of 'ros2', 'protobuf'"),
        (["{path}", "--format", "bvh"], EXIT_USAGE, "BVH requires a result of posetrack hand run"),
        (["{path}", "--estimate-topic", "/hand/estimat"], EXIT_FAILED, "did you mean '/hand/estimate'?"),
        (["{path}", "-o", "{path}", "--overwrite"], EXIT_USAGE, "output would replace the result"),
        (["{path}", "-o", "{folder}"], EXIT_USAGE, "output is a folder"),
        (["{path}", "-o", "/dev/null", "--overwrite"], EXIT_USAGE, "output is not a regular file"),
        (["{path}", "-o", "{folder}/gone/a.csv"], EXIT_FAILED, "no folder"),
        ([], EXIT_USAGE, "Missing argument 'RESULT'"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(
    path: Path, arguments: list[str], code: int, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (path.parent / "text.mcap").write_text("hello, world")
    before = path.read_bytes()
    filled = [argument.format(path=path, folder=path.parent) for argument in arguments]
    assert run(["export", *filled]) == code
    captured = capfd.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert path.read_bytes() == before
    assert sorted(entry.name for entry in path.parent.iterdir()) == ["r.mcap", "text.mcap"]


@pytest.mark.parametrize("to_file", [True, False])
def test_what_a_truncated_result_holds_is_exported_with_exit_3(
    path: Path, to_file: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    cut, out = path.with_name("cut.mcap"), path.with_name("a.csv")
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert run(["export", str(cut), *(["-o", str(out)] if to_file else [])]) == EXIT_DATA_LOST
    captured = capfd.readouterr()
    assert captured.err.startswith(f"{cut}: file is truncated, the rest is missing: 1, first byte ")
    assert captured.err.count("\n") == 1
    count = len(rows(out.read_text() if to_file else captured.out))
    assert 0 < count < FRAMES


def test_a_damaged_chunk_is_left_out_with_exit_3(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 0xFF
    path.write_bytes(data)
    assert run(["export", str(path)]) == EXIT_DATA_LOST
    captured = capfd.readouterr()
    assert 0 < len(rows(captured.out)) < FRAMES
    assert "chunk is damaged, its messages are lost: 1" in captured.err


@pytest.mark.parametrize("name", ["hand", "head"])
def test_an_exported_table_is_a_truth_for_eval(tmp_path: Path, name: str) -> None:
    """It comes back to the last bit, but for the axes of a head's points: there and back again."""
    subject = replace(SUBJECT, name=name, triangles=None)
    with ResultWriter(tmp_path / "r.mcap", subject, CAMERA, RUN) as writer:
        for index in range(FRAMES):
            writer.write(make_estimate(index))
        writer.finish({})
    assert run(["export", str(tmp_path / "r.mcap"), "-o", str(tmp_path / "r.csv"), "--no-lost"]) == EXIT_DONE
    track = load_csv_track(tmp_path / "r.csv", subject)
    tracked = [e for i in range(FRAMES) if (e := make_estimate(i)).status is not Status.LOST]
    assert track.stamp_ns.tolist() == [e.stamp_ns for e in tracked]
    np.testing.assert_array_equal(track.position, [e.position for e in tracked])
    np.testing.assert_allclose(track.quaternion, [e.quaternion for e in tracked], rtol=0, atol=1e-15)
    np.testing.assert_allclose(track.points, [e.points for e in tracked], rtol=0, atol=1e-9)
    if name == "hand":
        np.testing.assert_array_equal(track.shape, [e.shape for e in tracked])
        np.testing.assert_array_equal(track.twist, [e.twist for e in tracked])


def test_a_reader_that_stops_early_is_no_stack_trace(path: Path) -> None:
    command = [sys.executable, "-m", "posetrack_cli.cli.main", "export", str(write_long(path))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline().startswith(b"frame_index,stamp_ns,")
        process.stdout.close()
        assert process.wait(60) == EXIT_FAILED
        assert process.stderr.read() == b""


def write_long(path: Path) -> Path:
    """A result whose table does not fit into a pipe."""
    return write_result(path.with_name("long.mcap"), 600)
