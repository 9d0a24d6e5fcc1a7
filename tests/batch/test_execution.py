"""What is done with a job, by what is there of it already."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from posetrack_cli.batch import execution
from posetrack_cli.batch.execution import ProcessResult, planned_action, run_job
from posetrack_cli.batch.jobs import Job, Kind, Limits, Outcome, State, record_path
from posetrack_cli.batch.records import read_record, write_record
from posetrack_cli.outputs import part_path, state_path

REDO = Limits(redo=True)


class Children:
    """Stand in for processes: they write what they are asked for, or end as they are told to."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, ...]] = []
        self.endings: list[ProcessResult] = []
        self.text = "result"

    def run(self, job: Job, arguments: tuple[str, ...], *_: object) -> ProcessResult:
        self.asked.append(arguments)
        ending = self.endings.pop(0) if self.endings else ProcessResult(messages={"tracked": 9, "cpu_s": 0.5})
        if ending.code == 0:
            if arguments:
                job.output.write_text(self.text)
            if job.page is not None:
                job.page.write_text("page")
        return ending

    @property
    def ways(self) -> list[str]:
        """How earlier output was to be treated in each run; ``page`` where only that was asked for."""
        known = {"--resume", "--overwrite"}
        return [next(iter(known & set(one)), "new") if one else "page" for one in self.asked]


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> Children:
    made = Children()
    monkeypatch.setattr(execution, "run_child", lambda *arguments: made.run(*arguments))
    return made


@pytest.fixture
def job(tmp_path: Path) -> Job:
    (tmp_path / "a.mcap").write_text("recording")
    out = tmp_path / "out"
    out.mkdir()
    record = record_path(out, "a")
    return Job("a", ("hand", "run"), tmp_path / "a.mcap", ("--seed=1",), out / "a.mcap", record, out)


def done(job: Job, limits: Limits = Limits()) -> Outcome:  # noqa: B008 frozen
    return run_job(job, limits)


def test_a_job_is_tracked_once_and_then_kept(job: Job, children: Children) -> None:
    assert planned_action(job, Limits()) == "track"
    assert done(job).state is State.DONE
    assert planned_action(job, Limits()) == "keep"
    kept = done(job)
    assert (kept.state, kept.frames, kept.cpu_s) == (State.KEPT, 9, 0.5)
    expected = ("hand", "run", "--seed=1", "-o", str(job.output), "--", str(job.recording))
    assert children.asked == [expected]


@pytest.mark.parametrize("change", ["recording", "options", "sources", "redo"])
def test_a_job_that_differs_is_done_anew(job: Job, children: Children, change: str) -> None:
    done(job)
    limits = REDO if change == "redo" else Limits()
    if change == "recording":
        job.recording.write_text("another")
    if change == "options":
        job = replace(job, arguments=("--seed=2",))
    if change == "sources":
        job = replace(job, sources="of other code")
    assert planned_action(job, limits) == "replace"
    assert done(job, limits).state is State.DONE
    assert children.ways == ["new", "--overwrite"]


def test_a_result_that_no_batch_made_is_left_alone(job: Job, children: Children) -> None:
    job.output.write_text("mine")
    outcome = done(job)
    assert (outcome.state, children.asked) == (State.FAILED, [])
    assert "already exists and was not created by posetrack batch; use --redo to replace it" in outcome.reason
    assert job.output.read_text() == "mine"
    assert done(job, REDO).state is State.DONE


def test_a_result_that_was_put_there_since_is_left_alone(job: Job, children: Children) -> None:
    done(job)
    job.output.write_text("mine")
    job = replace(job, arguments=("--seed=2",))
    assert done(job).state is State.FAILED
    assert job.output.read_text() == "mine"


def test_an_interrupted_run_that_no_batch_began_is_left_alone(job: Job, children: Children) -> None:
    state_path(job.output).write_text("state")
    outcome = done(job)
    assert "interrupted run that was not started by posetrack batch" in outcome.reason
    assert children.asked == []


def interrupt(job: Job) -> None:
    part_path(job.output).write_text("part")
    state_path(job.output).write_text("state")


def test_what_was_interrupted_goes_on(job: Job, children: Children) -> None:
    children.endings = [ProcessResult(code=130, stopped=True, messages={"tracked": 4})]
    outcome = done(job)
    assert (outcome.state, outcome.frames) == (State.STOPPED, 4)
    interrupt(job)
    assert planned_action(job, Limits()) == "resume"
    assert done(job).state is State.DONE
    assert children.ways == ["new", "--resume"]


def test_what_cannot_go_on_begins_anew(job: Job, children: Children) -> None:
    children.endings = [ProcessResult(code=130, stopped=True), ProcessResult(code=1)]
    done(job)
    interrupt(job)
    assert done(job).state is State.DONE
    assert children.ways == ["new", "--resume", "--overwrite"]


def test_what_was_begun_with_other_options_is_replaced(job: Job, children: Children) -> None:
    children.endings = [ProcessResult(code=130, stopped=True)]
    done(job)
    interrupt(job)
    done(replace(job, arguments=("--seed=2",)))
    assert children.ways == ["new", "--overwrite"]


def test_a_failure_is_told_and_tried_again(job: Job, children: Children) -> None:
    children.endings = [ProcessResult(code=-6, last_lines=("one", "two"))]
    outcome = done(job)
    assert (outcome.state, outcome.last_lines) == (State.FAILED, ("one", "two"))
    assert outcome.reason == "process was killed by SIGABRT"
    assert done(job).state is State.DONE


def test_a_batch_that_died_before_it_noted_a_result_keeps_it(job: Job, children: Children) -> None:
    done(job)
    known = read_record(job.record)
    assert known is not None
    write_record(job.record, replace(known, state="running", output=(), outcome=None))
    assert done(job).state is State.KEPT
    assert len(children.asked) == 1


def test_a_batch_that_died_while_it_replaced_a_result_replaces_it(job: Job, children: Children) -> None:
    """The result that is there is the one of before."""
    done(job)
    known = read_record(job.record)
    assert known is not None
    write_record(job.record, replace(known, state="running"))
    assert done(job).state is State.DONE
    assert children.ways == ["new", "--overwrite"]


def test_lost_data_is_told_of_a_kept_result_too(job: Job, children: Children) -> None:
    children.endings = [ProcessResult(code=3)]

    def run(of: Job, arguments: tuple[str, ...], *_: object) -> ProcessResult:
        of.output.write_text("result")
        return ProcessResult(code=3)

    children.run = run  # type: ignore[method-assign]
    assert done(job).lost_data
    assert done(job).lost_data


def test_only_a_missing_page_is_written(job: Job, children: Children) -> None:
    done(job)
    with_page = replace(job, page=job.output.with_suffix(".html"))
    assert planned_action(with_page, Limits()) == "keep, write page"
    assert done(with_page).state is State.KEPT
    assert done(with_page).state is State.KEPT
    assert children.ways == ["new", "page"]


def test_a_recording_that_cannot_be_read_fails_alone(job: Job, children: Children) -> None:
    job.recording.unlink()
    outcome = done(job)
    assert outcome.state is State.FAILED
    assert "a.mcap: cannot be read, found No such file" in outcome.reason


def test_a_folder_that_cannot_be_made_fails_alone(job: Job, children: Children) -> None:
    job = replace(job, output=job.results / "day" / "a.mcap")
    job.output.parent.write_text("a file")
    outcome = done(job)
    assert outcome.state is State.FAILED
    assert str(job.output.parent) in outcome.reason


def test_a_stopped_batch_begins_nothing(job: Job, children: Children) -> None:
    assert run_job(job, Limits(), stopped=lambda: True).state is State.STOPPED
    assert children.asked == []


def test_a_joined_result_is_kept_without_its_pieces(job: Job, children: Children) -> None:
    """What is joined is not split again: its pieces are gone."""
    pieces = job.record.with_suffix(".pieces")
    pieces.mkdir(parents=True)
    (pieces / "00000.mcap").write_text("piece")

    def run(of: Job, arguments: tuple[str, ...], *_: object) -> ProcessResult:
        of.output.write_text("joined")
        return ProcessResult()

    children.run = run  # type: ignore[method-assign]
    joining = job.as_kind(Kind.JOIN, pieces=((pieces / "00000.mcap", None),), chunk_s=1.0)
    assert done(joining).state is State.DONE
    assert not pieces.exists()
    pieces.mkdir()  # as a batch leaves it that is killed here
    assert done(replace(job, chunk_s=1.0).as_kind(Kind.SPLIT)).state is State.KEPT
    assert not pieces.exists()


def test_a_job_with_a_damaged_record_is_done_again_and_says_so(job: Job, children: Children) -> None:
    done(job)
    job.record.write_text('{"outcome": {"frames": 1e400}}')
    assert planned_action(job, Limits()).startswith(f"replace ({job.record}: job record is damaged")
    again = done(job)
    assert again.state is State.DONE
    assert again.reason == f"repeated: {job.record}: job record is damaged"
    assert children.ways == ["new", "--overwrite"]
    kept = done(job)
    assert (kept.state, kept.reason) == (State.KEPT, "")


@pytest.mark.parametrize("place", [".batch", ".batch/records", "."])
def test_nothing_is_written_through_a_link_to_a_folder(
    job: Job, children: Children, tmp_path: Path, place: str
) -> None:
    if place == ".":  # the folder of a result below the batch's
        job = replace(job, output=job.results / "day" / "a.mcap")
    link = job.results / "day" if place == "." else job.results / place
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(elsewhere)
    outcome = done(job)
    assert (outcome.state, children.asked) == (State.FAILED, [])
    assert f"{link}: is a symbolic link; refusing to write through it" in outcome.reason
    assert not list(elsewhere.iterdir())


def test_no_pieces_are_written_through_a_link(job: Job, children: Children, tmp_path: Path) -> None:
    pieces = job.record.with_suffix(".pieces")
    pieces.parent.mkdir(parents=True)
    pieces.symlink_to(tmp_path)
    piece = replace(job, name="a//0", output=pieces / "00000.mcap", record=pieces / "00000.json")
    assert "is a symbolic link" in done(piece).reason
    assert not (tmp_path / "00000.json").exists()


@pytest.mark.parametrize("before", ["", "an earlier result"])
def test_a_result_that_was_finished_before_its_process_was_killed_is_kept(
    job: Job, children: Children, before: str
) -> None:
    """Its process still writes a page then, and frees memory; whoever kills it loses no result by that."""
    if before:
        children.text = before
        done(job)
        job = replace(job, arguments=("--seed=2",))

    def run(of: Job, arguments: tuple[str, ...], *_: object) -> ProcessResult:
        of.output.write_text("result")
        return ProcessResult(code=-9)

    children.run = run  # type: ignore[method-assign]
    assert done(job).state is State.FAILED
    assert planned_action(job, Limits()) == "keep"
    assert done(job).state is State.KEPT
