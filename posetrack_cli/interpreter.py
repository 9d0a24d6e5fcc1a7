"""Start further Python processes with this process's import path, ignoring the current folder."""

from __future__ import annotations

import os
import sys


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module."""
    return [sys.executable, "-P", "-m", module, *arguments]


def module_environment() -> dict[str, str]:
    """Return its environment: ``-P`` alone would lose modules that were found by path."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
