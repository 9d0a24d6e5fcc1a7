"""Command and option classes: grouped help, examples, and pointers from former option names."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

import click

from posetrack_cli.cli.process import check_memory
from posetrack_cli.cli.terminal import QUIET, USUAL, VERBOSE, print_detail, print_line, show_phase, volume
from posetrack_cli.phases import phases_shown

Function = TypeVar("Function", bound=Callable[..., Any])
OTHERS = "Other options"
HELP_NAMES = {"help_option_names": ["-h", "--help"]}
HELP_ALL = "--help-all"
_VOLUME = "posetrack.volume"
_BEGAN = "posetrack.began_s"


class Option(click.Option):
    """An option with a heading in the help.

    Args:
        group: heading; ``Other options`` if empty.
        rare: whether only --help-all lists the option.
        meaning: what the option means in every command that has it, for the reference; the first sentence
            of the help if empty.
    """

    def __init__(
        self, *arguments: Any, group: str = "", rare: bool = False, meaning: str = "", **attributes: Any
    ) -> None:
        super().__init__(*arguments, **attributes)
        self.group, self.rare, self.meaning = group, rare, meaning


class Command(click.Command):
    """A command with grouped options and examples in its help.

    Args:
        examples: command lines shown below the help.
        former: former option names and their current names, for error messages.
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
        """Run the command at the requested verbosity."""
        check_memory()  # here and not in main: --help works under any limit
        began_s = time.perf_counter(), time.process_time()
        ctx.meta[_BEGAN] = began_s[0]
        with volume(ctx.meta.get(_VOLUME, USUAL)), phases_shown(show_phase):
            try:
                return super().invoke(ctx)
            finally:
                spent = (time.perf_counter() - began_s[0], time.process_time() - began_s[1])
                print_detail(f"took {spent[0]:.1f} s, {spent[1]:.1f} s CPU time")

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse a command line; the error for a former option name gives the current one."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if (now := self.former.get(error.option_name)) is None:
                raise
            raise click.UsageError(f"{error.option_name} was renamed to {now}", ctx) from error

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters, including --help-all if the command has rare options."""
        parameters = super().get_params(ctx)
        if not any(getattr(one, "rare", False) for one in parameters):
            return parameters
        more: dict[str, Any] = {"is_flag": True, "is_eager": True, "expose_value": False}
        shown = Option([HELP_ALL], help="Show all options and exit.", callback=_show_all, **more)
        return [*parameters[:-1], shown, parameters[-1]]  # click's --help stays last

    def groups(self, context: click.Context, *, rare: bool) -> dict[str, list[tuple[str, str]]]:
        """Return the help records of the options by heading, in order of declaration."""
        found: dict[str, list[tuple[str, str]]] = {}
        # getattr: the --help option is click's own and has no group.
        for parameter in self.get_params(context):
            is_shown = isinstance(parameter, click.Option) and (rare or not getattr(parameter, "rare", False))
            record = parameter.get_help_record(context) if is_shown else None
            if record is not None:
                found.setdefault(getattr(parameter, "group", "") or OTHERS, []).append(record)
        if OTHERS in found:
            found[OTHERS] = found.pop(OTHERS)  # dicts keep insertion order: this moves it to the end
        return found

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options by heading."""
        for heading, records in self.groups(ctx, rare=ctx.meta.get(HELP_ALL, False)).items():
            with formatter.section(heading):
                formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples, one per line."""
        if self.examples:
            with formatter.section("Examples"):
                for line in self.examples:  # write_text would wrap them
                    formatter.write(f"{'':>{formatter.current_indent}}{line}\n")
        super().format_epilog(ctx, formatter)


def _show_all(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value and not context.resilient_parsing:  # resilient parsing is shell completion
        context.meta[HELP_ALL] = True
        # Line by line: print_line escapes line breaks.
        for line in context.get_help().splitlines():
            print_line(line)
        context.exit()


def seconds_since_start() -> float:
    """Return the seconds since the current command started."""
    return time.perf_counter() - float(click.get_current_context().meta[_BEGAN])


class OptionDecorator(Protocol):
    """A decorator that adds one or more options to a command."""

    def __call__(self, function: Function, /) -> Function:
        """Return the function with the options attached."""


def option(*names: str, **attributes: Any) -> OptionDecorator:
    """Return a decorator that adds an ``Option``, like ``click.option``."""
    return click.option(*names, cls=Option, **attributes)


def _set_volume(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if not value:
        return
    # The meta data of a context is shared by nested commands.
    own = QUIET if parameter.name == "quiet" else VERBOSE
    if context.meta.setdefault(_VOLUME, own) != own:
        raise click.BadParameter("--quiet and --verbose are mutually exclusive", context, parameter)


def volume_options(function: Function) -> Function:
    """Add --quiet and --verbose to a command."""
    more: dict[str, Any] = {"is_flag": True, "expose_value": False, "callback": _set_volume, "group": OTHERS}
    for adding in (
        option("-v", "--verbose", help="Also print inputs, non-default settings and run time.", **more),
        option("-q", "--quiet", help="Print only errors and warnings; hide the progress bar.", **more),
    ):
        function = adding(function)
    return function


def commands_of(
    command: click.Command, name: str, parent: click.Context | None = None
) -> Iterator[tuple[click.Command, click.Context]]:
    """Yield a command and its visible subcommands, each with a context that has its full path."""
    context = click.Context(command, info_name=name, parent=parent, **command.context_settings)
    yield command, context
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            within = command.get_command(context, each)
            if within is not None and not within.hidden:
                yield from commands_of(within, each, context)
