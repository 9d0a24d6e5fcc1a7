"""Phases of a command's work: what takes a while says its name and counts, whoever runs it shows that."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import TypeAlias

Advance: TypeAlias = Callable[[int], None]
"""Adds to the count of a phase."""
Shows: TypeAlias = Callable[[str, str, int | None], AbstractContextManager[Advance]]
"""Shows a phase of a name, the unit of its count, and the total where that is known."""

_shows: ContextVar[Shows] = ContextVar(
    "phases", default=lambda name, unit, total: nullcontext(lambda count: None)
)


@contextmanager
def phases_shown(shows: Shows) -> Iterator[None]:
    """Have the phases of what runs inside shown."""
    before = _shows.set(shows)
    try:
        yield
    finally:
        _shows.reset(before)


def phase(name: str, unit: str, total: int | None = None) -> AbstractContextManager[Advance]:
    """Return the context of a phase that may take more than two seconds; it yields what adds to its count.

    A phase is not within another one.

    Args:
        name: what is done, for people.
        unit: of what is counted.
        total: None where it is not known.
    """
    return _shows.get()(name, unit, total)
