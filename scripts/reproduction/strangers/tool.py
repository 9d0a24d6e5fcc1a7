"""The tool that draws strangers' hands: where it is, what it is, its use. It is no part of the project."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from posetrack_cli.build import PACKAGE
from posetrack_cli.errors import PosetrackError, UsageError
from posetrack_cli.recording.identity import files_digest

SHARED = PACKAGE.parent.parent / "shared"
"""Beside the project's root: what it does not contain."""
TOOL = SHARED / "tools" / "foreign_hand.py"
CVAR = SHARED / "data" / "cvar-hand"
HANDS = Path("data", "foreign-hands")
"""What the tool draws from, beside the folder that it lies in."""


def found_tool(given: Path | None) -> Path:
    """Return the tool's path: the one that was given, else that beside the project.

    Raises:
        UsageError: there is none.
    """
    tool = (given or TOOL).resolve()
    if not tool.is_file():
        raise UsageError(
            "the tool that draws strangers' hands is missing",
            where=tool,
            hint="give the path of foreign_hand.py with --tool",
        )
    return tool


@cache
def tool_digest(tool: Path) -> str:
    """SHA-256 over the tool and the hands that it draws from."""
    data = sorted(path for path in (tool.parent.parent / HANDS).glob("*") if path.is_file())
    return files_digest([(path.name, path) for path in (tool, *data)])[1]


def draw(tool: Path, folder: Path, arguments: Sequence[str]) -> None:
    """Write a recording, its truth and the hand's mesh into a folder.

    Raises:
        PosetrackError: the tool failed; with the last line that it said.
    """
    ended = subprocess.run(
        [sys.executable, str(tool), str(folder), *arguments], capture_output=True, text=True, check=False
    )
    if ended.returncode:
        said = ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"]
        raise PosetrackError(f"cannot draw {' '.join(arguments)}: {said[-1]}", where=tool.name)
