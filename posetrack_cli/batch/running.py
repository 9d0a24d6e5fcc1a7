"""A batch from its first job to its last: what is begun is finished first, and what fails, fails alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from posetrack_cli.batch.jobs import PIECE, Job, Kind, Limits, Outcome, Piece, State, recording_of

_LOOKED_EVERY_S = 0.25


class JobEngine(Protocol):
    """Does jobs side by side (``engine.Engine``)."""

    def submit(self, job: Job, limits: Limits, *, goes_on: bool = False) -> None:
        """Give a job; what goes on with one comes before all that wait."""

    def next_outcome(self, timeout_s: float) -> Outcome | None:
        """Wait for the next job that is over; None if none is so soon."""

    def stop(self) -> None:
        """Have jobs stop, and begin no others."""


PieceArguments = Callable[[Job, int, Path], tuple[str, ...]]
"""Returns the options of a piece, but for its frames: of the job, the piece's number, and the result of the
first piece, from which the others begin."""


def run_batch(
    engine: JobEngine,
    jobs: Sequence[Job],
    limits: Limits,
    piece_arguments: PieceArguments | None = None,
    report: Callable[[Outcome], None] = lambda outcome: None,
    stopped: Callable[[], bool] = lambda: False,
) -> list[Outcome]:
    """Do all jobs.

    Args:
        engine: does them.
        jobs: of one recording each, with different names.
        limits: what each may take.
        piece_arguments: of the pieces that long recordings are split into; None leaves them whole.
        report: called with what came of each recording.
        stopped: asked several times a second whether to stop.

    Returns:
        What came of each, in the order of the jobs.
    """
    parts = {job.name: _Recording(job, piece_arguments) for job in jobs}
    found: dict[str, Outcome] = {}
    is_stopping = False
    for recording in parts.values():
        engine.submit(recording.first, limits)
    while len(found) < len(parts):
        if not is_stopping and stopped():
            is_stopping = True
            engine.stop()
        outcome = engine.next_outcome(_LOOKED_EVERY_S)
        if outcome is None:
            continue
        recording = parts[recording_of(outcome.name)]
        for job in recording.after(outcome):
            engine.submit(job, limits, goes_on=True)
        if recording.result is not None and recording.job.name not in found:
            found[recording.job.name] = recording.result
            report(recording.result)
    return [found[job.name] for job in jobs]


@dataclass
class _Recording:
    """Where a recording is, and what is to be done next."""

    job: Job
    piece_arguments: PieceArguments | None
    result: Outcome | None = None
    _split: tuple[Piece, ...] = ()
    _pieces: dict[str, Outcome] = field(default_factory=dict)
    _before: list[Outcome] = field(default_factory=list)

    @property
    def first(self) -> Job:
        """What is done first."""
        return self.job if self.piece_arguments is None else self.job.as_kind(Kind.SPLIT)

    def after(self, outcome: Outcome) -> Iterable[Job]:
        """Return what is to be done after a job of this recording; none once there is a result."""
        if outcome.name != self.job.name:
            return self._after_piece(outcome)
        if outcome.state is State.DONE and outcome.pieces:
            self._split, self.job = outcome.pieces, replace(self.job, digests=outcome.digests)
            self._before.append(outcome)
            return [self.job] if len(self._split) == 1 else [self._piece(0)]
        self.result = _together(outcome, [*self._before, *self._pieces.values()])
        return []

    def _after_piece(self, outcome: Outcome) -> Iterable[Job]:
        self._pieces[outcome.name] = outcome
        if len(self._pieces) == 1 and outcome.is_there:
            return [self._piece(number) for number in range(1, len(self._split))]
        is_first_missing = len(self._pieces) == 1
        if is_first_missing or len(self._pieces) == len(self._split):
            missing = [one for one in self._pieces.values() if not one.is_there]
            if not missing:
                return [self.job.as_kind(Kind.JOIN, pieces=self._shares())]
            self.result = self._failed(missing)
        return []

    def _failed(self, missing: Sequence[Outcome]) -> Outcome:
        """What came of a recording whose pieces are not all there; the others wait for the next time."""
        worst = next((one for one in missing if one.state is State.FAILED), missing[0])
        number = int(worst.name.partition(PIECE)[2])
        piece = self._split[number]
        reason = f"frames {piece.start} to {piece.end - 1}: {worst.reason}" if worst.reason else ""
        outcome = replace(worst, name=self.job.name, reason=reason, seconds=0.0, cpu_s=0.0, frames=0)
        return _together(outcome, self._pieces.values())

    def _piece(self, number: int) -> Job:
        assert self.piece_arguments is not None
        piece, folder = self._split[number], self.job.pieces_folder
        return replace(
            self.job,
            name=f"{self.job.name}{PIECE}{number}",
            arguments=(
                *self.piece_arguments(self.job, number, self._output(0)),
                f"--start={piece.start}",
                f"--end={piece.end}",
            ),
            output=self._output(number),
            record=folder / f"{number:05d}.json",
            page=None,
            chunk_s=0.0,
            overlap_s=0.0,
        )

    def _output(self, number: int) -> Path:
        return self.job.pieces_folder / f"{number:05d}.mcap"

    def _shares(self) -> tuple[tuple[Path, Piece], ...]:
        return tuple((self._output(number), piece) for number, piece in enumerate(self._split))


def _together(outcome: Outcome, parts: Iterable[Outcome]) -> Outcome:
    """What came of a recording, with what its parts took."""
    every = [outcome, *parts]
    remarks = dict.fromkeys(remark for one in every for remark in one.remarks)
    return replace(
        outcome,
        seconds=sum(one.seconds for one in every),
        cpu_s=sum(one.cpu_s for one in every),
        peak_bytes=max(one.peak_bytes for one in every),
        frames=sum(one.frames for one in every),
        remarks=tuple(remarks),
    )


def states_line(outcomes: Sequence[Outcome]) -> str:
    """Say how many recordings there are of each state: ``3 recordings: 2 done, 1 failed``."""
    counts = Counter(outcome.state for outcome in outcomes)
    said = ", ".join(f"{counts[state]} {state.value}" for state in State if counts[state])
    return f"{len(outcomes)} recordings: {said}"
