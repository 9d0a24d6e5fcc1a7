"""The rule of all readers: what no adapter declares is one line about the file; its cause can be found."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import (
    EXIT_FAILED,
    PosetrackError,
    RecordingError,
    UsageError,
    damage_reported,
    read_from,
)
from posetrack_cli.recording import opening
from posetrack_cli.recording.conversion import convert_recording
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.opening import open_recording
from support.bags import write_bag


def items() -> Iterator[int]:
    yield from (1, 2)
    raise KeyError(b"conn")


def test_the_line_has_the_place_and_the_cause() -> None:
    seen = []
    with pytest.raises(RecordingError) as caught:
        for one in read_from(Path("r.bag"), items(), "frame"):
            seen.append(one)
    assert seen == [1, 2]
    line = str(caught.value)
    assert line.startswith(
        "r.bag, after frame 2: is damaged here, found KeyError: b'conn' at posetrack_cli/errors.py:"
    )
    assert isinstance(caught.value.__cause__, KeyError)


@pytest.mark.parametrize(
    "error",
    [UsageError("x"), RecordingError("x"), FileNotFoundError("x"), MemoryError(), KeyboardInterrupt()],
)
def test_errors_that_are_declared_and_interruptions_pass(error: BaseException) -> None:
    with pytest.raises(type(error)) as caught, damage_reported(lambda: "r.bag"):
        raise error
    assert caught.value is error


def test_an_error_of_whoever_uses_the_items_is_none_of_the_file() -> None:
    with pytest.raises(ValueError, match="mine"):
        for _ in read_from(Path("r.bag"), items(), "frame"):
            raise ValueError("mine")


def test_every_way_to_read_a_recording_is_within_the_rule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Opening, describing, frames and truth; a traceback shows where it happened if it is asked for."""
    path = write_bag(tmp_path / "r.bag")

    def broken(*_: object) -> object:
        raise ZeroDivisionError("deep")

    recording = open_recording(path)
    with monkeypatch.context() as patched:
        patched.setattr(Depth, "from_message", broken)
        with pytest.raises(
            RecordingError, match=r"r\.bag: is damaged here, found ZeroDivisionError: deep at"
        ):
            next(recording.frames())
        with pytest.raises(
            RecordingError, match=r"r\.bag: is damaged here, found ZeroDivisionError: deep at"
        ):
            convert_recording(recording, tmp_path / "out.mcap")
    recording = open_recording(path)
    monkeypatch.setattr("posetrack_cli.bags.ros1_bag._Reading.record", broken)
    for read in (open_recording, opening.describe):
        with pytest.raises(PosetrackError, match="is damaged here"):
            read(path)
    with pytest.raises(PosetrackError, match="is damaged here"):
        next(iter(recording.frames()))
    assert run(["info", str(path)]) == EXIT_FAILED
    assert capfd.readouterr().err.count("\n") == 1
    monkeypatch.setenv("POSETRACK_DEBUG", "1")
    assert run(["info", str(path)]) == EXIT_FAILED
    said = capfd.readouterr().err
    assert "ZeroDivisionError: deep" in said and 'ros1_bag.py", line' in said
