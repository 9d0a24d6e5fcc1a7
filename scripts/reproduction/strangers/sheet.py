"""Pictures of frames over a whole recording, so that one can look."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from reproduction.running import Targets
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import ARM, DEFAULT, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tasks import VIEW, Task

PICTURE = "default-sheet"
DRAWN = (VIEW, DEFAULT, "--select", "spread:6")


class Sheets:
    """Observed and estimated, with the defaults."""

    name = "sheet"

    def tasks(self, options: Options) -> list[Task]:
        """The chosen people; what is drawn is the result of the part ``default``."""
        return [task_of(person, options) for person in options.drawn]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A picture per person."""
        yield "## Frames to look at"
        yield ""
        for person in options.drawn:
            task = task_of(person, options)
            if task.is_current(measured.folder, PICTURE):
                picture = task.result(measured.folder, PICTURE)
                measured.note(self.name, str(person.number), {"picture": picture.name})
                yield f"Person {person.title}:"
                yield ""
                yield f"![Person {person.title}]({picture.relative_to(options.output)})"
                yield ""


def task_of(person: Person, options: Options) -> Task:
    """The default's task, and its picture."""
    task = options.task(person, ARM, DEFAULT)
    return replace(task, entrants={**task.entrants, PICTURE: DRAWN})
