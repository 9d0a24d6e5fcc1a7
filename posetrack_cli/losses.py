"""Bookkeeping of what a reader had to skip."""

from __future__ import annotations

from dataclasses import dataclass


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
