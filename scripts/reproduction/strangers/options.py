"""What the study is asked for, and what every part of it has in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from reproduction import running
from reproduction.accuracy.options import AVERAGE, NO_MESH
from reproduction.accuracy.tasks import Task as AccuracyTask
from reproduction.strangers.measuring import Measured
from reproduction.strangers.people import Person
from reproduction.strangers.tasks import CALIBRATE, HAND_OF, MESH, Task

EXACT, DEFAULT = "mesh", "default"
"""Names of entrants: with the person's own mesh, and without being told anything."""
PLAIN_FILTER, UNION_COST, PAPER_COST, SWARM = "pf", "union", "paper", "pso"
"""Those that differ from the default in one thing, and are told the hand that it found."""
AVERAGE_HAND, SHAPE_ALONE = "average", "shape"
FOUND = ("--shape", HAND_OF + DEFAULT, *NO_MESH)
ENTRANTS: dict[str, tuple[str, ...]] = {
    EXACT: ("--hand-mesh", MESH, "--smooth", *NO_MESH),
    DEFAULT: NO_MESH,
    PLAIN_FILTER: ("--filter", "pf", *FOUND),
    UNION_COST: ("--cost", "union", *FOUND),
    PAPER_COST: ("--cost", "paper", *FOUND),
    SWARM: ("--filter", "pso", *FOUND),
    AVERAGE_HAND: (*AVERAGE, *NO_MESH),
    SHAPE_ALONE: (CALIBRATE,),
}
ARM, NO_ARM, DOUBLE_SPEED, FREE_ELBOW = "arm", "no-arm", "double-speed", "free-elbow"
"""Kinds of recordings."""
RECORDINGS: dict[str, tuple[str, ...]] = {
    ARM: (),
    NO_ARM: ("--no-arm",),
    DOUBLE_SPEED: ("--speed", "2"),
    FREE_ELBOW: ("--free-elbow",),
}
"""By kind the further arguments of the tool."""


@dataclass(frozen=True)
class Options:
    """How much is done.

    Attributes:
        output: folder of everything.
        tool: that draws strangers' hands.
        people: who is recorded.
        drawn: of whom pictures are made.
        frames: per recording.
        cvar: folder of the annotated, head-mounted recordings; None leaves them out.
    """

    output: Path
    tool: Path
    people: tuple[Person, ...]
    drawn: tuple[Person, ...] = ()
    frames: int = 300
    cvar: Path | None = None

    @property
    def runs(self) -> Path:
        """Where results lie."""
        return self.output / "runs"

    def task(self, person: Person, kind: str, *entrants: str) -> Task:
        """A person's recording of a kind, tracked by some entrants."""
        recording = person.recording(self.frames, *RECORDINGS[kind])
        name = f"{person.number}-{kind}-{self.frames}"
        return Task(name, str(self.tool), recording, {entrant: ENTRANTS[entrant] for entrant in entrants})


AnyTask = Task | AccuracyTask


class Part(running.Part[Options, Measured], Protocol):
    """One part of the study: the recordings it needs, and what it says about their results."""

    def tasks(self, options: Options) -> Sequence[AnyTask]:
        """What has to be tracked."""
