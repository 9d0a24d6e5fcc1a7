"""A case: files that a stranger might send, and the command line that a user gives them to."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias


@dataclass(frozen=True)
class Link:
    """A symbolic link."""

    target: str


@dataclass(frozen=True)
class Pipe:
    """A named pipe that nobody writes to."""


Content: TypeAlias = bytes | Link | Pipe


@dataclass(frozen=True)
class Case:
    """Files and a command line.

    Attributes:
        target: what the case attacks.
        command: arguments of ``posetrack``; files by their names below the case's folder.
        files: by name below the folder.
        outputs: names that the command may make, each also with the suffixes of an unfinished run.
    """

    target: str
    command: tuple[str, ...]
    files: Mapping[str, Content] = field(default_factory=dict)
    outputs: tuple[str, ...] = ()

    def with_files(self, **files: Content) -> Case:
        return replace(self, files={**self.files, **files})

    def write(self, folder: Path) -> None:
        """Write the files below a folder that is there."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Link):
                path.symlink_to(content.target)
            elif isinstance(content, Pipe):
                os.mkfifo(path)
            else:
                path.write_bytes(content)

    def size(self) -> int:
        """Bytes of files and command line: of two failing cases the smaller one is kept."""
        content = sum(len(c) for c in self.files.values() if isinstance(c, bytes))
        return content + sum(map(len, self.files)) + sum(map(len, self.command))

    def command_line(self) -> str:
        return " ".join(["posetrack", *map(_quoted, self.command)])

    def __repr__(self) -> str:
        sizes = {name: len(c) if isinstance(c, bytes) else c for name, c in self.files.items()}
        return f"{self.target}: {self.command_line()}  # {sizes}"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """As hypothesis prints it, who would print every byte."""
        printer.text(repr(self))


def _quoted(argument: str) -> str:
    """As ``shlex.quote``, and printable, whatever the name holds."""
    plain = argument.isascii() and argument.replace("/", "").replace(".", "").replace("-", "").isalnum()
    return argument if plain else "$" + ascii(argument)


def save(case: Case, folder: Path, told: Mapping[str, Any]) -> None:
    """Keep a case so that it can be run again: its files, and ``case.json`` with what came of it."""
    folder.mkdir(parents=True, exist_ok=True)
    links = {name: c.target for name, c in case.files.items() if isinstance(c, Link)}
    pipes = [name for name, c in case.files.items() if isinstance(c, Pipe)]
    content = {name: c for name, c in case.files.items() if isinstance(c, bytes)}
    (folder / "files").mkdir(exist_ok=True)
    case.write(folder / "files")
    about = {
        "target": case.target,
        "command": list(case.command),
        "command_line": case.command_line(),
        "outputs": list(case.outputs),
        "links": links,
        "pipes": pipes,
        "names": [base64.b64encode(os.fsencode(name)).decode() for name in content],
        **told,
    }
    (folder / "case.json").write_text(json.dumps(about, indent=1))


def load(folder: Path) -> Case:
    """Read a case that was kept."""
    about = json.loads((folder / "case.json").read_text())
    names = [os.fsdecode(base64.b64decode(name)) for name in about["names"]]
    files: dict[str, Content] = {name: (folder / "files" / name).read_bytes() for name in names}
    files |= {name: Link(target) for name, target in about["links"].items()}
    files |= {name: Pipe() for name in about["pipes"]}
    return Case(about["target"], tuple(about["command"]), files, tuple(about["outputs"]))
