"""Start Python again: it imports what this process does, and nothing of the folder that it is started in."""

from __future__ import annotations

import os
import sys


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line of a module as a program."""
    return [sys.executable, "-P", "-m", module, *arguments]


def module_environment() -> dict[str, str]:
    """Return the environment of such a program: with -P alone it would not find what is imported by path."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
