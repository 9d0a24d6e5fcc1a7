"""Where a run differs from the paper that its configuration follows, item by item."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

from posetrack_cli.configuration import Settings

RECORD_KEY = "deviations_from_print"
"""Of the run record: a JSON list of lines; only of configurations that follow a paper."""


class PrintedSetting(NamedTuple):
    """A configuration key that has a value as printed.

    Attributes:
        where: section or equation.
        key: such as ``filter.gain``.
        value: as printed.
    """

    where: str
    key: str
    value: object


class Deviation(NamedTuple):
    """What no configuration key turns into what is printed.

    Attributes:
        where: section or equation.
        text: what is done instead, one clause.
    """

    where: str
    text: str


def deviations(
    config: Settings, settings: Sequence[PrintedSetting], always: Sequence[Deviation]
) -> list[str]:
    """Return a line for each setting in force that is not as printed, then for each constant deviation."""
    differing = [(one, _value(config, one.key)) for one in settings]
    return [
        f"{one.where}: {one.key} is {_shown(value)}, not {_shown(one.value)}"
        for one, value in differing
        if value != one.value
    ] + [f"{one.where}: {one.text}" for one in always]


def _value(config: Settings, key: str) -> object:
    return reduce(getattr, key.split("."), config)


def _shown(value: object) -> str:
    return repr(value) if isinstance(value, str) else str(value)


def deviations_record(lines: Sequence[str] | None) -> dict[str, str]:
    """Return what a run record says of deviations; nothing where no paper is followed."""
    return {} if lines is None else {RECORD_KEY: json.dumps(lines)}
