"""How much of the study is done, and what its parts have in common."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from reproduction import running
from reproduction.running import FIRST_SEED
from reproduction.steps import Chain

MODEL_PEOPLE, PEOPLE = 11, 6
"""S of the thesis; and with six pairs Wilcoxon's test can find a difference."""
FRAMES, MOTION_FRAMES = 1800, 420
LEAST_MOTION_FRAMES = 240
"""Eight seconds: in shorter ones the two motions are so quick that the stereo tracker does not see them in
full, and no model can be built."""


@dataclass(frozen=True)
class Options:
    """How much is done.

    Attributes:
        output: folder of everything.
        heads: folder of recordings of other faces, with truth; None leaves them out.
        clips: folder of videos of faces; None leaves them out.
        people: test persons, who are the first of the model's.
        model_people: S, persons that the model is built from.
        frames: per test recording.
        motion_frames: per recording of the two motions.
        first_identity: seed of the first person; smaller ones than the default are for trying things out.
    """

    output: Path
    heads: Path | None = None
    clips: Path | None = None
    people: int = PEOPLE
    model_people: int = MODEL_PEOPLE
    frames: int = FRAMES
    motion_frames: int = MOTION_FRAMES
    first_identity: int = FIRST_SEED

    @property
    def persons(self) -> range:
        """Seeds of the test persons."""
        return range(self.first_identity, self.first_identity + self.people)

    @property
    def modelled(self) -> range:
        """Seeds of the persons that the model is built from."""
        return range(self.first_identity, self.first_identity + self.model_people)


class Part(running.Part[Options, Any], Protocol):
    """One part of the study: what it needs, and what it says about it."""

    def chains(self, options: Options) -> list[Chain]:
        """What has to be made."""
