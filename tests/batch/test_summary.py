"""What all reports of a batch say: one verdict, also of the exit code."""

from __future__ import annotations

import base64
import csv
import json
import os
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest

from posetrack_cli.batch.jobs import Job, Outcome, State, record_path
from posetrack_cli.batch.summary import Judging, Summary, _reduced, markdown_of, summarise, write_summary
from posetrack_cli.evaluation.judging.assessment import Request
from posetrack_cli.evaluation.judging.gates import parse_gate
from posetrack_cli.evaluation.reports.writing import Reports
from posetrack_cli.evaluation.viewing.outputs import png_of
from posetrack_cli.text import one_line
from support.results import write_result

GOOD, BAD = "frames < 1", "frames < 100"


def judged(folder: Path, names: list[str], outcomes: list[Outcome], *gates: str) -> tuple[Summary, Judging]:
    jobs = []
    for name, outcome in zip(names, outcomes, strict=True):
        output = folder / f"{name}.mcap"
        if outcome.has_result:
            output.parent.mkdir(exist_ok=True)
            write_result(output)
        page = folder / f"{name}.html"
        page.touch()
        recording = Path("in", f"{name}.mcap")
        jobs.append(
            Job(
                one_line(name),
                ("hand", "run"),
                recording,
                (),
                output,
                record_path(folder, name),
                folder,
                page=page,
            )
        )
    request = Request(gates=tuple(map(parse_gate, gates)))
    judging = Judging(request, Reports(junit=folder / "j.xml", markdown=folder / "m.md"), 50)
    summary = summarise(jobs, outcomes, judging)
    write_summary(folder, summary, judging)
    return summary, judging


DONE = Outcome("a", State.DONE)
LOST = replace(DONE, lost_data=True, remarks=("3 frames are damaged",))


@pytest.mark.parametrize(
    ("outcome", "gate", "code", "failed"),
    [
        (DONE, GOOD, 0, 0),
        (DONE, BAD, 1, 1),
        (LOST, GOOD, 3, 1),
        (LOST, BAD, 1, 2),
        (Outcome("a", State.FAILED, "is damaged"), GOOD, 3, 1),
        (Outcome("a", State.STOPPED), GOOD, 130, 1),
        (replace(LOST, state=State.KEPT), GOOD, 3, 1),
    ],
)
def test_all_reports_and_the_exit_code_agree(
    tmp_path: Path, outcome: Outcome, gate: str, code: int, failed: int
) -> None:
    summary, judging = judged(tmp_path, ["b", "a"], [replace(DONE, name="b"), outcome], gate)
    assert summary.exit_code == code
    cases = list(ET.parse(tmp_path / "j.xml").iter("testcase"))
    of_a = [one for one in cases if one.get("classname") == "a" and one.find("failure") is not None]
    assert len(of_a) == failed
    every = sum(one.find("failure") is not None for one in cases)
    words = f"{every} of {len(cases)} gates failed" if every else f"all {len(cases)} gates passed"
    assert f"posetrack eval: {words}, " in markdown_of(summary, judging) == (tmp_path / "m.md").read_text()
    assert f"{words[:1].upper()}{words[1:]}." in (tmp_path / "index.html").read_text()
    gates = json.loads((tmp_path / "summary.json").read_text())["gates"]
    assert (len(gates), sum(one["failed"] for one in gates)) == (len(cases), every)
    with (tmp_path / "summary.csv").open(newline="") as stream:
        rows = {row["name"]: row for row in csv.DictReader(stream)}
    assert int(rows["a"]["gates_failed"]) == failed
    assert (every == 0) == (summary.exit_code == 0)
    if outcome.lost_data:
        assert "3 frames are damaged" in (tmp_path / "j.xml").read_text()


def test_names_of_strangers_are_text_everywhere(tmp_path: Path) -> None:
    names = ["=1+1", os.fsdecode(b"sur\xff\xfe"), "a\tb\x1b[31m"]
    outcomes = [Outcome(one_line(name), State.DONE, remarks=("-1+1",)) for name in names]
    judged(tmp_path, names, outcomes)
    for path in (tmp_path / one for one in ("summary.csv", "summary.json", "index.html", "j.xml", "m.md")):
        assert "\x1b" not in path.read_text(encoding="utf-8")
    with (tmp_path / "summary.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["name"] for row in rows} == {"'=1+1", "sur\\udcff\\udcfe", "a\\tb\\x1b[31m"}
    assert {row["remarks"] for row in rows} == {"'-1+1"}
    assert 'href="./sur%FF%FE.html"' in (tmp_path / "index.html").read_text()


@pytest.mark.parametrize("picture", ["AAAA", "A", "", "=" * 9])
def test_a_page_with_a_damaged_picture_gives_no_thumbnail(picture: str) -> None:
    with pytest.raises(ValueError):
        _reduced(picture)


def test_thumbnails_are_small_and_whole() -> None:
    wide = np.zeros((300, 1200, 3), np.uint8)
    wide[:, 600:] = 255
    shown = _reduced(base64.b64encode(png_of(wide)).decode()).removeprefix("data:image/png;base64,")
    small = cv2.imdecode(np.frombuffer(base64.b64decode(shown), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert small.shape == (60, 240)
    assert (small[:, :119] == 0).all() and (small[:, 121:] == 255).all()
