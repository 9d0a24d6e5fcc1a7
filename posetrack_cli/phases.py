"""What a run tells as it goes: phases, losses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TypeAlias

# Phases of a command's work: what takes a while says its name and counts, whoever runs it shows that


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


# Bookkeeping of what a reader had to skip


@dataclass(frozen=True)
class Loss:
    """Data that a reader had to skip: what, how often, and where first."""

    what: str
    count: int
    first: str


class LossLog:
    """Counts losses by what was lost, and remembers where each kind happened first."""

    def __init__(self) -> None:
        self._losses: dict[str, Loss] = {}
        self._notes: dict[str, None] = {}

    def note(self, text: str) -> None:
        """Record what a user should know of the data although nothing was lost; equal notes count once."""
        self._notes[text] = None

    def add(self, what: str, where: str, count: int = 1) -> None:
        """Count losses of the kind ``what``, the first of which happened at ``where``."""
        known = self._losses.get(what)
        self._losses[what] = (
            Loss(what, count, where) if known is None else Loss(what, known.count + count, known.first)
        )

    def include(self, losses: tuple[Loss, ...]) -> None:
        """Take over what another pass over the same data lost: the same things are not counted twice."""
        for loss in losses:
            known = self._losses.get(loss.what)
            if known is None or known.count < loss.count:
                self._losses[loss.what] = loss

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The losses, in the order in which each kind happened first."""
        return tuple(self._losses.values())

    @property
    def notes(self) -> tuple[str, ...]:
        """What else a user should know, one line each, in order."""
        return tuple(self._notes)


def loss_line(losses: tuple[Loss, ...]) -> str:
    """Return one line that tells all losses, for standard error and run records."""
    return "; ".join(f"{loss.what}: {loss.count}, first {loss.first}" for loss in losses)
