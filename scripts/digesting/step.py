"""A step: one command line, or inputs that no command writes."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

_NAMED = re.compile(r"\{([^:}]+)(?::(\d))?\}")


@dataclass(frozen=True)
class Step:
    """A command line, or a function that makes inputs.

    Attributes:
        name: unique.
        arguments: arguments of ``posetrack``; ``{name}`` stands for the first output of the step of that
            name, ``{name:1}`` for the second.
        outputs: files or folders that it writes; none if only its standard output counts.
        needed: names of steps that must be done first, in addition to those in ``arguments``.
        printed: whether standard output counts.
        interrupted: whether it is stopped by Ctrl-C after its first checkpoint and resumed.
        make: writes inputs into a folder; then there are no arguments.
    """

    name: str
    arguments: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    printed: bool = False
    interrupted: bool = False
    make: Callable[[Path], object] | None = None

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of all steps that must be done first."""
        return (*self.needed, *(name for text in self.arguments for name, _ in _NAMED.findall(text)))

    def filled(self, outputs: Mapping[str, Sequence[str]]) -> list[str]:
        """Return the arguments with the names of outputs in place of those of steps."""
        return [_NAMED.sub(lambda m: outputs[m[1]][int(m[2] or 0)], text) for text in self.arguments]


def command(name: str, line: str, *outputs: str, printed: bool = False, interrupted: bool = False) -> Step:
    """Return the step of a command line that writes the path after its ``-o``, and further ``outputs``."""
    arguments = tuple(shlex.split(line))
    written = [arguments[arguments.index("-o") + 1]] if "-o" in arguments else []
    shown = tuple(path for path in (*written, *outputs) if path != "-")
    return Step(name, arguments, shown, printed=printed, interrupted=interrupted)


def made(name: str, make: Callable[[Path], object], outputs: str, needed: str = "") -> Step:
    """Return the step that makes inputs by code; names are separated by spaces."""
    return Step(name, outputs=tuple(outputs.split()), needed=tuple(needed.split()), make=make)
