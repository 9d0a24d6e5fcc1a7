"""Options that several commands share, added to a command together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Any], Any]


def option_group(*options: Option) -> Callable[[Command], Command]:
    """Return what adds options to a command, in this order; its function gets them as keyword arguments."""

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add
