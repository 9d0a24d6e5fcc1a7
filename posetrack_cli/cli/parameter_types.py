"""Types of options that click does not have."""

from __future__ import annotations

import math
from typing import Any

import click


class FiniteRange(click.FloatRange):
    """A number within limits; unlike click's own range it takes neither NaN nor an infinity."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> float:
        """Return the number.

        Raises:
            click.BadParameter: it is none, not finite, or out of range.
        """
        number = float(super().convert(value, parameter, context))
        if not math.isfinite(number):
            self.fail(f"{value} is no finite number.", parameter, context)
        return number


def only_once(context: click.Context, parameter: click.Parameter, values: tuple[Any, ...]) -> Any:
    """Callback of an option with ``multiple=True`` that may be given once: a second one is not passed over.

    Raises:
        click.BadParameter: it is given several times.
    """
    if len(values) > 1:
        raise click.BadParameter("given more than once", context, parameter)
    return values[0] if values else None
