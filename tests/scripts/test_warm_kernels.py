"""``scripts/warm_kernels.py``: what is compiled and what is loaded afterwards must be the same program."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import warm_kernels

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
    monkeypatch.setattr(warm_kernels, "POSETRACK", (sys.executable, "-c", TRACKER))


def test_a_tracker_runs_twice_and_what_makes_its_recording_once(tmp_path: Path) -> None:
    warm_kernels.warm(("hand synth -o in", "hand run in -o out"), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"in", "out", "again-out"}


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("drifting", "posetrack drifting run -o: compiled and cached kernels give different results"),
        ("forgetful", "kernels were not cached: compiling kernels"),
        ("failing", "posetrack, one of failing run -o out: no kernel"),
    ],
)
def test_a_run_that_is_another_one_with_loaded_kernels_ends_it(tmp_path: Path, kind: str, told: str) -> None:
    with pytest.raises(SystemExit, match=f"^{told}$"):
        warm_kernels.warm((f"{kind} run -o out",), tmp_path)
