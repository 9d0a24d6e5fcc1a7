"""How much of the study is done, and what its parts have in common."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from reproduction import running
from reproduction.heads.measuring import Measured
from reproduction.heads.tasks import Task
from reproduction.running import FIRST_SEED

EXPERIMENT_FRAMES, FRAMES, IDENTITIES = 1800, 300, 3


@dataclass(frozen=True)
class Options:
    """How much is done.

    Attributes:
        output: folder of everything.
        heads: folder of recordings of real or realistic faces; None leaves them out.
        experiment_frames: of experiment 3.4.
        frames: per recording of the other conditions.
        identities: persons per condition.
        first_identity: seed of the first person and of what happens; smaller ones are for trying things out.
        conditions: those that are done; none for all.
    """

    output: Path
    heads: Path | None = None
    experiment_frames: int = EXPERIMENT_FRAMES
    frames: int = FRAMES
    identities: int = IDENTITIES
    first_identity: int = FIRST_SEED
    conditions: tuple[str, ...] = ()

    @property
    def persons(self) -> range:
        """Seeds of the synthetic persons."""
        return range(self.first_identity, self.first_identity + self.identities)


class Part(running.Part[Options, Measured], Protocol):
    """One part of the study: the recordings it needs, and what it says about their results."""

    def tasks(self, options: Options) -> list[Task]:
        """What has to be tracked."""


def synthetic(identity: int, frames: int, *more: str) -> tuple[str, ...]:
    """Arguments that make a synthetic recording of two cameras."""
    return ("--identity", str(identity), "--seed", str(identity), "--frames", str(frames), *more)
