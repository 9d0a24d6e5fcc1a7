"""``posetrack doctor --warm``: what is compiled and what is loaded afterwards must be the same program."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from posetrack_cli.cli import warm
from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DONE, EXIT_FAILED, PosetrackError

TRACKER = """
import pathlib, sys
for line in sys.argv[1:]:
    kind, *_, name = line.split()
    again = name.startswith("again-")
    if again and kind == "forgetful":
        print("compiling kernels", file=sys.stderr)
    if kind == "failing":
        sys.exit("no kernel")
    pathlib.Path(name).write_text("again" if again and kind == "drifting" else "first")
"""


@pytest.fixture(autouse=True)
def other_tracker(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the place of posetrack a script of a few lines."""
    monkeypatch.setattr(warm, "POSETRACK", (sys.executable, "-c", TRACKER))


def test_a_tracker_runs_twice_and_what_makes_its_recording_once(tmp_path: Path) -> None:
    warm.warm(("hand synth -o in", "hand run in -o out"), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"in", "out", "again-out"}


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("drifting", "drifting run -o: compiled and cached kernels give different results"),
        ("forgetful", "kernels were not cached, found compiling kernels"),
        ("failing", "failing run -o out: a command to compile kernels failed, found no kernel"),
    ],
)
def test_a_run_that_is_another_one_with_loaded_kernels_ends_it(tmp_path: Path, kind: str, told: str) -> None:
    with pytest.raises(PosetrackError, match=told):
        warm.warm((f"{kind} run -o out",), tmp_path)


def test_doctor_compiles_once_for_each_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs: list[object] = []
    monkeypatch.setattr(warm, "kernel_folder", lambda: str(tmp_path))
    monkeypatch.setattr(warm, "warm", lambda lines, folder: runs.append(lines))
    for _ in range(2):
        assert run(["doctor", "--warm"]) == EXIT_DONE
        assert capsys.readouterr().out == f"kernels are compiled and cached in {tmp_path}\n"
    assert len(runs) == len(warm.RUNS)


def test_without_a_cache_folder_doctor_says_what_to_set(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(warm, "kernel_folder", lambda: None)
    assert run(["doctor", "--warm"]) == EXIT_FAILED
    assert "set NUMBA_CACHE_DIR" in capsys.readouterr().err
