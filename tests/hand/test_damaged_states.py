"""States of hand trackers that no tracker made, and runs resumed from them: one line, nothing is lost."""

from __future__ import annotations

import filecmp
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, ResultError
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.npz import read_npz
from posetrack_cli.outputs import part_path, state_path
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.columns import LayoutError
from posetrack_cli.tracking.smoothing import smoothing_path
from support.damage import damaged_arrays, sealed, wild_numbers
from support.flat_recording import CONFIG, Memory, after

KINDS = ("rbpf", "pf", "pso")


def config_of(kind: str) -> HandConfig:
    changes: dict[str, Any] = {
        "filter": CONFIG.filter.model_copy(update={"kind": kind}),
        "pso": CONFIG.pso.model_copy(update={"particles": 8, "generations": 2}),
    }
    return CONFIG.model_copy(update=changes)


@pytest.fixture
def run(device: RenderingDevice, tmp_path: Path) -> Callable[..., HandRun]:
    def make(kind: str, name: str = "r.mcap", **options: Any) -> HandRun:
        return HandRun(Memory(), config_of(kind), RunOptions(tmp_path / name, **options), device)

    return make


def nothing(*_: object) -> None:
    """A report that nobody reads."""


# States


@pytest.mark.parametrize("kind", KINDS)
def test_every_part_of_a_state_is_needed_and_of_its_kind(run: Callable[..., HandRun], kind: str) -> None:
    tracker, frames = run(kind).tracker, list(Memory().frames())
    rng = np.random.default_rng(0)
    state = tracker.start(np.eye(1, 22, 6)[0] + np.eye(1, 22, 2)[0] * 650.0, 0, rng)
    state, _ = tracker.step(state, frames[1], rng)
    arrays = tracker.codec.to_arrays(state)

    def taken(damaged: dict[str, Any]) -> bool:
        """Whether a state is made of this; then one frame goes through, or says in one line why not."""
        try:
            made = tracker.codec.from_arrays(damaged)
        except LayoutError:
            return False
        try:
            tracker.step(made, frames[2], np.random.default_rng(0))
        except PosetrackError as error:
            assert "\n" not in str(error)
        return True

    assert taken(arrays)
    swapped = {what for what, damaged in damaged_arrays(arrays) if taken(damaged)}
    assert all(" and " in what for what in swapped)
    wild = {what for what, damaged in wild_numbers(arrays) if taken(damaged)}
    assert wild <= {"particles.log_weights with -inf", "stamp_ns of -1"}


# Runs


@pytest.fixture
def interrupted(run: Callable[..., HandRun], tmp_path: Path) -> Callable[..., dict[str, bytes]]:
    """Stops a run after a checkpoint and returns the files that it leaves."""

    def stop(kind: str, **options: Any) -> dict[str, bytes]:
        run(kind, **options).track(nothing, after(5))
        return files(tmp_path)

    return stop


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def refusal(run: HandRun, folder: Path) -> str:
    """The line of a run that cannot be resumed, after checking that it left everything as it was."""
    before = files(folder)
    with pytest.raises(ResultError) as caught:
        run.track(nothing)
    left = files(folder)
    assert {name: data for name, data in left.items() if not name.endswith(".part")} == {
        name: data for name, data in before.items() if not name.endswith(".part")
    }
    assert left.keys() == before.keys()
    return str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_a_state_without_its_stamp_is_refused_and_nothing_is_deleted(
    run: Callable[..., HandRun], interrupted: Callable[..., dict[str, bytes]], tmp_path: Path, kind: str
) -> None:
    interrupted(kind)
    whole, part = state_path(tmp_path / "r.mcap"), part_path(tmp_path / "r.mcap")
    contents, flushed = read_npz(whole.read_bytes()), part.read_bytes()
    good = whole.read_bytes()
    whole.write_bytes(sealed({name: array for name, array in contents.items() if name != "array.stamp_ns"}))
    line = refusal(run(kind, resume=True), tmp_path)
    assert "array 'stamp_ns' is missing; start again with --overwrite" in line
    whole.write_bytes(sealed(contents | {"array.pose": contents["array.pose"][:-1]}))
    assert "'pose' is float64 (21,), expected float64 (22)" in refusal(run(kind, resume=True), tmp_path)
    assert part.read_bytes() == flushed
    whole.write_bytes(good)
    run(kind, resume=True).track(nothing)
    run(kind, "whole.mcap").track(nothing)
    assert filecmp.cmp(tmp_path / "r.mcap", tmp_path / "whole.mcap", shallow=False)


@pytest.mark.parametrize("kind", ["rbpf", "pf"])
def test_what_is_smoothed_has_to_be_what_was_remembered(
    run: Callable[..., HandRun],
    interrupted: Callable[..., dict[str, bytes]],
    tmp_path: Path,
    kind: str,
) -> None:
    """Flipped, truncated, exchanged and hostile files of frames are one line; the untouched one goes on."""
    interrupted(kind, smooth=True)
    spool = smoothing_path(tmp_path / "r.mcap")
    data = spool.read_bytes()
    head, records = data[: data.index(b"\n") + 1], data[data.index(b"\n") + 1 :]
    size = len(records) // 6  # of the frame whose pose the last velocity rests on, too
    assert len(records) == 6 * size
    first, second = records[:size], records[size : 2 * size]
    hostile = (
        b"",
        data[: len(data) // 3],
        head + second + first + records[2 * size :],
        head + first[:-1] + bytes([first[-1] ^ 1]) + records[size:],
        head + first[:9] + bytes([first[9] ^ 1]) + first[10:] + records[size:],
        head.replace(b"<f8", b"<f4") + records,
        head.replace(b"22]", b"999999999]") + records,
        head.replace(b"<f8", b"|O") + records,
        b"[" * 100_000 + b"\n" + records,
        b"x" * len(data),
    )
    for damaged in hostile:
        spool.write_bytes(damaged)
        line = refusal(run(kind, smooth=True, resume=True), tmp_path)
        assert str(spool) in line and "start again with --overwrite" in line
    spool.write_bytes(data)
    run(kind, smooth=True, resume=True).track(nothing)
    run(kind, "whole.mcap", smooth=True).track(nothing)
    assert filecmp.cmp(tmp_path / "r.mcap", tmp_path / "whole.mcap", shallow=False)
