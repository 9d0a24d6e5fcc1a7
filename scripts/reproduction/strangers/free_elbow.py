"""A forearm whose other end lies free: what hand and forearm are must be told from their shape alone."""

from __future__ import annotations

from collections.abc import Iterator

from reproduction.running import Targets
from reproduction.strangers.figures import OFF_MM, found_within, kept
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import DEFAULT, FREE_ELBOW, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tables import NEVER, Column, Value, noted, people_table
from reproduction.strangers.tasks import Task

PEOPLE = 5
"""The first of all people are enough."""
COLUMNS = (
    Column("found_within", "found within, frames", whole="max"),
    Column("kept", f"frames with the wrist < {OFF_MM:g} mm off", 1, percent=True, whole="mean"),
    Column("error_mm", "error, mm", whole="mean"),
    Column("lost", "lost frames", whole="sum"),
)


class FreeElbow:
    """Found, and kept."""

    name = "free-elbow"

    def tasks(self, options: Options) -> list[Task]:
        """The first people, with the defaults."""
        return [options.task(person, FREE_ELBOW, DEFAULT) for person in options.people[:PEOPLE]]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person."""
        yield "## Free elbow"
        yield ""
        yield "Defaults, without an upper arm. Found within: as above; kept: whatever the status says."
        yield ""
        rows = {person: figures_of(person, options, measured) for person in options.people[:PEOPLE]}
        noted(measured, self.name, rows)
        yield from people_table(COLUMNS, rows)


def figures_of(person: Person, options: Options, measured: Measured) -> dict[str, Value]:
    """The figures of a person, by the columns' names; none without a result."""
    frames = measured.frames(options.task(person, FREE_ELBOW, DEFAULT), DEFAULT)
    if frames is None:
        return {}
    return {
        "found_within": found_within(frames.wrist, frames.lost) or NEVER,
        "kept": kept(frames.wrist),
        "error_mm": float(frames.error.mean()),
        "lost": int(frames.lost.sum()),
    }
