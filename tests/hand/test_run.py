"""A run over a recording in memory: what it states and carries over, how it stops and goes on."""

from __future__ import annotations

import filecmp
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.build import build_record
from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import HandRun, RunOptions, run_record
from posetrack_cli.losses import Loss
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results import Estimate, load_arrays, read_result
from posetrack_cli.tracking.options import RunOutcome, frames_ahead
from support.flat_recording import CAMERA, CONFIG, FRAME_NS, Memory, after


def truth_at(stamp_ns: int, data: bytes = b"{}") -> TruthMessage:
    return TruthMessage("/truth/hand/pose", "custom", "jsonschema", b"{}", "json", stamp_ns, data)


def truths(path: Path) -> list[tuple[int, bytes]]:
    """Stamps and contents of the truth in a result, in file order."""
    messages = McapFile(path).messages(["/truth/hand/pose"])
    return [(message.log_time, message.data) for _, _, message in messages]


@pytest.fixture
def track(device: RenderingDevice, tmp_path: Path) -> Callable[..., RunOutcome]:
    def run(
        recording: Memory,
        name: str = "r.mcap",
        config: HandConfig = CONFIG,
        stopped: Callable[[], bool] = lambda: False,
        report: Callable[[Estimate], None] = lambda estimate: None,
        **options: Any,
    ) -> RunOutcome:
        return HandRun(recording, config, RunOptions(tmp_path / name, **options), device).track(
            report, stopped
        )

    return run


# The run record


def record_of(**options: Any) -> dict[str, str]:
    return run_record(Memory(), CAMERA, CONFIG, RunOptions(Path("/tmp/out/r.mcap"), **options), "a renderer")


def test_the_record_gives_the_configuration_back() -> None:
    resolved = HandConfig.model_validate(json.loads(record_of()["configuration"]))
    assert resolved == CONFIG
    assert HandConfig.model_validate(json.loads(record_of()["configuration"])) != HandConfig()


def test_the_record_states_camera_renderer_version_input_and_options() -> None:
    record = record_of(seed=7, start=2, end=9, stride=3, timings=True)
    camera = json.loads(record["camera"])
    assert Camera(**camera | {"distortion": tuple(camera["distortion"])}) == CAMERA
    expected = {
        "tracker": "hand",
        **build_record(),
        "renderer": "a renderer",
        "seed": "7",
        "init": "center",
        "start": "2",
        "end": "9",
        "stride": "3",
        "timings": "true",
        "input.name": "memory.mcap",
        "input.path": "/somewhere/secret/memory.mcap",
        "input.sha256": "0" * 64,
    }
    assert {key: record[key] for key in expected} == expected
    assert set(record) - set(expected) == {"configuration", "camera"}
    assert record_of()["end"] == ""


def test_the_record_knows_no_clock_no_folder_and_no_output() -> None:
    first = record_of(init="/home/someone/pose.toml")
    time.sleep(0.002)
    second = run_record(
        Memory(), CAMERA, CONFIG, RunOptions(Path("x.mcap"), init="pose.toml", overwrite=True), "a renderer"
    )
    assert first == second
    assert not [key for key, value in first.items() if "/" in value and key != "input.path"]


def test_a_start_pose_from_a_file_is_in_the_record(track: Callable[..., RunOutcome], tmp_path: Path) -> None:
    (tmp_path / "pose.toml").write_text("position_mm = [1, 2, 650]")
    track(Memory(2), init=str(tmp_path / "pose.toml"))
    record = read_result(tmp_path / "r.mcap").run
    assert json.loads(record["init.pose"]) == [1.0, 2.0, 650.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 15]
    assert record["init"] == "pose.toml"
    assert "init.pose" not in record_of()


def test_a_record_lists_deviations_from_print_where_a_run_follows_the_paper() -> None:
    options = {"init.method": "auto", "filter.gain": "corrected"}
    config = load_settings(HandConfig, find_configuration("hand-paper"), options)
    record = run_record(Memory(), CAMERA, config, RunOptions(Path("r.mcap")), "a renderer")
    listed = json.loads(record["deviations_from_print"])
    assert listed[:2] == [
        "(56): filter.gain is 'corrected', not 'printed'",
        "7.3: init.method is 'auto', not 'center'",
    ]
    assert listed[2] == "A.1: the thumb turns about z at joint 3 (CMC), not at joint 2"
    assert "deviations_from_print" not in record_of()


# Truth and losses


def test_truth_is_carried_in_order_up_to_the_stamps_that_are_tracked(
    track: Callable[..., RunOutcome], tmp_path: Path
) -> None:
    stamps = [0, FRAME_NS, FRAME_NS, 2 * FRAME_NS, 3 * FRAME_NS, 3 * FRAME_NS + 1, 20 * FRAME_NS]
    messages = tuple(truth_at(stamp, b'{"i":%d}' % k) for k, stamp in enumerate(stamps))
    track(Memory(12, true=messages), end=4)
    # frame 3 is the last: its own truth comes along, what is a nanosecond later does not
    assert truths(tmp_path / "r.mcap") == [(m.log_time_ns, m.data) for m in messages[:5]]


def test_truth_before_a_later_start_and_between_strides_comes_along(
    track: Callable[..., RunOutcome], tmp_path: Path
) -> None:
    messages = tuple(truth_at(k * FRAME_NS) for k in range(12))
    track(Memory(12, true=messages), start=2, end=8, stride=4)  # frames 2 and 6
    assert [stamp for stamp, _ in truths(tmp_path / "r.mcap")] == [k * FRAME_NS for k in range(7)]


def test_the_recording_s_losses_and_blank_frames_are_told_together(
    track: Callable[..., RunOutcome], tmp_path: Path
) -> None:
    unreadable = Loss("images that cannot be read", 2, "000004.png")
    outcome = track(Memory(6, blank=(2, 3), losses=(unreadable,)))
    assert outcome.losses == (unreadable, Loss("frames without any reading", 2, "frame 2"))
    assert outcome.lost == 6  # 4 frames of a wall, and 2 without a reading
    assert read_result(tmp_path / "r.mcap").summary["losses"] == (
        "images that cannot be read: 2, first 000004.png; frames without any reading: 2, first frame 2"
    )


def test_nothing_lost_is_not_mentioned(track: Callable[..., RunOutcome], tmp_path: Path) -> None:
    assert track(Memory(3)).losses == ()
    assert "losses" not in read_result(tmp_path / "r.mcap").summary


# Stopping and going on


def test_the_stop_flag_ends_the_run_after_the_frame(track: Callable[..., RunOutcome], tmp_path: Path) -> None:
    reported: list[int] = []
    outcome = track(Memory(), stopped=after(5), report=lambda estimate: reported.append(estimate.frame_index))
    assert (outcome.stopped, outcome.tracked, outcome.frames) == (True, 5, 5)
    assert reported == [0, 1, 2, 3, 4]
    assert not (tmp_path / "r.mcap").exists()
    assert len(list(read_result(part_path(tmp_path / "r.mcap")).estimates())) == 5


@pytest.mark.parametrize(("kind", "frames"), [("rbpf", 1), ("pf", 3), ("rbpf", 6)])
def test_a_strided_run_resumes_to_the_same_bytes(
    track: Callable[..., RunOutcome], tmp_path: Path, kind: str, frames: int
) -> None:
    # flushed every 2 frames; blank frames on both sides of every interruption, longer than the longest gap
    config = HandConfig.model_validate(
        CONFIG.model_dump() | {"filter": {"kind": kind, "particles": 6}, "motion": {"gap_max_s": 0.25}}
    )
    recording = Memory(24, tuple(range(7, 19)), tuple(truth_at(k * FRAME_NS) for k in range(24)))
    chosen = {"config": config, "start": 1, "end": 23, "stride": 3}
    whole = track(recording, "whole.mcap", **chosen)
    assert track(recording, stopped=after(frames), **chosen).stopped
    resumed = track(recording, resume=True, **chosen)
    assert filecmp.cmp(tmp_path / "r.mcap", tmp_path / "whole.mcap", shallow=False)
    flushed = frames // 2 * 2
    assert (whole.tracked, resumed.tracked, resumed.frames) == (8, 8 - flushed, 8)
    assert (resumed.lost, resumed.losses) == (whole.lost, whole.losses)
    assert load_arrays(tmp_path / "r.mcap")["frame_index"].tolist() == list(range(1, 23, 3))


# Which frames


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, 12),
        ({"start": 4}, 8),
        ({"end": 5}, 5),
        ({"end": 50}, 12),
        ({"start": 1, "end": 12, "stride": 3}, 4),
        ({"start": 12}, 0),
        ({"start": 5, "end": 5}, 0),
    ],
)
def test_frames_ahead_are_those_that_are_read(options: dict[str, int], expected: int) -> None:
    recording = Memory(12)
    assert frames_ahead(recording, RunOptions(Path("r.mcap"), **options)) == expected
    assert len(list(recording.frames(**options))) == expected
    assert frames_ahead(replace(recording, known=False), RunOptions(Path("r.mcap"), **options)) is None


@pytest.mark.parametrize(("known", "found"), [(True, "12 frames"), (False, "no readable frames")])
def test_no_frame_in_the_range_is_refused(
    track: Callable[..., RunOutcome], known: bool, found: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=f"no frames to track, found {found}.*--start"):
        track(Memory(12, known=known), start=12)
    assert not list(tmp_path.iterdir())  # also where it shows only in reading


def test_frames_none_of_which_can_be_used_are_told_and_leave_no_file(
    track: Callable[..., RunOutcome], tmp_path: Path
) -> None:
    with pytest.raises(RecordingError, match=r"no readable frames, found stamp gone: 9, first frame 0"):
        track(Memory(0, known=False, losses=(Loss("stamp gone", 9, "frame 0"),)))
    assert not list(tmp_path.iterdir())


def test_a_run_is_remarked_on_whose_frames_are_mostly_doubtful(
    device: RenderingDevice, tmp_path: Path
) -> None:
    """Half of them are not most, and of no frames none are."""
    run = HandRun(Memory(), CONFIG, RunOptions(tmp_path / "r.mcap"), device)
    rng = np.random.default_rng(0)
    pose = np.eye(1, 22, 6)[0]
    state = run.tracker.start(pose, 0, rng)
    assert run.remarks(state) == ()
    assert run.remarks(replace(state, frames=10, doubtful=5)) == ()
    (line,) = run.remarks(replace(state, frames=10, doubtful=6))
    assert line.startswith("6 of 10 frames are probably wrong") and "--hand-side" in line
