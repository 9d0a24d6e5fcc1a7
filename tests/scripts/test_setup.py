"""scripts/setup asks whether anything can be drawn with what the package really has."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from posetrack_cli.rendering.port import RenderingDevice

SETUP = Path(__file__).parents[2] / "scripts" / "setup"


def test_what_setup_tries_works_where_a_device_opens(device: RenderingDevice) -> None:
    """The code stands in a shell script, where neither types nor imports are checked."""
    (code,) = re.findall(r"^opens_gl='(.+)'$", SETUP.read_text(), re.MULTILINE)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
