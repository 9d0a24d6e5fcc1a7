"""Phases of long-running work: named counters that the caller can show as progress bars."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import TypeAlias

Advance: TypeAlias = Callable[[int], None]
"""Adds to the count of a phase."""
Shows: TypeAlias = Callable[[str, str, int | None], AbstractContextManager[Advance]]
"""Shows a phase given its name, the unit of its count, and the total if known."""

_shows: ContextVar[Shows] = ContextVar(
    "phases", default=lambda name, unit, total: nullcontext(lambda count: None)
)


@contextmanager
def phases_shown(shows: Shows) -> Iterator[None]:
    """Show the phases that run inside this context."""
    before = _shows.set(shows)
    try:
        yield
    finally:
        _shows.reset(before)


def phase(name: str, unit: str, total: int | None = None) -> AbstractContextManager[Advance]:
    """Return the context of a phase that may take over two seconds; it yields a function that advances it.

    Phases must not be nested.

    Args:
        name: label for the user.
        unit: unit of the count.
        total: None if unknown.
    """
    return _shows.get()(name, unit, total)
