"""scripts/setup asks whether anything can be drawn; scripts explain themselves."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner

from posetrack_cli.rendering.port import RenderingDevice

SETUP = Path(__file__).parents[2] / "scripts" / "setup"


def test_what_setup_tries_works_where_a_device_opens(device: RenderingDevice) -> None:
    """The code stands in a shell script, where neither types nor imports are checked."""
    (code,) = re.findall(r"^opens_gl='(.+)'$", SETUP.read_text(), re.MULTILINE)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "name",
    [
        *("benchmarking.__main__", "soaking.__main__", "digesting.__main__"),
        *(f"research.{name}" for name in ("confidence", "face_features", "face_model", "hand_model.build")),
    ],
)
def test_scripts_have_help(name: str) -> None:
    said = CliRunner().invoke(import_module(name).main, ["--help"])
    assert said.exit_code == 0 and "Usage:" in said.output
