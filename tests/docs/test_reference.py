"""``docs/reference`` is what the configurations and commands are now."""

from __future__ import annotations

import re
from typing import Any, get_args

import click
import pytest

import reference
from posetrack_cli.cli import hand, head_run
from posetrack_cli.cli.command import Command, Option, commands_of
from posetrack_cli.cli.main import cli
from posetrack_cli.cli.view import view
from posetrack_cli.configuration import Settings, shipped_files
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from support.markdown import check, invocations, statements

COMMANDS = [one for one, _ in commands_of(cli, "posetrack") if not isinstance(one, click.Group)]
TRACKERS = ("hand run", "head stereo", "head mono")


def command_named(path: str) -> click.Command:
    return next(
        one for one, context in commands_of(cli, "posetrack") if context.command_path == f"posetrack {path}"
    )


def test_what_is_committed_is_current() -> None:
    pages = reference.reference_pages()
    assert {path.name for path in reference.FOLDER.iterdir()} == set(pages)
    for name, text in pages.items():
        committed = (reference.FOLDER / name).read_text(encoding="utf-8")
        assert committed == text, (
            f"docs/reference/{name} is of another version: run scripts/docs, and commit it"
        )


@pytest.mark.parametrize("page", reference.CONFIGURATIONS, ids=lambda page: page.name)
def test_a_file_of_defaults_is_current(page: reference.Page) -> None:
    path = shipped_files()[page.name]
    assert path.read_text(encoding="utf-8") == reference.defaults_file(page), (
        "run scripts/docs, and commit it"
    )


def test_a_key_is_told_with_type_bounds_default_and_meaning() -> None:
    page = reference.reference_pages()["hand.md"]
    assert "- `scale`: number from 0.1 to 10, default `1.0`; 1 is the average adult hand" in page
    particles = HandConfig().filter.particles
    assert f"- `particles`: whole number from 1 to 1,000,000, default `{particles}`; " in page


@pytest.mark.parametrize(
    ("command", "model", "keys"),
    [
        ("hand run", HandConfig, hand.CONFIGURED),
        ("head mono", HeadMonoConfig, head_run.CONFIGURED | head_run.OWN_CONFIGURED),
        ("head stereo", HeadStereoConfig, head_run.CONFIGURED),
    ],
)
def test_an_option_offers_what_its_setting_takes(
    command: str, model: type[Settings], keys: dict[str, str]
) -> None:
    """The help knows no models, which take long to load."""
    options = {one.name: one for one in command_named(command).params if isinstance(one, Option)}
    for name, key in keys.items():
        *tables, last = key.split(".")
        table: Any = model()
        for part in tables:
            table = getattr(table, part)
        if isinstance(options[name].type, click.Choice):
            assert set(options[name].type.choices) == set(
                get_args(type(table).model_fields[last].annotation)
            ), key
            assert f"[default: {getattr(table, last)}]" in str(options[name].help), key


def test_no_option_has_two_meanings() -> None:
    """Nor two types: whoever has seen a name in one command knows it in all others."""
    for name, uses in reference.uses_of_options().items():
        assert len({use.meaning for use in uses}) == 1, [(use.command, use.meaning) for use in uses]
        assert len({use.kind for use in uses}) == 1, [(use.command, use.kind) for use in uses]
        assert all(use.meaning for use in uses), f"{name} does not say what it means"


def test_no_name_stands_for_two_options() -> None:
    """Short ones and those that turn something off included."""
    meant: dict[str, set[str]] = {}
    for name, uses in reference.uses_of_options().items():
        for called in (called for use in uses for called in use.names):
            meant.setdefault(called, set()).add(name)
    assert {called: names for called, names in meant.items() if len(names) > 1} == {}


def test_a_second_meaning_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    other = Option(["--scale"], is_flag=True, help="Draw a scale.")
    monkeypatch.setattr(view, "params", [*view.params, other])
    uses = reference.uses_of_options()["--scale"]
    assert {use.kind for use in uses} == {"float", "switch"}
    assert {use.meaning for use in uses} == {"Hand size", "Draw a scale"}


def test_every_command_writes_to_the_same_option() -> None:
    """What writes one thing writes it to -o; reports and learned models are beside it."""
    table = reference.uses_of_options()
    writing = {use.command for use in table["--overwrite"]} | {use.command for use in table["--redo"]}
    assert writing - {"eval", "info"} == {use.command for use in table["--output"]}
    assert all("-o" in use.names for use in table["--output"])


def test_every_shipped_configuration_is_named_by_its_command() -> None:
    page = reference.reference_pages()["cli.md"]
    sections = {name: page.split(f"\n## `posetrack {name}`\n")[1].split("\n## ")[0] for name in TRACKERS}
    for name, section in sections.items():
        line = next(line for line in section.splitlines() if line.startswith("- `--config "))
        told = set(re.findall(r"[a-z]+(?:-[a-z]+)*", line))
        prefix = name.removesuffix(" run").replace(" ", "-")
        assert {one for one in shipped_files() if f"{one}-".startswith(f"{prefix}-")} <= told, name


@pytest.mark.parametrize("command", COMMANDS, ids=lambda one: str(one.name))
def test_examples_are_what_their_command_accepts(command: click.Command) -> None:
    """And narrow enough to be read at 80 columns."""
    assert isinstance(command, Command) and command.examples
    assert max(map(len, command.examples)) <= 76
    for statement in statements("\n".join(command.examples)):
        for arguments in invocations(statement):
            check(arguments)


def test_help_fits_a_terminal_of_80_columns() -> None:
    for command, context in commands_of(cli, "posetrack"):
        context.terminal_width = 80
        lines = command.get_help(context).splitlines()
        assert max(map(len, lines)) <= 80, f"{context.command_path}: {max(lines, key=len)}"


def test_every_command_has_its_options() -> None:
    page = reference.reference_pages()["cli.md"]
    for heading in ("posetrack batch head mono", "posetrack hand synth", "posetrack calibrate stereo"):
        assert f"\n## `{heading}`\n" in page
    assert "- `--fail-if CONDITION`: " in page
    assert "1&lt;=x&lt;=2" in page  # nothing is taken for markup
