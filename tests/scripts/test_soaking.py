"""scripts/soak: what it judges, and whole soaks of a made-up tracker, with flaws that must be told."""

from __future__ import annotations

import json
import random
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.outputs import state_path
from posetrack_cli.results import spool
from posetrack_cli.results.spool import Progress
from posetrack_cli.tracking.loop import RunState, checkpoint_of
from posetrack_cli.tracking.state_codec import whole
from posetrack_cli.tracking.two_pass import within_first_pass, within_second_pass
from soaking import disks
from soaking.__main__ import main
from soaking.frames import Sample, cpu_rows, memory_rows, time_rows
from soaking.kills import PHASES, BatchKilling, Killing, Moment, WholeBatch, plan
from soaking.runs import Case, Ended, Findings, Recordings, Reference, Standing, reference_of, standing_of

FRAMES = 40


def made_up(flaw: str = "none", frames: int = FRAMES) -> Case:
    program = (sys.executable, "-m", "support.soak_tracker")
    return Case("made-up", (str(frames), "--flaw", flaw), frames, program=program)


@pytest.fixture(scope="module", autouse=True)
def _importable() -> Iterator[None]:
    """The made-up tracker is a program of its own: its process finds it among the tests' modules."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
        yield


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Reference:
    findings = Findings()
    found = reference_of(made_up(), tmp_path_factory.mktemp("made") / "reference", findings)
    assert found is not None and findings.troubles == [] and found.room >= len(found.data)
    assert 0.0 < found.first <= found.second == found.last <= found.end
    return found


def test_killed_and_resumed_runs_of_a_good_tracker_are_fine(tmp_path: Path, reference: Reference) -> None:
    killing = Killing(made_up(), reference, tmp_path / "run")
    assert list(killing.run([Moment("first pass", 0.0)])) == []
    assert killing.killed == {"first pass": 1} and killing.attempts == 2
    assert killing.output.read_bytes() == reference.data


def test_other_bytes_after_a_kill_are_told(tmp_path: Path, reference: Reference) -> None:
    (trouble,) = Killing(made_up("resumes wrongly"), reference, tmp_path / "run").run(
        [Moment("first pass", 0.0)]
    )
    assert "differs from an uninterrupted run's after 1 kills" in trouble


def test_a_full_disk_is_fine_if_one_line_says_so_and_without_mounts_files_are_limited(
    tmp_path: Path, reference: Reference, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disks, "can_mount", lambda folder: False)
    findings = Findings()
    disks.soak_disk(made_up(), reference, 1, tmp_path / "disks", findings)
    assert findings.troubles == [] and [row.value for row in findings.rows] == [1, 0]
    assert "files of at most" in findings.rows[0].name


def test_a_soak_tells_memory_that_grows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Recordings, "long_case", lambda self, tracker: made_up("grows", 90))
    monkeypatch.setattr("soaking.__main__.describe", lambda amounts, seed: {"cores": "2"})
    monkeypatch.setattr("soaking.frames.SLOWER", 1e6)  # no test looks at how long anything takes
    monkeypatch.setattr("soaking.frames.SAMPLE_S", 0.02)
    files = ["--json", str(tmp_path / "s.json"), "--markdown", str(tmp_path / "s.md")]
    arguments = ["--quick", "--only", "frames", "--tracker", "hand", "--keep", str(tmp_path / "kept"), *files]
    assert CliRunner().invoke(main, arguments).exit_code == 1
    (told,) = json.loads((tmp_path / "s.json").read_text())["troubles"]
    assert "growth of memory after 30 frames" in told
    assert "| cores | 2 |" in (tmp_path / "s.md").read_text()
    assert (tmp_path / "kept").is_dir()


def samples_of(memory: Any, cpu: Any, frames: int = 20_000) -> list[Sample]:
    return [Sample(k, memory(k), memory(k) + 5.0, cpu(k)) for k in range(10, frames + 1, 10)]


def verdicts(rows: Any) -> list[str]:
    return [row.verdict for row in rows if row.verdict]


def test_memory_that_comes_and_goes_is_flat_and_a_leak_is_not() -> None:
    def breathing(k: int) -> float:
        return 300.0 + (8.0 if k % 70 == 0 else 0.0)

    def leaking(k: int) -> float:
        return 300.0 + k * 1e-3  # a kilobyte a frame: 19 MiB

    flat = list(memory_rows("run", samples_of(breathing, float), 20_000))
    assert [int(row.name.split()[3]) for row in flat[:4]] == [1_000, 5_000, 10_000, 20_000]
    assert [row.value for row in flat[:4]] == [300.0] * 4 and verdicts(flat) == ["ok"]
    assert flat[4].value == 313.0  # the peak
    assert verdicts(memory_rows("run", samples_of(leaking, float), 20_000)) == ["MISSED"]


def test_frames_that_take_longer_and_longer_are_told() -> None:
    steady = samples_of(float, lambda k: 0.02 * k)
    slowing = samples_of(float, lambda k: 0.02 * k + 1e-7 * k * k)  # of 20 ms the last thousand take 24
    assert verdicts(cpu_rows("run", steady, 20_000)) == ["ok"]
    assert verdicts(cpu_rows("run", slowing, 20_000)) == ["MISSED"]
    milliseconds = np.r_[np.full(1_000, 20.0), np.full(3_000, 99.0), np.full(1_000, 25.0)]
    assert [row.value for row in time_rows("run", milliseconds)] == [20.0, 25.0, 1.25]


@pytest.mark.parametrize("cold", [True, False])
def test_moments_come_in_the_order_of_a_run(cold: bool) -> None:
    rng = random.Random(3)
    plans = [plan(rng, 4, cold=cold) for _ in range(200)]
    assert {len(moments) for moments in plans} == {1, 2, 3, 4}
    for moments in plans:
        phases = [moment.phase for moment in moments]
        assert (phases[0] == "compiling") == cold and phases.count("compiling") == cold
        resumed = [PHASES.index(phase) for phase in phases if phase != "start-up"]
        assert resumed == sorted(resumed)
    assert {moment.phase for moments in plans for moment in moments} == {*PHASES} - (
        set() if cold else {"compiling"}
    )


@pytest.mark.parametrize(
    ("code", "said", "codes", "troubles"),
    [
        (0, "compiling kernels ...\n", (0,), []),
        (1, "compiling ...\nposetrack: r.mcap: no room\n", (1,), []),
        (1, "", (1,), ["0 lines"]),
        (1, "posetrack: a\nposetrack: b\n", (1,), ["2 lines"]),
        (0, "", (1,), ["exit code 0"]),
        (1, "Traceback (most recent call last):\nOSError\n", (1,), ["a traceback", "0 lines"]),
        (0, "x.py:3: RuntimeWarning: divide\n", (0,), ["a traceback or a Python warning"]),
    ],
)
def test_how_a_process_may_end(code: int, said: str, codes: tuple[int, ...], troubles: list[str]) -> None:
    found = list(Ended(code, said).troubles(codes))
    assert len(found) == len(troubles)
    assert all(line.startswith(start) for line, start in zip(found, troubles, strict=True))


class NoTracker:
    """A tracker whose states are numbers."""

    codec = whole()


def test_steps_of_both_passes_are_counted(tmp_path: Path) -> None:
    case, output = made_up(frames=40)._replace(passes=2), tmp_path / "r.mcap"
    assert standing_of(case, output) is None
    reached = RunState(0, np.random.default_rng(0), 9)
    first = within_first_pass(checkpoint_of(NoTracker(), reached, 0))
    second = within_second_pass(checkpoint_of(NoTracker(), reached, 10), {"face": np.ones(3)})
    for checkpoint, expected in ((first, Standing(10, 0)), (second, Standing(50, 10))):
        spool.save(state_path(output), checkpoint, Progress(0, 10, 0, {}))
        assert standing_of(case, output) == expected


BATCH = """
import os, pathlib, sys, time
flaw, folder = sys.argv[1], pathlib.Path(sys.argv[3])
folder.mkdir(exist_ok=True)
if not (begun := folder / "begun").exists():
    begun.touch()
    time.sleep(60)
(folder / "a.mcap").write_bytes(b"other" if flaw == "resumes wrongly" else b"result")
if flaw == "leaves pieces":
    (folder / "a.pieces").mkdir()
if flaw == "crashes":
    sys.exit("Traceback")
"""


@pytest.mark.parametrize(
    ("flaw", "words"),
    [
        ("none", []),
        ("resumes wrongly", ["results differ from an uninterrupted batch's after 1 kills"]),
        ("leaves pieces", ["left behind: a.pieces"]),
        ("crashes", ["exit code 1, expected 0; said: Traceback", "a traceback; said: Traceback"]),
    ],
)
def test_what_is_wrong_with_a_killed_batch_is_told(tmp_path: Path, flaw: str, words: list[str]) -> None:
    case = Case("batch", (flaw,), 1, program=(sys.executable, "-c", BATCH))
    killing = BatchKilling(case, WholeBatch({"a.mcap": b"result"}, 2.0), tmp_path / "run", random.Random(0))
    assert list(killing.run(["batch"])) == words and killing.killed == {"batch": 1}
