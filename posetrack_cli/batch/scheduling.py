"""Scheduling of a batch: started recordings are finished first, and failures are isolated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from posetrack_cli.batch.jobs import PIECE, Job, Kind, Limits, Outcome, Piece, State, recording_of

_POLL_S = 0.25


class JobEngine(Protocol):
    """Runs jobs concurrently (``engine.Engine``)."""

    def submit(self, job: Job, limits: Limits, *, is_continuation: bool = False) -> None:
        """Submit a job; a continuation starts before all waiting jobs."""

    def next_outcome(self, timeout_s: float) -> Outcome | None:
        """Return the outcome of the next job to end, or None if none ends within ``timeout_s``."""

    def stop(self) -> None:
        """Stop running jobs and start no further ones."""


PieceArguments = Callable[[Job, int, Path], tuple[str, ...]]
"""Return the options of a piece except its frame range, from the job, the number of the piece, and the result
of the first piece, which initialises the others."""

PersonArguments = Callable[[Job, Sequence[Job]], tuple[str, ...]]
"""Return the options of a job that takes the shape of its person from the results of other jobs."""


def run_batch(
    engine: JobEngine,
    jobs: Sequence[Job],
    limits: Limits,
    piece_arguments: PieceArguments | None = None,
    person_arguments: PersonArguments = lambda job, learned: job.arguments,
    determining: int = 1,
    report: Callable[[Outcome], None] = lambda outcome: None,
    stopped: Callable[[], bool] = lambda: False,
) -> list[Outcome]:
    """Run all jobs.

    Args:
        engine: runs the jobs.
        jobs: one per recording, with unique names.
        limits: resource limits of each job.
        piece_arguments: options of the pieces of long recordings; None does not split recordings.
        person_arguments: options of the other recordings of a person, once the first ones have results.
        determining: number of recordings that determine the shape of a person.
        report: called with the outcome of each recording.
        stopped: polled several times per second; returns True to stop the batch.

    Returns:
        The outcomes, in the order of ``jobs``.
    """
    parts = {job.name: _Recording(job, piece_arguments) for job in jobs}
    found: dict[str, Outcome] = {}
    is_stopping = False
    people = _People(parts.values(), person_arguments, determining)
    for recording in people.first:
        engine.submit(recording.first, limits)
    while len(found) < len(parts):
        if not is_stopping and stopped():
            is_stopping = True
            engine.stop()
        outcome = engine.next_outcome(_POLL_S)
        if outcome is None:
            continue
        recording = parts[recording_of(outcome.name)]
        for job in recording.after(outcome):
            engine.submit(job, limits, is_continuation=True)
        # Each recording is reported once.
        if recording.result is not None and recording.job.name not in found:
            found[recording.job.name] = recording.result
            report(recording.result)
            for other in people.after(recording):
                engine.submit(other.first, limits)
    return [found[job.name] for job in jobs]


class _People:
    """Recordings of one person: the first ones determine the shape, the others wait for them.

    Only the order of the recordings decides which are first, so results do not depend on the workers. A first
    recording without a usable result passes its part on to the next one.

    Attributes:
        first: recordings that wait for no other.
    """

    def __init__(
        self, recordings: Iterable[_Recording], arguments: PersonArguments, determining: int
    ) -> None:
        self._arguments, self._determining = arguments, determining
        self._begun: dict[str, list[_Recording]] = {}
        self._waiting: dict[str, list[_Recording]] = {}
        self.first: list[_Recording] = []
        for one in recordings:
            begun = self._begun.setdefault(one.job.person, [])
            if one.job.person and len(begun) == determining:
                self._waiting.setdefault(one.job.person, []).append(one)
            else:
                begun.append(one)
                self.first.append(one)

    def after(self, ended: _Recording) -> list[_Recording]:
        """Return the recordings that may start after one has ended."""
        person = ended.job.person
        waiting, begun = self._waiting.get(person, []), self._begun[person]
        if not waiting:
            return []
        if not ended.is_usable:
            begun.append(waiting.pop(0))
            return begun[-1:]
        learned = [one.job for one in begun if one.is_usable]
        if len(learned) < self._determining:
            return []
        self._waiting[person] = []
        for one in waiting:
            one.job = replace(one.job, arguments=self._arguments(one.job, learned))
        return waiting


@dataclass
class _Recording:
    """Progress of one recording through split, track and join."""

    job: Job
    piece_arguments: PieceArguments | None
    result: Outcome | None = None
    _split: tuple[Piece, ...] = ()
    _pieces: dict[str, Outcome] = field(default_factory=dict)
    _before: list[Outcome] = field(default_factory=list)

    @property
    def is_usable(self) -> bool:
        """Whether there is a result without losses."""
        return self.result is not None and self.result.has_result and not self.result.lost_data

    @property
    def first(self) -> Job:
        """The first job of the recording."""
        return self.job if self.piece_arguments is None else self.job.as_kind(Kind.SPLIT)

    def after(self, outcome: Outcome) -> Iterable[Job]:
        """Return the jobs that follow the outcome of one; empty once the recording has a result."""
        if outcome.name != self.job.name:
            return self._after_piece(outcome)
        if outcome.state is State.DONE and outcome.pieces:
            self._split, self.job = outcome.pieces, replace(self.job, digests=outcome.digests)
            self._before.append(outcome)
            # A short recording is tracked as a whole, without joining.
            return [self.job] if len(self._split) == 1 else [self._piece(0)]
        self.result = _together(outcome, [*self._before, *self._pieces.values()])
        return []

    def _after_piece(self, outcome: Outcome) -> Iterable[Job]:
        self._pieces[outcome.name] = outcome
        # The first piece runs alone, as the others are initialised from its result.
        if len(self._pieces) == 1 and outcome.has_result:
            return [self._piece(number) for number in range(1, len(self._split))]
        is_first_missing = len(self._pieces) == 1
        if is_first_missing or len(self._pieces) == len(self._split):
            missing = [one for one in self._pieces.values() if not one.has_result]
            if not missing:
                return [self.job.as_kind(Kind.JOIN, pieces=self._shares())]
            self.result = self._failed(missing)
        return []

    def _failed(self, missing: Sequence[Outcome]) -> Outcome:
        """Return the outcome of a recording with missing pieces; the next run keeps the others."""
        worst = next((one for one in missing if one.state is State.FAILED), missing[0])
        number = int(worst.name.partition(PIECE)[2])
        piece = self._split[number]
        reason = f"frames {piece.start} to {piece.end - 1}: {worst.reason}" if worst.reason else ""
        # Time and frames are zeroed here, as they are added up over all pieces below.
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
    """Add the time, memory, frames and remarks of the parts to the outcome of a recording."""
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
    """Return the number of recordings in each state, such as ``3 recordings: 2 done, 1 failed``."""
    counts = Counter(outcome.state for outcome in outcomes)
    listed = ", ".join(f"{counts[state]} {state.value}" for state in State if counts[state])
    return f"{len(outcomes)} recordings: {listed}"
