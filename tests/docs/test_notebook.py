"""The notebook of the documentation runs from its first cell to its last."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "first-steps.ipynb"


def test_the_notebook_runs(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib"), pytest.importorskip("pandas")
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert len(cells) == 10
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    posetrack = f"{sys.executable} -m posetrack_cli.cli.main"
    script = "import matplotlib\nmatplotlib.use('agg')\n" + "\n".join(code).replace(
        '"posetrack ', f'"{posetrack} '
    )
    (tmp_path / "notebook.py").write_text(script + "\nprint(tracking.outcome.frames)\n", encoding="utf-8")
    done = subprocess.run([sys.executable, "notebook.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.splitlines()[-1] == "12"
