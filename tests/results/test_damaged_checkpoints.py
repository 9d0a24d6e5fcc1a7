"""Checkpoints that no run saved: one line, and not a byte of what was interrupted is touched."""

from __future__ import annotations

import os
from collections.abc import Callable
from operator import itemgetter
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, ResultError
from posetrack_cli.npz import read_npz
from posetrack_cli.outputs import part_path, state_path
from posetrack_cli.results import ResultWriter, spool
from posetrack_cli.results.columns import floats
from posetrack_cli.results.spool import FORMAT_VERSION, Checkpoint, Progress
from posetrack_cli.tracking.loop import RunState, Tracker, checkpoint_of, run_state_at
from posetrack_cli.tracking.state_codec import Fields, Value, stamp, whole
from support.damage import Arrays, changed_json, damaged_arrays, damaged_fields, sealed
from support.results import CAMERA, RUN, SUBJECT, begin, make_estimate, make_truth

HINT = "--overwrite"
FLUSHED, WRITTEN = 10, 13


class Walking:
    """A tracker whose state is where it is, how often it went, and when."""

    codec = Fields(
        lambda place, steps, stamp_ns: (place, steps, stamp_ns),
        place=(itemgetter(0), Value(floats(3))),
        steps=(itemgetter(1), whole()),
        stamp_ns=(itemgetter(2), stamp()),
    )


TRACKER = cast(Tracker[Any], Walking())


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def interrupted(folder: Path) -> Path:
    """A run that was killed some frames after its checkpoint."""
    generator = rng()
    with begin(folder / "r.mcap") as writer:
        for index in range(WRITTEN):
            if index % 2 == 0:
                writer.add_truth(make_truth(index))
            step = generator.standard_normal(3)
            if writer.write(make_estimate(index)):
                reached = RunState((step, index + 1, 10**18 + index), generator, index)
                writer.save_checkpoint(checkpoint_of(TRACKER, reached, writer.frames_written))
    return folder / "r.mcap"


def resume(path: Path) -> RunState:
    """Go on as a run does, and stop at once."""
    reached: list[RunState] = []
    writer, _ = ResultWriter.resume(
        path, SUBJECT, CAMERA, RUN, check=lambda found: reached.append(run_state_at(TRACKER, found, rng()))
    )
    writer.abort()
    return reached[0]


def contents_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def refused(path: Path, data: bytes) -> str:
    """The line of resuming from a state, after checking that nothing but the state was changed."""
    state_path(path).write_bytes(data)
    before = contents_of(path.parent)
    with pytest.raises(PosetrackError) as caught:
        resume(path)
    assert contents_of(path.parent) == before
    line = str(caught.value)
    assert line.startswith(str(path)) and "\n" not in line
    return line


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return interrupted(tmp_path)


def test_the_state_itself_is_taken(path: Path) -> None:
    (place, steps, stamp), generator, index, _ = resume(path)
    expected = rng()
    for _ in range(FLUSHED):
        last = expected.standard_normal(3)
    np.testing.assert_array_equal(place, last)
    assert (steps, stamp, index) == (FLUSHED, 10**18 + FLUSHED - 1, FLUSHED - 1)
    assert generator.random() == expected.random()


def test_every_field_is_needed_and_of_its_kind_and_range(path: Path) -> None:
    """Also where the digest is right: it is not what is found wrong."""
    data = state_path(path).read_bytes()
    for what, damaged in damaged_fields(data):
        line = refused(path, damaged)
        assert HINT in line and "digest" not in line, what


def test_every_array_is_needed_and_of_its_kind_and_shape(path: Path) -> None:
    contents = read_npz(state_path(path).read_bytes())
    for what, damaged in damaged_arrays(contents):
        if "array." in what.split(" and ")[0]:  # JSON and digest are taken as bytes, whatever their shape
            assert HINT in refused(path, sealed(damaged)), what


@pytest.mark.parametrize(
    "change",
    [
        lambda contents: contents | {"array.place": contents["array.place"] + 1e-12},
        lambda contents: contents | {"array.more": np.zeros(3)},
        lambda contents: contents | {"json": with_another_count(contents)},
        lambda contents: {name: array for name, array in contents.items() if name != "digest"},
        lambda contents: contents | {"digest": contents["digest"][:31]},
    ],
    ids=["values", "another array", "JSON", "no digest", "short digest"],
)
def test_a_state_that_was_altered_is_refused(path: Path, change: Callable[[Arrays], Arrays]) -> None:
    """However well-formed: it would go on to another result."""
    changed = change(read_npz(state_path(path).read_bytes()))
    with state_path(path).open("wb") as stream:
        np.savez(stream, **changed)  # type: ignore[arg-type]
    line = refused(path, state_path(path).read_bytes())
    assert "checkpoint cannot be read" in line and "digest" in line and HINT in line


def with_another_count(contents: Arrays) -> np.ndarray[Any, Any]:
    return np.frombuffer(
        contents["json"].tobytes().replace(b'"frames_written": 10', b'"frames_written": 11'), np.uint8
    )


@pytest.mark.parametrize("share", np.linspace(0.0, 0.99, 12))
def test_a_truncated_state_is_refused(path: Path, share: float) -> None:
    data = state_path(path).read_bytes()
    assert HINT in refused(path, data[: int(share * len(data))])


def test_flipped_bits_are_refused_or_change_nothing(path: Path) -> None:
    data, flips = state_path(path).read_bytes(), np.random.default_rng(0)
    expected = str(resume(path))
    for _ in range(150):
        damaged = bytearray(data)
        damaged[flips.integers(len(data))] ^= 1 << int(flips.integers(8))
        state_path(path).write_bytes(damaged)
        try:
            found = str(resume(path))
        except PosetrackError as error:
            assert HINT in str(error) and "\n" not in str(error)
        else:
            assert found.partition("Generator")[0] == expected.partition("Generator")[0]


@pytest.mark.parametrize("version", [FORMAT_VERSION - 1, FORMAT_VERSION + 1])
def test_another_version_is_told(path: Path, version: int) -> None:
    contents = read_npz(state_path(path).read_bytes())
    line = refused(path, changed_json(contents, lambda fields: fields.update(version=version)))
    assert f"'version' is {version}, expected {FORMAT_VERSION}; start again" in line and HINT in line


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda fields: fields["progress"].update(truth_messages=3), "10 estimates and 5 truth messages"),
        (
            lambda fields: fields["progress"].update(truth_messages=10**15),
            "and 5 truth messages in the result",
        ),
        (lambda fields: fields["checkpoint"].update(frames_written=11), "11 estimates up to frame 9"),
        (lambda fields: fields["checkpoint"].update(frame_index=-1), "10 estimates up to frame -1"),
        (
            lambda fields: fields["progress"].update(file_bytes=0),
            "0 estimates and 0 truth messages in the result",
        ),
        (lambda fields: fields["progress"].update(file_bytes=10**15), "does not match the unfinished result"),
        (lambda fields: fields["progress"].update(flush_frames=5), "has another flush interval"),
    ],
)
def test_a_state_has_to_agree_with_the_result(path: Path, change: Callable[[Any], Any], match: str) -> None:
    line = refused(path, changed_json(read_npz(state_path(path).read_bytes()), change))
    assert match in line and HINT in line


def test_a_state_of_deep_json_is_refused(path: Path) -> None:
    text = b"[" * 300_000
    assert HINT in refused(path, sealed({"json": np.frombuffer(text, np.uint8)}))


def test_only_a_regular_file_is_a_state(path: Path) -> None:
    state_path(path).unlink()
    os.mkfifo(state_path(path))
    part = part_path(path).read_bytes()
    with pytest.raises(ResultError, match="checkpoint cannot be read, found a named pipe"):
        resume(path)
    assert part_path(path).read_bytes() == part


def test_no_link_is_written_through(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_text("precious")
    (tmp_path / "state.tmp").symlink_to(other)
    with pytest.raises(ResultError, match=r"state\.tmp: cannot be written, found a symbolic link"):
        spool.save(tmp_path / "state", Checkpoint(-1, 0), Progress(0, 1, 0, {}))
    assert other.read_text() == "precious"


def test_what_cannot_be_used_by_the_tracker_is_told_of_the_state(path: Path) -> None:
    contents = read_npz(state_path(path).read_bytes())
    line = refused(path, sealed(contents | {"array.place": np.full(3, np.nan)}))
    assert line == (
        f"{state_path(path)}: checkpoint cannot be used, found 'place' has values that are not finite; "
        f"{spool.RESTART_HINT}"
    )
