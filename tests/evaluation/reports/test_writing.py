"""All reports of an assessment, written without a command line."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from posetrack_cli.evaluation.html import write_rows_html
from posetrack_cli.evaluation.judging import assessment
from posetrack_cli.evaluation.judging.assessment import Request, assess
from posetrack_cli.evaluation.judging.gates import parse_gate
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.reports.report_files import write_report
from posetrack_cli.evaluation.reports.writing import Reports, report_texts, rows_page_of
from support.rows import result

NAMES = ("a", "b", "c", "d", "e", "f")


@pytest.fixture(autouse=True)
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    def made_up(path: Path, options: EvalOptions, name: str) -> Evaluation:
        return result(name, 1.0 + NAMES.index(name), path=path)

    monkeypatch.setattr(assessment, "evaluate", made_up)
    monkeypatch.setattr(Request, "labels_of", lambda request, path: ("",))


def request(*names: str) -> Request:
    paths = tuple(Path(f"{name}.mcap") for name in names)
    return Request(results=paths, gates=(parse_gate("joint_error_mm.mean > 5.5"),))


def test_every_report_tells_of_the_same_results(tmp_path: Path) -> None:
    kinds = ("json", "csv", "junit", "markdown")
    places = {kind: tmp_path / f"r.{kind}" for kind in kinds}
    asked = request(*NAMES)
    found = assess(asked)
    for path, text in report_texts(found, asked.options, Reports(**places), most=2):
        write_report(path, text)
    write_rows_html(tmp_path / "r.html", rows_page_of(found))
    worst_first = list(reversed(NAMES))
    report = json.loads(places["json"].read_text())
    assert [one["name"] for one in report["results"]] == worst_first
    rows = list(csv.DictReader(places["csv"].read_text().splitlines()))
    assert [row["result"] for row in rows] == [*worst_first, "pooled"]
    assert [row["gates_failed"] for row in rows] == ["1", *["0"] * 6]
    tests = ET.fromstring(places["junit"].read_bytes()).findall(".//testcase")
    assert [test.get("classname") for test in tests] == list(NAMES)
    assert [test.get("classname") for test in tests if len(test)] == ["f"]
    assert "Worst 2 of 6 results" in places["markdown"].read_text()
    page = (tmp_path / "r.html").read_text()
    assert [page.index(f"<bdi>{name}</bdi>") for name in worst_first] == sorted(
        page.index(f"<bdi>{name}</bdi>") for name in NAMES
    )
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted(
        [*(path.name for path in places.values()), "r.html"]
    )


def test_only_what_is_asked_for_is_made() -> None:
    asked = request("a", "b")
    place = Path("r.csv")
    ((path, text),) = report_texts(assess(asked), asked.options, Reports(csv=place))
    assert path == place and text.startswith("result,metric,part,statistic,value,unit\n")
