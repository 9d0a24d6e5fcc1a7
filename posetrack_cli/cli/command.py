"""What every command is made of: options in groups, examples, and names that options had before."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

import click

from posetrack_cli.cli.process import check_memory
from posetrack_cli.cli.terminal import QUIET, USUAL, VERBOSE, phase_shown, print_detail, print_line, volume
from posetrack_cli.phases import phases_shown

Function = TypeVar("Function", bound=Callable[..., Any])
OTHERS = "Other options"
HELP_NAMES = {"help_option_names": ["-h", "--help"]}
HELP_ALL = "--help-all"
"""Also where a command is called by itself: click keeps the option that it made first."""
_VOLUME = "posetrack.volume"
_BEGAN = "posetrack.began_s"


class Option(click.Option):
    """An option that belongs to a group of the help.

    Args:
        group: its heading; none stands below ``Other options``.
        rare: shown by --help-all alone.
    """

    def __init__(self, *arguments: Any, group: str = "", rare: bool = False, **attributes: Any) -> None:
        super().__init__(*arguments, **attributes)
        self.group, self.rare = group, rare


class Command(click.Command):
    """A command whose help has groups and examples, and that knows what its options were called before.

    Args:
        examples: command lines below the help, each a list of what is typed, one line each.
        former: what options were called, with what they are called now, in words of a command line.
    """

    def __init__(
        self,
        *arguments: Any,
        examples: Sequence[str] = (),
        former: Mapping[str, str] | None = None,
        **attributes: Any,
    ) -> None:
        attributes.setdefault("context_settings", HELP_NAMES)
        super().__init__(*arguments, **attributes)
        self.examples, self.former = tuple(examples), dict(former or {})

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command, as loud as it was asked to be."""
        check_memory()
        began_s = time.perf_counter(), time.process_time()
        ctx.meta[_BEGAN] = began_s[0]
        with volume(ctx.meta.get(_VOLUME, USUAL)), phases_shown(phase_shown):
            try:
                return super().invoke(ctx)
            finally:
                spent = (time.perf_counter() - began_s[0], time.process_time() - began_s[1])
                print_detail(f"took {spent[0]:.1f} s, {spent[1]:.1f} s of processor time")

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse a command line; a former name is told with the one it has now."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if (now := self.former.get(error.option_name)) is None:
                raise
            raise click.UsageError(f"{error.option_name} is called {now} now", ctx) from error

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters; a command with rare options has --help-all, too."""
        parameters = super().get_params(ctx)
        if not any(getattr(one, "rare", False) for one in parameters):
            return parameters
        more: dict[str, Any] = {"is_flag": True, "is_eager": True, "expose_value": False}
        shown = Option([HELP_ALL], help="Show all options, also rare ones.", callback=_show_all, **more)
        return [*parameters[:-1], shown, parameters[-1]]

    def groups(self, context: click.Context, *, rare: bool) -> dict[str, list[tuple[str, str]]]:
        """Return the help of the options by the headings they stand below, in the order of their first."""
        found: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(context):
            is_shown = isinstance(parameter, click.Option) and (rare or not getattr(parameter, "rare", False))
            record = parameter.get_help_record(context) if is_shown else None
            if record is not None:
                found.setdefault(getattr(parameter, "group", "") or OTHERS, []).append(record)
        if OTHERS in found:
            found[OTHERS] = found.pop(OTHERS)  # comes last
        return found

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the groups."""
        for heading, records in self.groups(ctx, rare=ctx.meta.get(HELP_ALL, False)).items():
            with formatter.section(heading):
                formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples, one a line, as they are typed."""
        if self.examples:
            with formatter.section("Examples"):
                for line in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{line}\n")
        super().format_epilog(ctx, formatter)


def _show_all(context: click.Context, parameter: click.Parameter, asked: bool) -> None:
    """Callback of --help-all."""
    if asked and not context.resilient_parsing:
        context.meta[HELP_ALL] = True
        for line in context.get_help().splitlines():
            print_line(line)
        context.exit()


def seconds_since_start() -> float:
    """Return how long the command that runs has taken so far."""
    return time.perf_counter() - float(click.get_current_context().meta[_BEGAN])


class Adding(Protocol):
    """What adds one option, or several, to a command."""

    def __call__(self, function: Function, /) -> Function:
        """Return the command's function with them."""


def option(*names: str, **attributes: Any) -> Adding:
    """Return what adds an ``Option`` to a command, as ``click.option`` does."""
    return click.option(*names, cls=Option, **attributes)


def _set_volume(context: click.Context, parameter: click.Parameter, asked: bool) -> None:
    """Callback of --quiet and --verbose.

    Raises:
        click.BadParameter: both are given.
    """
    if not asked:
        return
    own = QUIET if parameter.name == "quiet" else VERBOSE
    if context.meta.setdefault(_VOLUME, own) != own:
        raise click.BadParameter("--quiet and --verbose exclude each other", context, parameter)


def volume_options(function: Function) -> Function:
    """Add --quiet and --verbose to a command that runs for more than an instant."""
    more: dict[str, Any] = {"is_flag": True, "expose_value": False, "callback": _set_volume, "group": OTHERS}
    for adding in (
        option("-v", "--verbose", help="Also say what is read and used, and what it took.", **more),
        option(
            "-q",
            "--quiet",
            help="Say nothing but what went wrong, and show no progress.",
            **more,
        ),
    ):
        function = adding(function)
    return function


def commands_of(
    command: click.Command, name: str, parent: click.Context | None = None
) -> Iterator[tuple[click.Command, click.Context]]:
    """Yield a command and all below it that are shown, each with a context that knows its path."""
    context = click.Context(command, info_name=name, parent=parent, **command.context_settings)
    yield command, context
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            within = command.get_command(context, each)
            if within is not None and not within.hidden:
                yield from commands_of(within, each, context)
