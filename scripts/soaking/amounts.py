"""How much is done in every part."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Amounts:
    """How much is done.

    Attributes:
        frames: of each tracker's long run.
        kills: of runs in all, and of batches.
        disks: sizes of a full disk, for each tracker.
        at_once: runs that begin together on an empty kernel cache.
        recorded: synthetic frames, which long recordings show to and fro.
        short: frames of the runs that are killed or run out of disk; a multiple of FLUSH_FRAMES.
    """

    frames: int
    kills: int
    disks: int
    at_once: int
    recorded: int
    short: int

    def __str__(self) -> str:
        return f"{self.frames} frames, {self.kills} kills, {self.disks} disks, {self.at_once} at once"


FULL = Amounts(20_000, 100, 10, 4, 90, 60)
QUICK = Amounts(90, 3, 1, 2, 20, 20)
FLUSH_FRAMES = 10
"""Between two checkpoints of a short run."""
