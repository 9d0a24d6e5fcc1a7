"""Bookkeeping of data that a reader skipped."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Loss:
    """Skipped data: kind, count and first occurrence."""

    what: str
    count: int
    first: str


class LossLog:
    """Count losses by kind, with the first occurrence of each."""

    def __init__(self) -> None:
        self._losses: dict[str, Loss] = {}
        self._notes: dict[str, None] = {}

    def note(self, text: str) -> None:
        """Record a note about the data for the user although nothing was lost; equal notes count once."""
        self._notes[text] = None

    def add(self, what: str, where: str, count: int = 1) -> None:
        """Count losses of the kind ``what``; the first happened at ``where``."""
        known = self._losses.get(what)
        self._losses[what] = (
            Loss(what, count, where) if known is None else Loss(what, known.count + count, known.first)
        )

    def include(self, losses: tuple[Loss, ...]) -> None:
        """Merge the losses of another pass over the same data without counting them twice."""
        for loss in losses:
            known = self._losses.get(loss.what)
            if known is None or known.count < loss.count:
                self._losses[loss.what] = loss

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses in order of first occurrence."""
        return tuple(self._losses.values())

    @property
    def notes(self) -> tuple[str, ...]:
        """Further notes for the user, one line each, in order."""
        return tuple(self._notes)


def loss_line(losses: tuple[Loss, ...]) -> str:
    """Return one line listing all losses, for stderr and run records."""
    return "; ".join(f"{loss.what}: {loss.count}, first {loss.first}" for loss in losses)
