"""Code in the documentation: fenced blocks, and the command lines in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from posetrack_cli.cli.main import cli

ROOT = Path(__file__).parents[2]
PAGES = (
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
)
"""Everything that is read; the changelog tells of what was."""

_FENCE = re.compile(
    r"^(?:<!-- (?:not run: (?P<reason>[^>]+)|needs: (?P<needs>[\w ]+)) -->\n)?"
    r"```(?P<language>\S*)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
_ENDS = frozenset("|&;<>()")


@dataclass(frozen=True)
class Block:
    """A fenced block: page relative to the root, line, language, text.

    Attributes:
        reason: why it is not run, if so.
        needs: modules without which it cannot be run, which are no dependencies, not even of tests.
    """

    page: str
    line: int
    language: str
    text: str
    reason: str | None
    needs: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(path: Path) -> list[Block]:
    """All fenced blocks of a page."""
    text = path.read_text(encoding="utf-8")
    page = path.relative_to(ROOT).as_posix()
    return [
        Block(
            page,
            text.count("\n", 0, found.start()) + 1,
            found["language"],
            found["text"],
            found["reason"],
            tuple((found["needs"] or "").split()),
        )
        for found in _FENCE.finditer(text)
    ]


def without_blocks(path: Path) -> str:
    """What stands around the fenced blocks."""
    return _FENCE.sub("", path.read_text(encoding="utf-8"))


def statements(text: str) -> list[str]:
    """Lines of a shell script, continued ones joined, without those that only comment."""
    joined = text.replace("\\\n", " ").splitlines()
    return [line.strip() for line in joined if line.strip() and not line.lstrip().startswith("#")]


def invocations(statement: str) -> Iterator[list[str]]:
    """The arguments of each ``posetrack`` in a line of shell."""
    lexer = shlex.shlex(statement, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words = list(lexer)
    for start, word in enumerate(words):
        if word.rsplit("/", 1)[-1] == "posetrack":
            rest = words[start + 1 :]
            end = next((k for k, each in enumerate(rest) if set(each) <= _ENDS), len(rest))
            yield rest[:end]


def check(arguments: Sequence[str]) -> None:
    """Have click parse a command line as it would before it runs the command."""
    command, name, rest, context = cli, "posetrack", list(arguments), None
    while True:
        try:
            context = command.make_context(name, rest, parent=context)
        except click.exceptions.Exit:
            return  # --help, --version
        if not isinstance(command, click.Group):
            return
        found, within, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        assert found is not None and within is not None
        name, command = found, within
