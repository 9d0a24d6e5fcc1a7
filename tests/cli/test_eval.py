"""``posetrack eval`` end to end, on small results."""

from __future__ import annotations

import csv
import filecmp
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.evaluation.measuring.catalogue import CATALOGUE
from posetrack_cli.outputs import part_path
from posetrack_cli.results import Estimate, ResultWriter, Status, Subject
from support.eval_command import CAMERA, damaged, killed_run, truth_message, write_result
from support.tracks import hand_track

TESTS = Path(__file__).parents[1]
PASSES, FAILS = "joint_error_mm.mean > 1000", "joint_error_mm.mean > 0.001"


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("result") / "rbpf.mcap")


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("other") / "pf.mcap", error_mm=9.0, seed=2)


def evaluate(*arguments: object) -> int:
    return run(["eval", *map(str, arguments)])


def lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.strip()]


def shown(text: str) -> dict[str, list[str]]:
    """The table's rows by their label."""
    return {line.split()[0]: line.split()[1:] for line in lines(text)}


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a killed run left of ``r.mcap``: of 45 frames four flushes of ten."""
    return killed_run(tmp_path_factory.mktemp("killed") / "r.mcap", 45)


def test_the_figures_are_those_of_the_result(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(result) == 0
    out, err = capsys.readouterr()
    track, truth = hand_track("", 90, 5.0, 1), hand_track("", 90, 0.0)
    errors = np.linalg.norm(track.points - truth.points, axis=2)
    table = shown(out)
    assert table["rbpf"] == ["mean/value", "sd", "median", "p95", "max", "p5"]
    expected = [errors.mean(), errors.std(), np.median(errors), np.percentile(errors, 95), errors.max()]
    # four digits are shown: half a unit of the fourth
    np.testing.assert_allclose([float(cell) for cell in table["joint_error_mm"]], expected, rtol=5e-4)
    assert table["coverage"] == ["1"] and table["frames"] == ["90"] and table["particles"] == ["64"]
    assert "renderer: none" in out and err == ""


def test_coverage_comes_first(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate(result)
    assert lines(capsys.readouterr().out)[2].startswith("coverage")


def test_parts(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate(result)
    assert "index_tip" not in capsys.readouterr().out
    evaluate(result, "--parts")
    assert "  index_tip" in capsys.readouterr().out


def test_lost_frames_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_result(tmp_path / "r.mcap", frames=40, lost=range(10))
    assert evaluate(path) == 0
    table = shown(capsys.readouterr().out)
    assert table["coverage"] == ["0.7500"] and table["lost"] == ["10"] and table["matched"] == ["40"]


def test_a_gate_that_holds(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(result, "--fail-if", PASSES, "--fail-if", "coverage < 0.99") == 0
    out, err = capsys.readouterr()
    assert err == "" and "gates: 2 passed, 0 failed" in out


def test_a_gate_that_fails_is_one_line_with_its_figure(
    result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(result, "--fail-if", FAILS, "--fail-if", PASSES, "--fail-if", "coverage == 1") == 1
    out, err = capsys.readouterr()
    first, second = lines(err)
    figure = float(first.rpartition(" ")[2])
    assert first.startswith("rbpf: gate 'joint_error_mm.mean > 0.001' failed: joint_error_mm.mean is ")
    assert figure == pytest.approx(float(shown(out)["joint_error_mm"][0]), rel=5e-4)
    assert second == "rbpf: gate 'coverage == 1' failed: coverage is 1"


@pytest.mark.parametrize(
    ("made", "gate", "reason"),
    [
        ({"truth": False}, FAILS, "no ground truth"),
        ({"truth": False}, PASSES, "no ground truth"),
        ({}, "ms_per_frame.p95 < 1", "no timings"),
        ({"frames": 0, "truth": False}, "coverage < 0", "no estimate"),
        ({"frames": 0, "truth": False}, "lost > 5", "no estimate"),
        ({"lost": range(90)}, PASSES, "coverage is 0"),
        ({"lost": range(90)}, "joint_error_tracked_mm.mean > 1000", "could not be evaluated"),
        ({"frames": 1}, "jitter_mm.mean > 1000", "could not be evaluated"),
    ],
)
def test_what_cannot_be_judged_fails(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    made: dict[str, object],
    gate: str,
    reason: str,
) -> None:
    path = write_result(tmp_path / "r.mcap", **made)
    assert evaluate(path, "--fail-if", gate) == 1
    (line,) = lines(capsys.readouterr().err)
    assert line.startswith(f"r: gate '{gate}' could not be evaluated: ") and reason in line


def test_coverage_0_fails_its_own_gate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_result(tmp_path / "r.mcap", lost=range(90))
    assert evaluate(path, "--fail-if", "coverage < 0.99") == 1
    assert lines(capsys.readouterr().err) == ["r: gate 'coverage < 0.99' failed: coverage is 0"]


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_hardly_any_frames_are_evaluated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frames: int
) -> None:
    path = write_result(tmp_path / "r.mcap", frames=frames, truth=frames > 0)
    assert evaluate(path, "--json", tmp_path / "r.json", "--csv", tmp_path / "r.csv") == 0
    assert shown(capsys.readouterr().out)["frames"] == [str(frames)]
    assert json.loads((tmp_path / "r.json").read_text())["results"][0]["coverage"]["frames"] == frames


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--fail-if", "joint_eror_mm.mean > 1"], "did you mean 'joint_error_mm'"),
        (["--fail-if", "joint_error_mm > 1"], "lacks a statistic"),
        (
            ["--fail-if", "coverage is 1"],
            "METRIC[.PART][.STATISTIC] OPERATOR NUMBER, with OPERATOR one of > >=",
        ),
        (["--fail-if", "coverage < 99%"], "write 0.99 for 99 %"),
        (["--truth-tolerance-ms", "-1"], "tolerance out of range"),
        (["--align", "loose"], "'loose' is not one of"),
        (["--baseline-tolerance", "-1"], "-1"),
        (["--baseline-tolerance", "nan"], "nan is not a finite number"),
        (["--baseline-tolerance", "inf"], "inf is not a finite number"),
        (["--baseline", "/nowhere/a.json", "--baseline", "/nowhere/b.json"], "given more than once"),
        (["--time-offset-s", "1e300"], "time offset out of range"),
        (["--group", "a"], "invalid group 'a', expected NAME=PATTERN"),
        (["--group", "a=/nowhere/*.mcap"], "no file matches the pattern of group 'a', found /nowhere/*.mcap"),
        (["--group", "a=/tmp/"], "found /tmp/; for a folder, use /tmp/*.mcap"),
        (["--json", "-", "--csv", "-"], "more than one report goes to standard output"),
        (
            ["--gates", "/nowhere/gates.txt"],
            "/nowhere/gates.txt: gate file cannot be read, found No such file",
        ),
        (["--baseline", "/nowhere/b.json"], "/nowhere/b.json: baseline cannot be read"),
        (["--html", "/tmp/page.txt"], "expected a name that ends with .html"),
    ],
)
def test_wrong_usage_is_one_line_and_2(
    result: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert evaluate(result, *arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(lines(err)) == 1 and said in err


def test_the_metrics_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate("--list-metrics") == 0
    out = lines(capsys.readouterr().out)
    assert "joint_error_mm[.JOINT].STATISTIC, mm, lower is better" in out
    assert "coverage, higher is better" in out and len(out) == 2 * len(CATALOGUE) + 3


def test_no_result_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate() == 2
    assert "no result to evaluate" in capsys.readouterr().err


def test_gates_from_a_file(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gates = tmp_path / "gates.txt"
    gates.write_text(f"# accuracy\n{PASSES}\n{FAILS}  # never\n")
    assert evaluate(result, "--gates", gates) == 1
    assert len(lines(capsys.readouterr().err)) == 1
    gates.write_text("coverage < 0.99\njoint_error_mm.mean >\n")
    assert evaluate(result, "--gates", gates) == 2
    assert f"{gates}:2: " in capsys.readouterr().err


def test_a_killed_run_is_evaluated_over_what_it_holds(
    killed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(killed, "--json", tmp_path / "r.json") == 3
    out, err = capsys.readouterr()
    (line,) = lines(err)
    assert line.startswith("r: only the readable part was measured: ")
    assert shown(out)["frames"] == ["40"]
    assert "unfinished run" in out
    assert json.loads((tmp_path / "r.json").read_text())["results"][0]["losses"]


def test_a_failed_gate_wins_over_lost_data_and_both_are_told(
    killed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(killed, "--fail-if", FAILS) == 1
    gate, loss = lines(capsys.readouterr().err)
    assert "failed" in gate and "only the readable part was measured" in loss


def test_a_name_whose_run_was_killed_says_where_it_is(
    killed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(killed.with_name("r.mcap")) == 1
    (line,) = lines(capsys.readouterr().err)
    assert str(killed) in line


def test_a_run_that_is_going_on_is_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "r.mcap"
    going = subprocess.Popen(
        [sys.executable, "-m", "support.eval_command", str(path), "30", "wait"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=TESTS,
    )
    try:
        assert going.stdout is not None
        assert going.stdout.readline() == b"written\n"
        assert evaluate(part_path(path)) == 3
        assert shown(capsys.readouterr().out)["frames"] == ["30"]
    finally:
        going.kill()
        going.communicate()


def test_a_damaged_chunk_costs_its_own_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(damaged(tmp_path / "r.mcap")) == 3
    out, err = capsys.readouterr()
    assert len(lines(err)) == 1 and "only the readable part was measured" in err
    assert shown(out)["frames"] == ["80"]  # 90 in chunks of ten


@pytest.mark.parametrize("content", [None, b"", b"no MCAP", b"\x89MCAP0\r\n"])
def test_a_result_that_cannot_be_read_is_one_line_that_names_it(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None
) -> None:
    bad = tmp_path / "bad.mcap"
    if content is not None:
        bad.write_bytes(content)
    assert evaluate(result, bad) == 1
    out, err = capsys.readouterr()
    assert out == "" and len(lines(err)) == 1 and str(bad) in err


def test_two_results_stand_beside_each_other(
    result: Path, other: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(result, other) == 0
    out = capsys.readouterr().out
    header = next(line for line in lines(out) if line.startswith("Results"))
    assert header.split() == ["Results", "rbpf", "pf"]
    assert "pf - rbpf" in out
    row = next(line for line in lines(out) if line.startswith("joint_error_mm ") and "\u00b1" not in line)
    assert float(row.split()[1]) > 0 and row.split()[-1] == "3"  # 90 frames at 30 Hz are three seconds
    assert "pairs: one second of a recording" in out


def test_results_of_two_recordings_are_not_compared(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(result, write_result(tmp_path / "x.mcap", recording="bb")) == 0
    out = capsys.readouterr().out
    assert "pairs: " not in out and "not compared: no two results have the same recording" in out


def test_results_of_one_name_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        write_result(tmp_path / folder / "r.mcap", frames=5)
    assert evaluate(tmp_path / "one" / "r.mcap", tmp_path / "two" / "r.mcap", "--fail-if", FAILS) == 1
    assert [line.split(":")[0] for line in lines(capsys.readouterr().err)] == ["one/r", "two/r"]


def study(folder: Path, count: int = 7) -> None:
    """Two trackers on recordings 0, 1, 2, ...; pf is worse by 3 mm of noise on each."""
    for index in range(count):
        for name, error, seed in (("rbpf", 4.0, index), ("pf", 7.0, 100 + index)):
            write_result(
                folder / f"{name}-{index}.mcap", frames=20, error_mm=error, recording=f"r{index}", seed=seed
            )


def test_groups_are_paired_by_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    study(tmp_path)
    assert evaluate("--group", "rbpf=rbpf-*.mcap", "--group", "pf=pf-*.mcap", "--json", "r.json") == 0
    out = capsys.readouterr().out
    header, counts, coverage = lines(out)[:3]
    assert header.split()[-2:] == ["rbpf", "pf"]
    assert counts.split() == ["results", "7", "7"] and coverage.startswith("coverage")
    row = [line.split() for line in lines(out) if line.startswith("joint_error_mm.mean")][1]
    assert float(row[1]) > 0 and row[4:] == ["0.016", "7"]  # 2 / 2^7: pf is worse on all seven
    assert "pairs: one recording" in out and "seeds differ" in out
    report = json.loads((tmp_path / "r.json").read_text())
    assert len(report["results"]) == 14
    assert report["comparison"]["groups"]["pf"]["coverage"]["count"] == 7


def test_gates_meet_every_result_of_a_group(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study(tmp_path, 2)
    assert evaluate("--group", f"rbpf={tmp_path}/rbpf-*.mcap", "--fail-if", FAILS) == 1
    assert [line.split(":")[0] for line in lines(capsys.readouterr().err)] == ["rbpf-0", "rbpf-1"]


def test_a_file_in_two_groups_is_refused(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate("--group", f"a={result}", "--group", f"b={result}") == 2
    assert f"{result}: file is in two groups, found a and b" in capsys.readouterr().err


def test_one_result_given_twice_is_one(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(result, result, "--fail-if", FAILS) == 1
    assert len(lines(capsys.readouterr().err)) == 1


def test_a_baseline_goes_round(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    baseline = tmp_path / "baseline.json"
    assert evaluate(result, "--json", baseline) == 0
    assert evaluate(result, "--baseline", baseline, "--baseline-tolerance", "0") == 0
    worse = write_result(tmp_path / "now.mcap", error_mm=9.0)
    capsys.readouterr()
    assert evaluate(worse, "--baseline", baseline) == 1
    failed = lines(capsys.readouterr().err)
    assert all(line.startswith("now: gate '") and "baseline" in line for line in failed)
    assert any("'joint_error_mm.mean > " in line for line in failed)
    assert not any("ms_per_frame" in line for line in failed)
    assert evaluate(worse, "--baseline", baseline, "--baseline-tolerance", "3") == 0
    assert evaluate(result, "--baseline", baseline) == 0


def test_a_shorter_run_than_the_baseline_is_noted(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    baseline = tmp_path / "baseline.json"
    evaluate(result, "--json", baseline)
    capsys.readouterr()
    evaluate(
        write_result(tmp_path / "now.mcap", frames=80), "--baseline", baseline, "--baseline-tolerance", "1"
    )
    assert "baseline: now: 80 frames, 90 in the baseline" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["{", '{"format": "posetrack.eval/9"}', "[1]"])
def test_a_broken_baseline_is_wrong_usage(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    baseline = tmp_path / "baseline.json"
    baseline.write_text(content)
    assert evaluate(result, "--baseline", baseline) == 2
    (line,) = lines(capsys.readouterr().err)
    assert str(baseline) in line


def test_json_on_standard_output_is_nothing_but_json(
    result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(result, "--json", "-", "--fail-if", FAILS) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["format"] == "posetrack.eval/1"
    assert report["gates"][0]["failed"] is True
    assert report["results"][0]["run"]["input.sha256"] == "aa"
    assert report["options"]["tolerance_ms"] == 5.0


def test_csv_on_standard_output_is_nothing_but_csv(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(result, "--csv", "-") == 0
    header, *rows = csv.reader(lines(capsys.readouterr().out))
    assert header == ["result", "metric", "part", "statistic", "value", "unit"]
    assert {len(row) for row in rows} == {6} and {row[0] for row in rows} == {"rbpf"}


def test_reports_are_written_when_a_gate_fails_and_are_the_same_each_time(
    result: Path, tmp_path: Path
) -> None:
    names = [(tmp_path / f"{n}.json", tmp_path / f"{n}.csv", tmp_path / f"{n}.html") for n in "ab"]
    for as_json, as_csv, as_html in names:
        arguments = ["--json", as_json, "--csv", as_csv, "--html", as_html, "--fail-if", FAILS]
        assert evaluate(result, *arguments) == 1
    for first, second in zip(*names, strict=True):
        assert filecmp.cmp(first, second, shallow=False) and first.stat().st_size > 1000
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [
        ".csv",
        ".csv",
        ".html",
        ".html",
        ".json",
        ".json",
    ]


def test_existing_reports_are_replaced_on_demand_only(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "r.json"
    report.write_text("mine")
    assert evaluate(result, "--json", report) == 2
    assert report.read_text() == "mine" and "--overwrite" in capsys.readouterr().err
    assert evaluate(result, "--json", report, "--overwrite") == 0
    assert json.loads(report.read_text())["results"]


@pytest.mark.parametrize("option", ["--json", "--csv"])
def test_a_report_never_replaces_what_is_read(
    result: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    before = result.read_bytes()
    assert evaluate(result, option, result, "--overwrite") == 2
    assert "would overwrite an input" in capsys.readouterr().err
    assert result.read_bytes() == before


def test_two_reports_in_one_file_are_refused(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(result, "--json", tmp_path / "r", "--csv", tmp_path / "r") == 2
    assert "would overwrite another report" in capsys.readouterr().err


@pytest.mark.parametrize(("where", "code"), [("none/r.json", 1), (".", 2)])
def test_a_report_without_a_place_is_refused_before_the_work(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], where: str, code: int
) -> None:
    assert evaluate(result, "--json", tmp_path / where) == code
    out, err = capsys.readouterr()
    assert out == "" and len(lines(err)) == 1


def test_truth_from_another_result(tmp_path: Path, result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blind = write_result(tmp_path / "blind.mcap", truth=False)
    assert evaluate(blind) == 0
    assert "not available (no ground truth" in capsys.readouterr().out
    assert evaluate(blind, "--truth", result) == 0
    assert "joint_error_mm" in shown(capsys.readouterr().out)


def head_result(path: Path, off_mm: tuple[float, float, float]) -> Path:
    """A head that faces the camera, its estimate off by the same vector in every frame."""
    points = np.array([[-30.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    subject = Subject("head", "camera", (), ("left", "right"), (-1, -1))

    def at(row: int, position: np.ndarray) -> Estimate:
        nothing, own = np.zeros(6), position + points @ np.diag([1.0, -1.0, -1.0])
        return Estimate(
            frame_index=row,
            stamp_ns=row * 10**8,
            status=Status.TRACKING,
            confidence=1.0,
            position=position,
            quaternion=np.array([1.0, 0.0, 0.0, 0.0]),
            shape=np.empty(0),
            pose_rate=np.zeros(7),
            twist=nothing,
            pose_variance=nothing + 1.0,
            twist_variance=nothing + 1.0,
            points=own,
            effective_sample_size=1.0,
            resampled=False,
        )

    with ResultWriter(path, subject, CAMERA, {}) as writer:
        for row in range(10):
            true = np.array([row, 2.0 * row, 700.0])
            writer.add_truth(truth_message("/truth/head/estimate", at(row, true)))
            writer.write(at(row, true + np.array(off_mm)))
        writer.finish({})
    return path


def test_heads_have_the_thesis_s_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = head_result(tmp_path / "head.mcap", (1.0, -2.0, 4.0))
    assert evaluate(path, "--fail-if", "point_error_mm.left.max > 0.001", "--fail-if", "z_mm.mean > 4.5") == 0
    table = shown(capsys.readouterr().out)
    # the points move with the head, so in head coordinates they have no error; rounding is far below 1e-6
    assert [float(cell) for cell in table["mean"]] == pytest.approx([1, 2, 4, 0, 0, 0], abs=1e-6)
    assert [float(cell) for cell in table["sd"]] == pytest.approx([0] * 6, abs=1e-6)
    assert evaluate(path, "--fail-if", "point_error_mm.nose.max > 1") == 2
    assert "metric 'point_error_mm' has no 'nose' here" in capsys.readouterr().err
    assert evaluate(path, "--fail-if", "joint_error_mm.mean > 1") == 1
    assert "not a head metric" in capsys.readouterr().err


def test_removing_the_offset_is_told_in_the_table(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(result, "--align", "rigid") == 0
    assert "note: " in capsys.readouterr().out


def test_names_of_any_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On terminals that cannot show them: ``test_environments``."""
    assert evaluate(*(write_result(tmp_path / n, frames=5) for n in ("\u624b[1].mcap", "a b.mcap"))) == 0
    out, err = capsys.readouterr()
    assert "\u624b[1]" in out and "a b" in out and err == ""


@pytest.mark.parametrize(("gate", "code", "buffered"), [(PASSES, 0, False), (FAILS, 1, True)])
def test_a_reader_that_leaves_early_does_not_change_what_gates_say(
    result: Path, gate: str, code: int, buffered: bool
) -> None:
    environment = {**os.environ, "PYTHONUNBUFFERED": "" if buffered else "1"}
    arguments = [sys.executable, "-m", "posetrack_cli.cli.main", "eval", str(result), "--fail-if", gate]
    reading, writing = os.pipe()
    os.close(reading)  # nobody reads the table
    done = subprocess.run(arguments, stdout=writing, stderr=subprocess.PIPE, text=True, env=environment)
    os.close(writing)
    assert done.returncode == code
    assert ("joint_error_mm.mean is" in done.stderr) == (code == 1) and len(lines(done.stderr)) == code


def test_a_report_cannot_go_to_a_closed_standard_output(result: Path) -> None:
    command = f"{sys.executable} -m posetrack_cli.cli.main eval '{result}' --json - >&-"
    done = subprocess.run(command, shell=True, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2 and "standard output is closed" in done.stderr


def test_a_closed_standard_output_stops_no_report(result: Path, tmp_path: Path) -> None:
    page = tmp_path / "r.json"
    command = (
        f"{sys.executable} -m posetrack_cli.cli.main eval '{result}' --json '{page}' --fail-if '{FAILS}' >&-"
    )
    done = subprocess.run(command, shell=True, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1 and "joint_error_mm.mean is" in done.stderr and len(lines(done.stderr)) == 1
    assert json.loads(page.read_text())["results"][0]["name"] == "rbpf"


def test_the_curve_is_written_as_csv(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(result, "--curve", "-") == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert [row["d_mm"] for row in rows] == [str(d) for d in range(101)]
    assert evaluate(result, "--json", "-") == 0
    metrics = json.loads(capsys.readouterr().out)["results"][0]["metrics"]
    assert float(rows[10]["rbpf largest"]) == metrics["frames_within_10mm"]["value"]
    assert float(rows[10]["rbpf mean"]) == metrics["frames_mean_within_10mm"]["value"]
    assert float(rows[10]["rbpf mean"]) >= float(rows[10]["rbpf largest"])


def test_joints_of_another_convention(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The truth's joints are all marked 12 mm farther from the camera."""
    result, truth = write_result(tmp_path / "r.mcap", 60, error_mm=1.0), hand_track("truth", 60, 0.0)
    names = [f"{name}_{axis}_mm" for name in truth.point_names for axis in "xyz"]
    rows = (truth.points + np.array([0.0, 0.0, 12.0])).reshape(60, -1)
    lines = [",".join(["stamp_ns", *names])]
    lines += [",".join(map(str, [stamp, *row])) for stamp, row in zip(truth.stamp_ns, rows, strict=True)]
    (tmp_path / "truth.csv").write_text("\n".join(lines))
    errors, removed = {}, {}
    for axes in ("none", "camera"):
        more = [] if axes == "none" else ["--joint-offsets", axes]
        assert evaluate(result, "--truth", tmp_path / "truth.csv", *more, "--json", "-") == 0
        (found,) = json.loads(capsys.readouterr().out)["results"]
        errors[axes] = found["metrics"]["joint_error_mm"]["mean"]
        removed[axes] = found["joint_offsets"]
    assert errors["none"] > 11.0
    assert errors["camera"] < 3.0  # 1 mm of noise in each direction, and what it turns the hand by
    assert removed["none"] is None and removed["camera"]["axes"] == "camera"
    assert removed["camera"]["mm"]["index_tip"][2] == pytest.approx(12.0, abs=1.0)
    assert evaluate(result, "--truth", tmp_path / "truth.csv", "--joint-offsets", "bone") == 0
    told = capsys.readouterr().out
    assert "Removed joint offsets, mm" in told and "removed constant offset of each joint" in told
    assert "index_tip" in told


HONESTY = (
    "frames_wrong",
    "frames_far_tracked",
    "frames_right_lost",
    "confidence_roc_area",
    "confidence_brier_score",
    "confidence_calibration_error",
)


People = Mapping[bool, list[Path]]


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> People:
    """Results of three recordings, about half of whose frames are wrong, by whether they know which."""
    return {
        knows: [
            write_result(folder / f"p{k}.mcap", error_mm=12.0, recording=f"r{k}", seed=k, knows=knows)
            for k in range(3)
        ]
        for knows, folder in ((knows, tmp_path_factory.mktemp("people")) for knows in (True, False))
    }


def errors_of(seed: int) -> np.ndarray:
    track, truth = hand_track("", 90, 12.0, seed), hand_track("", 90, 0.0)
    return np.linalg.norm(track.points - truth.points, axis=2).mean(axis=1)


def test_what_a_track_says_of_itself_is_measured(
    people: People, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = people[True][0]
    assert evaluate(path, "--json", tmp_path / "r.json") == 0
    table = shown(capsys.readouterr().out)
    assert set(HONESTY) <= set(table)
    wrong = errors_of(0) > 20.0
    assert 0.2 < wrong.mean() < 0.8
    (told,) = json.loads((tmp_path / "r.json").read_text())["results"]
    assert told["metrics"]["frames_wrong"]["value"] == pytest.approx(wrong.mean())
    assert told["metrics"]["confidence_roc_area"]["value"] > 0.95  # joints turn a little, too
    assert told["honesty"]["right_if"] == "mean joint error at most 20 mm"
    assert sum(one["count"] for one in told["honesty"]["reliability"]) == 90
    assert len(told["honesty"]["roc"]["confidence"]) == 91
    # the stated variances are those that errors were drawn with; three coordinates of 90 frames
    wrist = told["metrics"]["joint_inside_90.wrist"]["value"]
    assert wrist == pytest.approx(0.9, abs=4.0 * np.sqrt(0.9 * 0.1 / 270))


def test_confidence_of_every_tenth_is_shown_on_request(
    people: People, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = people[True]
    assert evaluate(paths[0]) == 0
    assert "share correct" not in capsys.readouterr().out
    assert evaluate(paths[0], "--honesty") == 0
    out = capsys.readouterr().out
    rows = [line.split()[3:] for line in lines(out) if line.startswith("0.") and " to " in line]
    assert len(rows) == 10 and sum(int(row[0]) for row in rows) == 90
    assert "correct: mean joint error at most 20 mm; far off: mean joint error above 40 mm" in out
    assert "Pooled over results" not in out  # of one
    assert evaluate(*paths, "--honesty") == 0
    out = capsys.readouterr().out
    pooled = out[out.index("Pooled over results") :]
    assert shown(pooled)["frames"] == ["270"] and set(HONESTY) <= set(shown(pooled))


@pytest.mark.parametrize(
    ("gate", "knows", "code"),
    [
        ("pooled.confidence_roc_area < 0.9", True, 0),
        ("pooled.confidence_roc_area < 0.9", False, 1),
        ("confidence_roc_area < 0.9", False, 1),
        ("pooled.frames_far_tracked > 0.01", True, 1),
        ("pooled.coverage < 1", True, 0),
    ],
)
def test_gates_on_honesty(
    people: People, capsys: pytest.CaptureFixture[str], gate: str, knows: bool, code: int
) -> None:
    assert evaluate(*people[knows], "--fail-if", gate) == code
    told = lines(capsys.readouterr().err)
    assert len(told) == (0 if not code else 1 if gate.startswith("pooled.") else 3)
    if not knows:
        assert told[0].split(":")[0] == ("pooled" if gate.startswith("pooled.") else "p0")
        assert told[0].endswith("confidence_roc_area is 0.5")  # it always says 0.8


def test_the_pooled_figure_is_that_of_all_frames(people: People, tmp_path: Path) -> None:
    evaluate(*people[True], "--json", tmp_path / "r.json", "--csv", tmp_path / "r.csv")
    (pooled,) = json.loads((tmp_path / "r.json").read_text())["pooled"]
    wrong = np.concatenate([errors_of(seed) for seed in range(3)]) > 20.0
    assert pooled["metrics"]["frames_wrong"]["value"] == pytest.approx(wrong.mean())
    assert pooled["results"] == ["p0", "p1", "p2"]
    with (tmp_path / "r.csv").open() as file:
        found = {(row[0], row[1]): row[4] for row in csv.reader(file) if not row[2] and not row[3]}
    assert float(found["pooled", "confidence_roc_area"]) == pooled["metrics"]["confidence_roc_area"]["value"]


def test_groups_are_pooled_each(people: People, capsys: pytest.CaptureFixture[str]) -> None:
    knows, sure = (people[knows][0].parent for knows in (True, False))
    groups = ("--group", f"knows={knows}/p*.mcap", "--group", f"sure={sure}/p*.mcap")
    assert evaluate(*groups, "--fail-if", "pooled.confidence_brier_score > 0.2") == 1
    (line,) = lines(capsys.readouterr().err)
    assert line.startswith("pooled sure: gate 'pooled.confidence_brier_score > 0.2' failed: ")


def test_results_of_one_recording_have_no_pooled_figure(
    result: Path, other: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(result, other, "--honesty", "--fail-if", "pooled.frames_wrong > 1") == 1
    out, err = capsys.readouterr()
    assert "Pooled over results" not in out
    reason = "rbpf and pf are of the same recording, so the results are not pooled"
    assert err.startswith(f"pooled: gate 'pooled.frames_wrong > 1' could not be evaluated: {reason}")


def test_a_page_has_the_diagram_and_the_curve(people: People, tmp_path: Path) -> None:
    page = tmp_path / "r.html"
    evaluate(*people[True], "--html", page)
    text = page.read_text()
    assert 'id="reliability-plot"' in text and 'id="roc-plot"' in text
    assert "Correct: mean joint error at most 20 mm; far off: mean joint error above 40 mm." in text
    data = json.loads(text.split('id="report-data">')[1].split("</script>")[0])
    assert [one["name"] for one in data["pools"]] == ["pooled"]
    for one in (*data["results"], *data["pools"]):
        assert len(one["honesty"]["confidence"]) > 3 and one["honesty"]["roc"]["area"] > 0.9
