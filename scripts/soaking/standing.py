"""How far a run has come, told by its checkpoint from outside."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.errors import ResultError
from posetrack_cli.outputs import state_path
from posetrack_cli.results.spool import load
from posetrack_cli.tracking.smoothing import learned_before
from soaking.cases import Case


@dataclass(frozen=True)
class Standing:
    """A checkpoint.

    Attributes:
        steps: frames tracked in all passes.
        written: frames in the result.
    """

    steps: int
    written: int


def standing_of(case: Case, output: Path) -> Standing | None:
    """Return where the run that writes this output stands; None before its first checkpoint."""
    try:
        checkpoint, _ = load(state_path(output))
    except ResultError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise
    written = checkpoint.frames_written
    first_pass = checkpoint.state.get("first_pass_frame")  # as tracking.two_pass calls it
    if first_pass is not None:
        return Standing(int(first_pass) + 1, 0)
    in_second = case.passes == 2 and bool(learned_before(checkpoint))
    return Standing(written + (case.frames if in_second else 0), written)
