"""What eval finds out about several results, and what it keeps of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from posetrack_cli.evaluation import assessment
from posetrack_cli.evaluation.assessment import Request, assess, stated_options
from posetrack_cli.evaluation.evaluate import EvalOptions
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.gates import parse_gate
from support.evaluation import hand_evaluation

A, B, C = Path("a.mcap"), Path("b.mcap"), Path("c.mcap")


@pytest.fixture(autouse=True)
def measured(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Evaluations made up instead of read; the files that were asked for."""
    asked: list[Path] = []

    def made_up(path: Path, options: EvalOptions, name: str) -> Evaluation:
        asked.append(path)
        return hand_evaluation(name, 60, path=path, run={"input.sha256": "aa", "seed": "1"})

    monkeypatch.setattr(assessment, "evaluate", made_up)
    return asked


def test_every_file_is_read_once_results_first(measured: list[Path]) -> None:
    counted: list[None] = []
    request = Request(results=(C, A), groups={"x": (A,), "y": (B,)})
    found = assess(request, lambda: counted.append(None))
    assert measured == [C, A, B] and len(counted) == 3
    assert [one.name for one in found.evaluations] == ["c", "a", "b"]


def test_several_results_are_compared_by_frames_and_groups_by_figures() -> None:
    beside = assess(Request(results=(A, B))).comparison
    grouped = assess(Request(results=(C,), groups={"x": (A,), "y": (B,)})).comparison
    assert beside is not None and {d.figure for d in beside.differences} >= {"largest_joint_error_mm"}
    assert grouped is not None and {d.figure for d in grouped.differences} >= {"coverage"}
    assert {(d.first, d.second) for d in grouped.differences} == {("x", "y")}
    assert assess(Request(results=(A,))).comparison is None


def test_tracks_are_dropped_unless_they_are_asked_for() -> None:
    lean, full = (assess(Request(results=(A,), keep_tracks=keep)).evaluations[0] for keep in (False, True))
    assert (len(lean.track), lean.truth, lean.pairs) == (0, None, None)
    assert len(full.track) == 60 and full.truth is not None
    assert lean.metrics == full.metrics and len(lean.series["joint_error_mm"]) == 60
    in_group = assess(Request(groups={"x": (A,)})).evaluations[0]
    assert in_group.series == {} and len(in_group.series_stamp_ns) == 0


def test_gates_meet_the_members_of_groups_too() -> None:
    gates = (parse_gate("coverage == 1"),)
    found = assess(Request(results=(C,), groups={"x": (A,), "y": (B,)}, gates=gates))
    assert [outcome.result for outcome in found.failed] == ["c", "a", "b"]


def test_options_are_stated_as_plain_values() -> None:
    assert stated_options(EvalOptions(truth=Path("truth.csv"))) == {
        "truth": "truth.csv",
        "tolerance_ms": 5.0,
        "time_offset_s": 0.0,
        "align": "none",
        "recording": None,
        "joint_offsets": None,
    }
