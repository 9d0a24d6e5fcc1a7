"""How long each part measures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Lengths:
    """How much is measured.

    Attributes:
        repeats: of each timing of the renderer.
        hand_frames: of the synthetic hand, for times per frame.
        head_frames: of the synthetic head, seen to and fro.
        head_steps: tracked of it.
        hand_memory, head_memory: of a long run; the short one has a tenth.
        eval_frames: of a long result.
        batch_frames: of each of the recordings of a batch.
        batch_jobs: very short ones.
    """

    repeats: int
    hand_frames: int
    head_frames: int
    head_steps: int
    hand_memory: int
    head_memory: int
    eval_frames: int
    batch_frames: int
    batch_jobs: int


FULL = Lengths(31, 120, 120, 300, 1500, 2400, 100_000, 300, 2000)
QUICK = Lengths(5, 20, 30, 60, 100, 300, 2_000, 8, 500)
