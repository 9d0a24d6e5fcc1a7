"""What eval finds out about several results, and what it keeps of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.evaluation.judging import assessment
from posetrack_cli.evaluation.judging.assessment import Request, assess, stated_options
from posetrack_cli.evaluation.judging.gates import parse_gate
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.evaluation.measuring.evaluation import STEP, Evaluation, Statistics, statistics
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
    monkeypatch.setattr(Request, "labels_of", lambda request, path: ("",))
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


def made_of_its_own(path: Path, options: EvalOptions, name: str) -> Evaluation:
    """A result of a recording of its own, with parts, of a length of its own."""
    frames = 20 + 7 * int(path.stem)
    return hand_evaluation(name, frames, path=path, run={"input.sha256": name, "configuration": "c"})


def many(count: int) -> tuple[Path, ...]:
    return tuple(Path(f"{place}.mcap") for place in range(count))


def test_results_of_five_recordings_are_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assessment, "evaluate", made_of_its_own)
    assert not assess(Request(results=many(4))).rows
    assert assess(Request(results=many(5))).rows
    assert assess(Request(results=many(2), layout="rows")).rows
    beside = assess(Request(results=many(6), layout="columns", keep_tracks=True))
    assert not beside.rows and all(len(one.track) for one in beside.evaluations)


def test_results_of_one_recording_stay_beside_each_other() -> None:
    found = assess(Request(results=many(7)))  # all of recording aa
    assert not found.rows and found.comparison is not None


def test_rows_keep_figures_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assessment, "evaluate", made_of_its_own)
    for one in assess(Request(results=many(6), keep_tracks=True)).evaluations:
        assert (len(one.track), one.truth, one.pairs, one.series) == (0, None, None, {})
        assert one.distributions == {} and not any("." in base for base in (*one.metrics, *one.absent))
    gate = parse_gate("joint_error_mm.index_tip.mean > 1000")
    for request in (Request(results=many(6), parts=True), Request(results=many(6), gates=(gate,))):
        found = assess(request)
        assert all("joint_error_mm.index_tip" in one.metrics for one in found.evaluations)
        assert not found.failed


def test_the_total_is_that_of_every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Brute force: the joint errors of all frames of all results, summarised at once."""
    monkeypatch.setattr(assessment, "evaluate", made_of_its_own)
    (total,) = assess(Request(results=many(9))).sets
    every = [made_of_its_own(path, EvalOptions(), path.stem) for path in many(9)]
    errors = [np.linalg.norm(one.track.points - one.truth.points, axis=2).ravel() for one in every]
    brute, found = statistics(np.concatenate(errors)), total.pool.metrics["joint_error_mm"]
    assert isinstance(found, Statistics) and found.count == brute.count == 21 * sum(
        20 + 7 * k for k in range(9)
    )
    np.testing.assert_allclose(
        [found.mean, found.sd, found.max], [brute.mean, brute.sd, brute.max], rtol=1e-12
    )
    np.testing.assert_allclose([found.median, found.p95], [brute.median, brute.p95], rtol=np.expm1(STEP))


PEAK = """
import sys, tracemalloc
from pathlib import Path
from posetrack_cli.evaluation.judging import assessment
from posetrack_cli.evaluation.judging.assessment import Request, assess
from support.evaluation import hand_evaluation

def made(path, options, name):
    return hand_evaluation(name, int(sys.argv[2]), path=path, run={"input.sha256": name})

assessment.evaluate = made
Request.labels_of = lambda request, path: ("",)
paths = tuple(Path(f"{place}.mcap") for place in range(int(sys.argv[1])))
assess(Request(results=paths[:6]))
tracemalloc.start()
found = assess(Request(results=paths, keep_tracks=True))
print(tracemalloc.get_traced_memory()[0])
"""


def kept_bytes(results: int, frames: int) -> int:
    """What an assessment of so many results holds when it is done, in a process of its own."""
    tests = Path(__file__).parents[1]
    command = [sys.executable, "-c", PEAK, str(results), str(frames)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tests, check=True)
    return int(done.stdout)


def test_what_rows_hold_does_not_grow_with_their_frames() -> None:
    """Per frame only what says whether it was right, a float and three flags; its joints take 504 bytes."""
    results, frames = 12, 2000
    more = kept_bytes(results, frames) - kept_bytes(results, frames // 2)
    per_frame = more / (results * frames / 2)
    assert per_frame < 64.0  # twice 11 bytes, of each and pooled, and the bins that more values fill
