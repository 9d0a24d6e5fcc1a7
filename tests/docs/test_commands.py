"""Command lines and options that the documentation names exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import click
import pytest

from posetrack_cli.cli.main import cli
from support.markdown import PAGES, ROOT, blocks, check, invocations, statements, without_blocks

LANGUAGES = {"bash", "python", "toml", "yaml", "csv", "json", "text", ""}
"""Languages that the tests check, so that no command is in an unchecked block."""
GENERATED = ROOT / "docs" / "reference"
WRITTEN = [path for path in PAGES if GENERATED not in path.parents]


def commands(
    command: click.Command, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    yield path, command
    if isinstance(command, click.Group):
        for name, each in command.commands.items():
            yield from commands(each, (*path, name))


COMMANDS = dict(commands(cli))
LEAVES = [path for path, command in COMMANDS.items() if not isinstance(command, click.Group)]


def options(command: click.Command) -> set[str]:
    found = {"--help", "--help-all", "-h"}
    for parameter in command.params:
        found |= {*parameter.opts, *parameter.secondary_opts}
    return found


EVERY_OPTION = set().union(*map(options, COMMANDS.values()))
OF_OTHERS = {"--durations", "--pdb"}
"""Options of pytest."""


@cache
def options_of_scripts() -> set[str]:
    """What the scripts, and the search in ``tests/hostile``, call options."""
    files = [*(ROOT / "scripts").rglob("*"), ROOT / "tests" / "hostile" / "fuzz.py"]
    texts = [
        file.read_text(encoding="utf-8") for file in files if file.suffix in ("", ".py") and file.is_file()
    ]
    return set(re.findall(r"--[a-z][a-z-]+", "\n".join(texts)))


def named(code: str) -> tuple[str, ...] | None:
    """The command, no group, that a piece of code begins with, if it does."""
    words = code.split()
    if words[:1] == ["posetrack"]:
        words = words[1:]
    fitting = [path for path in LEAVES if tuple(words[: len(path)]) == path]
    return max(fitting, key=len, default=None)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_languages_of_blocks_are_known(path: Path) -> None:
    assert {block.language for block in blocks(path)} <= LANGUAGES


@pytest.mark.parametrize("path", WRITTEN, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_command_lines_parse(path: Path) -> None:
    for block in blocks(path):
        for statement in statements(block.text) if block.language in ("bash", "yaml") else ():
            for arguments in invocations(statement) if "posetrack " in statement else ():
                try:
                    check(arguments)
                except click.ClickException as error:
                    pytest.fail(f"{block.place}: posetrack {' '.join(arguments)}: {error.format_message()}")


@pytest.mark.parametrize("path", WRITTEN, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_options_in_the_text_exist(path: Path) -> None:
    """Of the command that the code names; where it names none, of any command or script."""
    for code in re.findall(r"`([^`\n]+)`", without_blocks(path)):
        command = named(code)
        known = options(COMMANDS[command]) if command else EVERY_OPTION | options_of_scripts() | OF_OTHERS
        if command or code.startswith("-"):
            for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", code):
                assert option in known, f"{path.name}: {code}: there is no {option}"


def test_a_command_line_that_is_wrong_is_told() -> None:
    with pytest.raises(click.NoSuchOption):
        check(["hand", "run", "a.mcap", "-o", "b.mcap", "--no-such-option"])
    with pytest.raises(click.UsageError):
        check(["hand", "walk"])
    with pytest.raises(click.MissingParameter):
        check(["view", "a.mcap"])


def test_command_lines_are_found_in_shell() -> None:
    line = (
        'posetrack eval "results/$(basename "$one")" --json - >> "$SUMMARY" && bin/posetrack info x.mcap  # y'
    )
    assert list(invocations(line)) == [
        ["eval", "results/$(basename $one)", "--json", "-"],
        ["info", "x.mcap"],
    ]
