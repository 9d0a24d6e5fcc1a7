"""The order of jobs in a batch, with an engine that does them one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from posetrack_cli.batch.jobs import Job, Kind, Limits, Outcome, Piece, State
from posetrack_cli.batch.scheduling import PieceArguments, run_batch

PIECES = (Piece(0, 40, 0, 40), Piece(30, 80, 40, 80), Piece(70, 120, 80, 120))


class OneByOne:
    """Does jobs in the order given, what goes on with one first; so pieces end in reverse."""

    def __init__(self, does: Callable[[Job], Outcome]) -> None:
        self._does = does
        self._waiting: list[Job] = []
        self.done: list[Job] = []
        self.is_stopped = False

    def submit(self, job: Job, limits: Limits, *, is_continuation: bool = False) -> None:
        self._waiting.insert(0 if is_continuation else len(self._waiting), job)

    def next_outcome(self, timeout_s: float) -> Outcome | None:
        job = self._waiting.pop(0)
        self.done.append(job)
        return Outcome(job.name, State.STOPPED) if self.is_stopped else self._does(job)

    def stop(self) -> None:
        self.is_stopped = True


def make_jobs(*names: str) -> list[Job]:
    return [
        Job(
            name,
            ("hand", "run"),
            Path(f"{name}.mcap"),
            ("--seed=1",),
            Path(f"out/{name}.mcap"),
            Path(f"r/{name}.json"),
            Path(),
        )
        for name in names
    ]


def piece_arguments() -> PieceArguments:
    def arguments(job: Job, number: int, learned: Path) -> tuple[str, ...]:
        return job.arguments if number == 0 else (*job.arguments, f"--shape={learned}")

    return arguments


def tracked(job: Job) -> Outcome:
    pieces = PIECES if job.kind is Kind.SPLIT else ()
    return Outcome(
        job.name,
        State.DONE,
        seconds=1.0,
        cpu_s=2.0,
        frames=40 if job.kind is Kind.TRACK else 0,
        pieces=pieces,
    )


def test_outcomes_are_in_the_order_of_the_jobs() -> None:
    engine, seen = OneByOne(tracked), []
    found = run_batch(engine, make_jobs("b", "a", "c"), Limits(), report=lambda one: seen.append(one.name))
    assert [one.name for one in found] == ["b", "a", "c"]
    assert sorted(seen) == ["a", "b", "c"]


def test_pieces_follow_the_first_and_are_joined() -> None:
    engine = OneByOne(tracked)
    (found,) = run_batch(engine, make_jobs("a"), Limits(), piece_arguments())
    split, first, *others, join = engine.done
    assert (split.kind, join.kind) == (Kind.SPLIT, Kind.JOIN)
    assert first.arguments == ("--seed=1", "--start=0", "--end=40")
    learned = f"--shape={first.output}"
    assert {one.arguments for one in others} == {
        ("--seed=1", learned, "--start=30", "--end=80"),
        ("--seed=1", learned, "--start=70", "--end=120"),
    }
    assert [path for path, _ in join.pieces] == [Path(f"r/a.pieces/{k:05d}.mcap") for k in range(3)]
    assert tuple(piece for _, piece in join.pieces) == PIECES
    assert (found.state, found.seconds, found.cpu_s, found.frames) == (State.DONE, 5.0, 10.0, 120)


def test_what_is_begun_is_finished_before_others_begin() -> None:
    engine = OneByOne(tracked)
    run_batch(engine, make_jobs("a", "b"), Limits(), piece_arguments())
    assert [job.name[0] for job in engine.done] == ["a"] * 5 + ["b"] * 5


def test_a_recording_of_one_piece_is_tracked_whole() -> None:
    def one_piece(job: Job) -> Outcome:
        return Outcome(job.name, State.DONE, pieces=PIECES[:1] if job.kind is Kind.SPLIT else ())

    engine = OneByOne(one_piece)
    run_batch(engine, make_jobs("a"), Limits(), piece_arguments())
    assert [(job.name, job.kind, job.arguments) for job in engine.done] == [
        ("a", Kind.SPLIT, ("--seed=1",)),
        ("a", Kind.TRACK, ("--seed=1",)),
    ]


def test_a_joined_result_that_is_kept_is_the_end() -> None:
    engine = OneByOne(lambda job: Outcome(job.name, State.KEPT))
    (found,) = run_batch(engine, make_jobs("a"), Limits(), piece_arguments())
    assert (found.state, len(engine.done)) == (State.KEPT, 1)


@pytest.mark.parametrize(("number", "jobs"), [(0, 2), (2, 4)])
def test_a_piece_that_fails_is_told_with_its_frames(number: int, jobs: int) -> None:
    """Others go on, and are there the next time; nothing follows a first one that fails."""

    def fails(job: Job) -> Outcome:
        return Outcome(job.name, State.FAILED, "no hand") if job.name == f"a//{number}" else tracked(job)

    engine = OneByOne(fails)
    (found,) = run_batch(engine, make_jobs("a"), Limits(), piece_arguments())
    piece = PIECES[number]
    assert (found.name, found.state) == ("a", State.FAILED)
    assert found.reason == f"frames {piece.start} to {piece.end - 1}: no hand"
    assert len(engine.done) == jobs


def test_a_stop_ends_every_recording() -> None:
    engine = OneByOne(tracked)
    asked = iter([False, False, True])
    found = run_batch(engine, make_jobs("a", "b", "c", "d"), Limits(), stopped=lambda: next(asked, True))
    assert [one.state for one in found] == [State.DONE, State.DONE, State.STOPPED, State.STOPPED]


def of_people(*people: str) -> list[Job]:
    """Jobs 0, 1, ... of these people; empty for an unknown one."""
    names = [str(number) for number in range(len(people))]
    return [replace(job, person=person) for job, person in zip(make_jobs(*names), people, strict=True)]


def with_shape(job: Job, learned: Sequence[Job]) -> tuple[str, ...]:
    return (*job.arguments, *(f"--shape={one.output}" for one in learned))


def shapes_of(engine: OneByOne) -> dict[str, str]:
    """Name of the recording whose shape each job has, empty for its own."""
    given = {
        job.name: [Path(one).stem for one in job.arguments if one.startswith("--shape")]
        for job in engine.done
    }
    return {name: " ".join(shapes) for name, shapes in given.items()}


def test_the_first_recording_of_a_person_determines_the_shape_of_the_others() -> None:
    engine = OneByOne(tracked)
    found = run_batch(
        engine, of_people("p", "q", "", "p", "q", "p", ""), Limits(), person_arguments=with_shape
    )
    assert [one.name for one in found] == list("0123456")
    assert shapes_of(engine) == {"0": "", "1": "", "2": "", "3": "0", "4": "1", "5": "0", "6": ""}


@pytest.mark.parametrize(
    "bad", [Outcome("0", State.FAILED), Outcome("0", State.DONE, lost_data=True)], ids=str
)
def test_a_person_s_next_recording_takes_the_place_of_a_bad_first_one(bad: Outcome) -> None:
    engine = OneByOne(lambda job: bad if job.name == "0" else tracked(job))
    run_batch(engine, of_people("p", "p", "p"), Limits(), person_arguments=with_shape)
    assert shapes_of(engine) == {"0": "", "1": "", "2": "1"}


@pytest.mark.parametrize("bad", ["", "0", "1", "0 1"])
def test_two_recordings_determine_a_person_whatever_order_they_end_in(bad: str) -> None:
    """The last one submitted ends first."""

    class Reversed(OneByOne):
        def submit(self, job: Job, limits: Limits, *, is_continuation: bool = False) -> None:
            self._waiting.insert(0, job)

    def does(job: Job) -> Outcome:
        return Outcome(job.name, State.FAILED) if job.name in bad.split() else tracked(job)

    jobs, shapes = of_people("p", "p", "p", "p", "p"), []
    for engine in (OneByOne(does), Reversed(does)):
        run_batch(engine, jobs, Limits(), person_arguments=with_shape, determining=2)
        shapes.append(shapes_of(engine))
    first = [name for name in "01234" if name not in bad.split()][:2]
    others = [name for name in "01234" if name > first[-1]]
    assert shapes[0] == shapes[1] == dict.fromkeys("01234", "") | dict.fromkeys(others, " ".join(first))


def test_pieces_of_a_person_s_recording_have_its_shape() -> None:
    engine = OneByOne(tracked)
    run_batch(engine, of_people("p", "p"), Limits(), piece_arguments(), with_shape)
    pieces = [job for job in engine.done if job.name.startswith("1//")]
    assert len(pieces) == 3 and all("--shape=out/0.mcap" in job.arguments for job in pieces)


def test_a_stop_ends_recordings_that_wait_for_a_shape() -> None:
    engine = OneByOne(tracked)
    found = run_batch(engine, of_people("p", "p", "p"), Limits(), stopped=lambda: True)
    assert {one.state for one in found} == {State.STOPPED}
