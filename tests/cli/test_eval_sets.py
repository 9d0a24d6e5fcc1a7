"""``posetrack eval`` of many results end to end: rows, totals, gates on them, baselines, reports for CI."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from support.eval_command import write_result
from support.tracks import hand_track

ERRORS_MM = (3.0, 9.0, 1.0, 6.0, 4.0, 2.0)
FRAMES = (40, 10, 20, 30, 20, 20)
NAMES = [f"take-{place}" for place in range(len(ERRORS_MM))]
SHOWN_DIGITS = 5e-4
"""Four digits are shown: half a unit of the fourth."""


def write_set(folder: Path, errors: Sequence[float] = ERRORS_MM) -> list[Path]:
    folder.mkdir()
    return [
        write_result(folder / f"{name}.mcap", frames, error, recording=name, seed=1)
        for name, error, frames in zip(NAMES, errors, FRAMES, strict=True)
    ]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_set(tmp_path_factory.mktemp("set") / "results")


@pytest.fixture(scope="module")
def baseline(results: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("baseline") / "baseline.json"
    assert evaluate(*results, "--json", path) == 0
    return path


def evaluate(*arguments: object) -> int:
    return run(["eval", *map(str, arguments)])


def joint_errors(error_mm: float, frames: int) -> np.ndarray:
    track, truth = hand_track("", frames, error_mm, 1), hand_track("", frames, 0.0)
    return np.linalg.norm(track.points - truth.points, axis=2)


def table_of(text: str) -> dict[str, list[str]]:
    """The rows of the first table by their label, without the two lines of headings."""
    block = text.split("\n\n")[0].splitlines()[2:]
    return {line.split("  ")[0].strip(): line.split()[-5:] for line in block}


def test_the_table_has_the_worst_first_and_the_total_of_all_frames(
    results: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(*results) == 0
    out, err = capsys.readouterr()
    table = table_of(out)
    assert list(table) == ["take-1", "take-3", "take-4", "take-0", "take-5", "take-2", "TOTAL of 6"]
    samples = [joint_errors(error, frames) for error, frames in zip(ERRORS_MM, FRAMES, strict=True)]
    every = np.concatenate([one.ravel() for one in samples])
    total = [float(cell) for cell in table["TOTAL of 6"][:4]]
    expected = [sum(FRAMES), 1.0, every.mean(), np.percentile(every, 95)]
    np.testing.assert_allclose(total, expected, rtol=2 * SHOWN_DIGITS)  # percentiles by bins of as much
    assert float(table["take-1"][2]) == pytest.approx(samples[1].mean(), rel=SHOWN_DIGITS)
    assert err == "" and "pairs: " not in out


def test_as_many_rows_as_asked_for(results: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(*results, "--worst", 2) == 0
    out = capsys.readouterr().out
    assert (
        list(table_of(out)) == ["take-1", "take-3", "TOTAL of 6"]
        and "showing the worst 2 of 6 results" in out
    )


def test_the_layout_can_be_chosen(results: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(*results, "--columns") == 0
    assert capsys.readouterr().out.splitlines()[0].split() == ["Results", *NAMES]
    assert evaluate(*results[:2], "--rows") == 0
    assert list(table_of(capsys.readouterr().out)) == ["take-1", "take-0", "TOTAL of 2"]


def test_json_and_csv_have_a_row_for_each_and_the_total(results: list[Path], tmp_path: Path) -> None:
    assert evaluate(*results, "--json", tmp_path / "r.json", "--csv", tmp_path / "r.csv") == 0
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["layout"] == "rows"
    assert [one["name"] for one in report["results"]][:2] == ["take-1", "take-3"]
    for one in report["results"]:
        assert one["run"] == {"seed": "1", "input.sha256": one["name"]}
        assert not any("." in base for base in one["metrics"])
    (total,) = report["pooled"]
    means = [one["metrics"]["joint_error_mm"] for one in report["results"]]
    count = sum(one["count"] for one in means)
    assert total["metrics"]["joint_error_mm"]["count"] == count == 21 * sum(FRAMES)
    mean = sum(one["mean"] * one["count"] for one in means) / count
    assert total["metrics"]["joint_error_mm"]["mean"] == pytest.approx(mean, rel=1e-12)
    lines = list(csv.DictReader((tmp_path / "r.csv").read_text().splitlines()))
    assert [line["result"] for line in lines] == [*(one["name"] for one in report["results"]), "pooled"]
    assert float(lines[-1]["joint_error_mm.mean"]) == total["metrics"]["joint_error_mm"]["mean"]


def test_gates_on_all_together_and_over_results(
    results: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    gates = ("pooled.joint_error_mm.mean > 0.1", "max(joint_error_mm.mean) > 1000", "count(coverage) < 7")
    arguments = [part for gate in gates for part in ("--fail-if", gate)]
    assert evaluate(*results, *arguments) == 1
    out, err = capsys.readouterr()
    first, second = err.splitlines()
    assert first.startswith(f"pooled: gate '{gates[0]}' failed: pooled.joint_error_mm.mean is ")
    assert second == f"pooled: gate '{gates[2]}' failed: count(coverage) over 6 results is 6"
    assert "gates: 1 passed, 2 failed" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--fail-if", "pooled.joint_error_mm.wrist.mean > 1"], "parts of 'joint_error_mm' are not pooled"),
        (
            ["--fail-if", "p99(coverage) < 1"],
            "invalid statistic over results 'p99(coverage)', expected one of",
        ),
        (["--fail-if", "p95(coverag) < 1"], "did you mean 'coverage'"),
        (["--junit", "/tmp/none.xml"], "--junit requires gates, expected --fail-if, --gates or --baseline"),
        (["--worst", "-1"], "-1"),
        (["--markdown", "-", "--json", "-"], "more than one report goes to standard output"),
    ],
)
def test_wrong_usage_is_one_line_and_2(
    results: list[Path], capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert evaluate(*results, *arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and said in err


def test_the_same_set_passes_its_baseline(
    results: list[Path], baseline: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(*results, "--baseline", baseline, "--baseline-tolerance", 0) == 0
    out, err = capsys.readouterr()
    assert err == "" and ", 0 failed" in out
    changes = [line.split()[4] for line in out.split("\n\n")[0].splitlines()[2:] if "TOTAL" not in line]
    assert changes == ["0"] * len(NAMES)


def test_a_set_against_its_baseline_in_every_report(
    baseline: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """take-2 got worse, take-4 is missing, another is new."""
    now = write_set(tmp_path / "now", [3.0, 9.0, 8.0, 6.0, 4.0, 2.0])
    now[4].unlink()
    now[4] = write_result(tmp_path / "now" / "a|b <i>.mcap", 10, 1.0, recording="new", seed=1)
    capsys.readouterr()
    reports = {kind: tmp_path / f"r.{kind}" for kind in ("junit", "markdown", "json")}
    places = [part for kind, path in reports.items() for part in (f"--{kind}", path)]
    assert evaluate(*now, "--baseline", baseline, "--html", tmp_path / "r.html", *places) == 1
    err = capsys.readouterr().err
    failed = [line.split(":")[0] for line in err.splitlines() if " gate '" in line]
    assert set(failed) == {"take-2", "take-4", "pooled"}
    assert "baseline: 1 new result, not compared: a|b <i>" in err
    assert "take-4: gate 'baseline' could not be evaluated: result of the baseline is missing" in err

    suite = ET.fromstring(reports["junit"].read_bytes())[0]
    gates = json.loads(reports["json"].read_text())["gates"]
    assert len(suite) == int(suite.get("tests", "")) == len(gates)
    broken = [test.get("classname") for test in suite if test.find("failure") is not None]
    assert sorted(broken) == sorted(failed) and int(suite.get("failures", "")) == len(failed)

    markdown = reports["markdown"].read_text()
    assert markdown.startswith(f"## \u274c posetrack eval: {len(failed)} of {len(gates)} gates failed")
    assert "| `take-2` |" in markdown and "| `a\\|b <i>` |" in markdown
    page = (tmp_path / "r.html").read_text()
    assert "a|b &lt;i&gt;" in page and "<i>" not in page and 'class="worse"' in page


def test_markdown_on_standard_output_is_nothing_but_markdown(
    results: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(*results, "--fail-if", "coverage < 0.5", "--markdown", "-") == 0
    assert capsys.readouterr().out.startswith("## \u2705 posetrack eval: all 6 gates passed, 6 results\n")


def test_reports_for_ci_are_kept_unless_they_may_be_replaced(
    results: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ("--junit", "--markdown"):
        path = tmp_path / option
        path.write_text("mine")
        arguments = [*results[:2], "--fail-if", "coverage < 0.5", option, path]
        assert evaluate(*arguments) == 2 and path.read_text() == "mine"
        assert evaluate(*arguments, "--overwrite") == 0 and path.read_text() != "mine"
        assert "--overwrite" in capsys.readouterr().err


def test_groups_of_many_recordings_are_compared_and_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, factor in (("old", 2.0), ("new", 1.0)):
        write_set(tmp_path / name, [factor * error for error in ERRORS_MM])
    groups = [part for name in ("old", "new") for part in ("--group", f"{name}={tmp_path}/{name}/*.mcap")]
    assert evaluate(*groups, "--html", tmp_path / "r.html", "--csv", tmp_path / "r.csv") == 0
    assert "pairs: one recording" in capsys.readouterr().out
    page = (tmp_path / "r.html").read_text()
    assert "Paired differences" in page and page.count("Total of 6") == 2
    totals = [line for line in (tmp_path / "r.csv").read_text().splitlines() if line.startswith("pooled")]
    assert [line.split(",")[0] for line in totals] == ["pooled old", "pooled new"]


def test_one_that_cannot_be_read_fails_and_the_others_are_measured(
    results: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"no MCAP")
    assert evaluate(*results, bad, "--fail-if", "coverage < 0.5", "--junit", tmp_path / "r.xml") == 1
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert line.startswith(f"bad: gate 'measured' could not be evaluated: {bad}: ")
    assert list(table_of(out))[-1] == "TOTAL of 6" and "gates: 6 passed, 1 failed" in out
    suite = ET.fromstring((tmp_path / "r.xml").read_bytes())[0]
    assert [test.get("classname") for test in suite if len(test)] == ["bad"] and len(suite) == 7


def test_where_none_can_be_read_the_first_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = [tmp_path / f"{name}.mcap" for name in NAMES]
    for path in bad:
        path.write_bytes(b"no MCAP")
    assert evaluate(*bad) == 1
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and str(bad[0]) in err
