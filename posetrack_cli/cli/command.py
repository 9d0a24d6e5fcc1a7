"""What every command is made of: options in groups, examples, and names that options had before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

import click

Function = TypeVar("Function", bound=Callable[..., Any])
OTHERS = "Other options"


class Option(click.Option):
    """An option that belongs to a group of the help.

    Args:
        group: its heading; none stands below ``Other options``.
    """

    def __init__(self, *arguments: Any, group: str = "", **attributes: Any) -> None:
        super().__init__(*arguments, **attributes)
        self.group = group


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
        super().__init__(*arguments, **attributes)
        self.examples, self.former = tuple(examples), dict(former or {})

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse a command line; a former name is told with the one it has now."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if (now := self.former.get(error.option_name)) is None:
                raise
            raise click.UsageError(f"{error.option_name} is called {now} now", ctx) from error

    def groups(self, context: click.Context) -> dict[str, list[tuple[str, str]]]:
        """Return the help of the options by the headings they stand below, in the order of their first."""
        found: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(context):
            record = parameter.get_help_record(context) if isinstance(parameter, click.Option) else None
            if record is not None:
                found.setdefault(getattr(parameter, "group", "") or OTHERS, []).append(record)
        if OTHERS in found:
            found[OTHERS] = found.pop(OTHERS)  # comes last
        return found

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the groups."""
        for heading, records in self.groups(ctx).items():
            with formatter.section(heading):
                formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples, one a line, as they are typed."""
        if self.examples:
            with formatter.section("Examples"):
                for line in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{line}\n")
        super().format_epilog(ctx, formatter)


class Adding(Protocol):
    """What adds one option, or several, to a command."""

    def __call__(self, function: Function, /) -> Function:
        """Return the command's function with them."""


def option(*names: str, **attributes: Any) -> Adding:
    """Return what adds an ``Option`` to a command, as ``click.option`` does."""
    return click.option(*names, cls=Option, **attributes)


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
