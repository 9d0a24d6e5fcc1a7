"""What one process of a study does: a recording, tracked by every entrant whose result is not there yet."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

import click

from posetrack_cli.errors import PosetrackError
from reproduction.made import is_made, mark_made


class EntrantsTask(ABC):
    """A task that is told to its process as JSON; a dataclass of texts, tuples of texts and mappings to such.

    Attributes:
        name: what its files are called by.
        entrants: names of what tracks the recording.
    """

    name: str
    entrants: Collection[str]

    @abstractmethod
    def result(self, out: Path, entrant: str) -> Path:
        """Where an entrant's result lies."""

    @abstractmethod
    def facts(self, entrant: str) -> dict[str, object]:
        """What a result depends on."""

    @abstractmethod
    def prepared(self, out: Path) -> AbstractContextManager[Callable[[str], None]]:
        """Make the recording; yield what tracks it by an entrant, or raises PosetrackError."""

    @property
    def text(self) -> str:
        """As JSON."""
        return json.dumps(asdict(self))  # type: ignore[call-overload]

    @classmethod
    def of_text(cls, text: str) -> Self:
        """The task of a JSON text."""
        return cls(**{name: _with_tuples(value) for name, value in json.loads(text).items()})

    @classmethod
    def command(cls) -> click.Command:
        """Return the command of the process: a task and the folder of the results."""
        task = click.Argument(["task"], type=cls.of_text)
        out = click.Argument(["out"], type=click.Path(path_type=Path))
        told = "Make the recording and track it by every entrant whose result is not there yet."
        return click.Command("task", callback=lambda task, out: task.run(out), params=[task, out], help=told)

    def run(self, out: Path) -> None:
        """Track by the entrants whose result of the same code and arguments is not there.

        Raises:
            PosetrackError: a command failed; what it said is on standard error.
        """
        missing = [entrant for entrant in self.entrants if not self.is_current(out, entrant)]
        failed = self._track(out, missing) if missing else []
        if failed:
            raise PosetrackError(f"{self.name}: failed: {', '.join(failed)}")

    def is_current(self, out: Path, entrant: str) -> bool:
        """Whether the result that the same code and arguments give is there."""
        return is_made(self.result(out, entrant), self.facts(entrant))

    def _track(self, out: Path, missing: Collection[str]) -> list[str]:
        """Track by some entrants; return those that failed, which do not keep the others from it."""
        failed = []
        with self.prepared(out) as track:
            for entrant in missing:
                try:
                    track(entrant)
                except PosetrackError as error:
                    click.echo(str(error), err=True)
                    failed.append(entrant)
                else:
                    mark_made(self.result(out, entrant), self.facts(entrant))
        return failed


def _with_tuples(value: Any) -> Any:
    """A value of JSON with tuples in the place of lists."""
    if isinstance(value, dict):
        return {name: _with_tuples(one) for name, one in value.items()}
    return tuple(value) if isinstance(value, list) else value
