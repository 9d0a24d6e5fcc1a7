"""The error that filters raise, the check of time steps, and registries of things by name."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from posetrack_cli.errors import PosetrackError, nearest_name

T = TypeVar("T")


class FilterError(PosetrackError):
    """A filter was given what it cannot work with: weights without mass, NaN, or a time step that is none."""


def check_time_step(dt: float) -> None:
    """Raise FilterError unless dt, seconds, is finite and > 0."""
    if not (math.isfinite(dt) and dt > 0.0):
        raise FilterError(
            "time does not move forward",
            found=f"dt {dt} s",
            expected="a finite dt > 0",
            hint="are the frames sorted by their stamps?",
        )


class Registry(dict[str, T]):
    """Things of one kind by name, put there by a decorator.

    Args:
        kind: what they are, as error lines say.
    """

    def __init__(self, kind: str) -> None:
        super().__init__()
        self._kind = kind

    def register(self, name: str) -> Callable[[T], T]:
        """Return the decorator that makes a thing known by a name."""

        def add(thing: T) -> T:
            self[name] = thing
            return thing

        return add

    def find(self, name: str) -> T:
        """Return the thing of a name.

        Raises:
            FilterError: there is none; the nearest name is hinted at.
        """
        if name not in self:
            raise FilterError(f"no such {self._kind}", found=name, hint=nearest_name(name, self))
        return self[name]
