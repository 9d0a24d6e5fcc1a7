"""Filter errors, the time step check, and name registries."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from posetrack_cli.errors import PosetrackError, nearest_name

T = TypeVar("T")


class FilterError(PosetrackError):
    """Invalid filter input: weights that sum to zero, NaN, or an invalid time step."""


def check_time_step(dt: float) -> None:
    """Raise FilterError unless dt, seconds, is finite and > 0."""
    if not (math.isfinite(dt) and dt > 0.0):
        raise FilterError(
            "invalid time step",
            found=f"dt {dt} s",
            expected="a finite dt > 0",
            hint="check that frames are sorted by stamp",
        )


class Registry(dict[str, T]):
    """Objects of one kind by name, registered by a decorator.

    Args:
        kind: what the objects are, for errors.
    """

    def __init__(self, kind: str) -> None:
        super().__init__()
        self._kind = kind

    def register(self, name: str) -> Callable[[T], T]:
        """Return a decorator that registers an object under a name."""

        def add(thing: T) -> T:
            self[name] = thing
            return thing

        return add

    def find(self, name: str) -> T:
        """Return the object with a name.

        Raises:
            FilterError: unknown name; the error suggests the nearest one.
        """
        if name not in self:
            raise FilterError(f"unknown {self._kind}", found=name, hint=nearest_name(name, self))
        return self[name]
