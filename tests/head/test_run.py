"""Head runs over a recording in memory: passes, models, what is written, stopping and going on."""

from __future__ import annotations

import filecmp
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.head.config import HeadStereoConfig, RunSettings
from posetrack_cli.head.model_file import load_model, model_bytes
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.subject import head_subject
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import Estimate, load_arrays, read_result
from posetrack_cli.results.export.export import csv_text
from posetrack_cli.results.export.source import export_source
from posetrack_cli.tracking.options import RunOutcome
from posetrack_cli.tracking.two_pass import NothingFoundError
from support.head_run import ASIDE, CAMERAS, COMPONENTS, FRAME_NS, OF_THIS_RECORDING, FakeTracker, Memory
from support.hostile_files import write_hand_result

Track = Callable[..., RunOutcome]
NAME = "head-stereo"


def ignored(estimate: Estimate) -> None:
    """A report that nobody reads."""


def after(frames: int) -> Callable[[], bool]:
    """A stop flag that is up once it has been asked so often."""
    asked = iter(range(1, 1000))
    return lambda: next(asked) >= frames


@pytest.fixture
def track(tmp_path: Path) -> Track:
    def run(
        recording: Memory,
        name: str = "r.mcap",
        stopped: Callable[[], bool] = lambda: False,
        report: Callable[[Estimate], None] = ignored,
        first_pass: Callable[[Estimate], None] = ignored,
        passes: int = 1,
        **options: Any,
    ) -> RunOutcome:
        chosen = HeadRunOptions(tmp_path / name, **options)
        return HeadRun(
            recording,
            HeadStereoConfig(run=RunSettings(passes=passes)),
            chosen,
            name=NAME,
            subject=head_subject(recording.cameras[0].name, COMPONENTS),
            flush_frames=3,
            make_tracker=FakeTracker,
            first_pass=first_pass,
        ).track(report, stopped)

    return run


def columns_but(path: Path, *left_out: str) -> dict[str, np.ndarray]:
    return {name: values for name, values in load_arrays(path).items() if name not in left_out}


def assert_same_estimates(path: Path, other: Path) -> None:
    mine, theirs = load_arrays(path), load_arrays(other)
    assert mine.keys() == theirs.keys()
    for name in mine:
        np.testing.assert_array_equal(mine[name], theirs[name], err_msg=name)


# What is written


def test_a_result_holds_cameras_numbers_and_what_was_learned(track: Track, tmp_path: Path) -> None:
    outcome = track(Memory())
    result = read_result(tmp_path / "r.mcap")
    assert (outcome.frames, outcome.tracked, outcome.lost) == (12, 12, 2)
    assert result.cameras() == CAMERAS  # exact, extrinsics too
    assert result.camera() == CAMERAS[0]
    assert result.subject.number_names[0] == "eigenvalue_1_mm2"
    numbers = result.numbers()
    assert tuple(numbers) == result.subject.number_names
    assert numbers["eigenvalue_1_mm2"].tolist() == [4.0] * 12
    assert np.isnan(numbers["eigenvalue_2_mm2"]).all()  # not learnt yet
    assert np.isnan(numbers["contribution_ratio"][:3]).all()
    assert numbers["contribution_ratio"][3:].tolist() == [0.5] * 9
    assert numbers["learnt_frames"].tolist() == [0, 0, *range(1, 11)]
    assert load_model(result.path, CAMERAS, NAME)["counts"] == [10]


def test_topics_of_two_cameras_and_of_one(track: Track, tmp_path: Path) -> None:
    track(Memory(), "two.mcap")
    track(Memory(cameras=CAMERAS[:1]), "one.mcap")
    two = [channel.topic for _, channel in read_result(tmp_path / "two.mcap").channels]
    one = [channel.topic for _, channel in read_result(tmp_path / "one.mcap").channels]
    head = ["/head/estimate", "/head/odometry", "/head/scene", "/tf"]
    each = [f"/camera/{name}/{what}" for name in ("left", "right") for what in ("annotations", "calibration")]
    assert two == [*each, *head, "/tf_static"]
    assert one == ["/camera/annotations", "/camera/calibration", *head]
    assert read_result(tmp_path / "one.mcap").cameras() == CAMERAS[:1]


def test_the_record_states_passes_files_and_only_the_recording_s_folder(track: Track, tmp_path: Path) -> None:
    track(Memory(), "first.mcap", save_model=tmp_path / "face.npz")
    track(Memory(), load_model=tmp_path / "face.npz", seed=7, stride=2)
    record = read_result(tmp_path / "r.mcap").run
    expected = {"tracker": "head-stereo", "seed": "7", "stride": "2", "passes": "1", "init": "auto"}
    assert {key: record[key] for key in expected} == expected
    assert record["load_model"] == "face.npz"
    assert len(record["load_model.sha256"]) == 64
    assert HeadStereoConfig.model_validate(json.loads(record["configuration"])) == HeadStereoConfig()
    assert not [key for key, value in record.items() if "/" in value and key != "input.path"]


def test_what_the_tracker_remarks_is_told_and_kept(track: Track, tmp_path: Path) -> None:
    assert track(Memory(), stopped=after(5)).remarks == ()  # not finished yet
    assert track(Memory(), resume=True).remarks == ("face seen in 10 frames",)
    assert read_result(tmp_path / "r.mcap").summary["remarks"] == "face seen in 10 frames"


def test_what_is_stated_besides_is_in_the_record(tmp_path: Path) -> None:
    HeadRun(
        Memory(),
        HeadStereoConfig(),
        HeadRunOptions(tmp_path / "r.mcap"),
        name=NAME,
        subject=head_subject(CAMERAS[0].name, COMPONENTS),
        flush_frames=3,
        make_tracker=FakeTracker,
        extra_record={"scale": "prior"},
    ).track(ignored)
    assert read_result(tmp_path / "r.mcap").run["scale"] == "prior"


def test_truth_is_carried_over(track: Track, tmp_path: Path) -> None:
    true = TruthMessage("/truth/head/pose", "custom", "jsonschema", b"{}", "json", 3 * FRAME_NS, b"{}")
    track(Memory(true=(true,)))
    assert list(read_result(tmp_path / "r.mcap").truth()) == [true]


def test_an_exported_table_has_the_numbers(track: Track, tmp_path: Path) -> None:
    track(Memory())
    text = "".join(csv_text(export_source(read_result(tmp_path / "r.mcap"))))
    header, first, *_ = [line for line in text.splitlines() if not line.startswith("#")]
    row = dict(zip(header.split(","), first.split(","), strict=True))
    assert (row["eigenvalue_1_mm2"], row["eigenvalue_2_mm2"], row["learnt_frames"]) == ("4.0", "", "0.0")
    assert row["deformation_1"] == "0.0"


def test_the_other_camera_stands_where_its_transform_says(track: Track, tmp_path: Path) -> None:
    track(Memory())
    messages = McapFile(tmp_path / "r.mcap").messages(["/tf_static"])
    ((_, _, message),) = messages
    (placed,) = FrameTransforms.FromString(message.data).transforms
    assert (placed.parent_frame_id, placed.child_frame_id) == ("left", "right")
    # ASIDE turns nothing, so the camera's centre is minus its translation
    centre = [placed.translation.x, placed.translation.y, placed.translation.z]
    np.testing.assert_allclose(centre, [0.120, 0.0, -0.005], atol=1e-15)
    assert placed.rotation.w == 1.0


# Passes and models


def test_the_second_pass_begins_with_what_the_first_learned(track: Track, tmp_path: Path) -> None:
    first: list[int] = []
    outcome = track(
        Memory(), "twice.mcap", passes=2, first_pass=lambda estimate: first.append(estimate.frame_index)
    )
    track(Memory(), "once.mcap", save_model=tmp_path / "face.npz")
    track(Memory(), "again.mcap", load_model=tmp_path / "face.npz")
    assert first == list(range(12))
    assert (outcome.frames, outcome.tracked) == (12, 24)
    assert_same_estimates(tmp_path / "twice.mcap", tmp_path / "again.mcap")
    once, twice = (load_arrays(tmp_path / name)["points"] for name in ("once.mcap", "twice.mcap"))
    assert np.abs(twice[2] - once[2]).max() > 0.9  # ten frames' worth of mean
    assert read_result(tmp_path / "twice.mcap").summary["passes"] == "2"
    assert load_model(tmp_path / "twice.mcap", CAMERAS, NAME)["mean"][0, 0] == pytest.approx(
        2 * 1.065, abs=0.02
    )


def test_what_holds_for_one_recording_alone_is_told_its_second_pass_and_no_model(
    track: Track, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, begun = FakeTracker.start, []

    def started(tracker: FakeTracker, *frame: Any) -> Any:
        begun.append(tracker.known)
        return start(tracker, *frame)

    monkeypatch.setattr(FakeTracker, "start", started)
    track(Memory(), "twice.mcap", passes=2, save_model=tmp_path / "face.npz")
    first, second = begun
    assert first is None and second is not None and OF_THIS_RECORDING in second
    for name in ("twice.mcap", "face.npz"):
        assert set(load_model(tmp_path / name, CAMERAS, NAME)) == set(second) - {OF_THIS_RECORDING}


def test_a_result_serves_as_a_model(track: Track, tmp_path: Path) -> None:
    track(Memory(), "once.mcap", save_model=tmp_path / "face.npz")
    track(Memory(), "a.mcap", load_model=tmp_path / "once.mcap")
    track(Memory(), "b.mcap", load_model=tmp_path / "face.npz")
    assert_same_estimates(tmp_path / "a.mcap", tmp_path / "b.mcap")


def test_two_runs_write_the_same_bytes(track: Track, tmp_path: Path) -> None:
    for name in ("a", "b"):
        track(Memory(), f"{name}.mcap", passes=2, save_model=tmp_path / f"{name}.npz")
    assert filecmp.cmp(tmp_path / "a.mcap", tmp_path / "b.mcap", shallow=False)
    assert filecmp.cmp(tmp_path / "a.npz", tmp_path / "b.npz", shallow=False)


@pytest.mark.parametrize("frames", [1, 5, 12, 13, 17, 23, 24])
def test_a_run_in_two_passes_resumes_to_the_same_bytes(track: Track, tmp_path: Path, frames: int) -> None:
    recording = Memory(13, appears=4)
    track(recording, "whole.mcap", passes=2)
    assert track(recording, passes=2, stopped=after(frames)).stopped
    outcome = track(recording, passes=2, resume=True)
    assert filecmp.cmp(tmp_path / "r.mcap", tmp_path / "whole.mcap", shallow=False)
    assert outcome.tracked <= 26 - frames + 3  # at most what was not flushed is tracked again
    assert outcome.frames == 13


# What is refused


def test_no_face_is_told_and_leaves_nothing(track: Track, tmp_path: Path) -> None:
    for passes in (1, 2):
        with pytest.raises(
            NothingFoundError, match=r"no face found, found 12 frames searched, best score 0\.31"
        ):
            track(Memory(appears=99), passes=passes)
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("passes", [1, 2])
def test_what_is_resumed_is_never_deleted(track: Track, tmp_path: Path, passes: int) -> None:
    """Not even where no face is found in the end: what was interrupted may have cost hours."""
    track(Memory(appears=99), passes=passes, stopped=after(7))
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.suffix == ".state"}
    for _ in range(2):
        with pytest.raises(NothingFoundError, match="no face found"):
            track(Memory(appears=99), passes=passes, resume=True)
        names = {path.name for path in tmp_path.iterdir()}
        assert names == {"r.mcap.part", "r.mcap.part.state"} and names > kept.keys()


@pytest.mark.parametrize("name", ["r.mcap", "r.mcap.part", "r.mcap.part.state"])
def test_a_model_is_not_written_over_the_result(track: Track, tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="result and model must be different files"):
        track(Memory(), save_model=tmp_path / name, overwrite=True)
    assert not list(tmp_path.iterdir())


def test_a_model_is_not_written_over_another_interrupted_run(track: Track, tmp_path: Path) -> None:
    for name in ("other.mcap", "r.mcap"):
        track(Memory(), name, stopped=after(5))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(UsageError, match=r"other\.mcap\.part: file of an interrupted run"):
        track(Memory(), resume=True, save_model=tmp_path / "other.mcap")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_model_file_is_not_written_through_a_link(track: Track, tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("mine")
    (tmp_path / "face.npz.part").symlink_to(tmp_path / "precious")
    with pytest.raises(UsageError, match="a symbolic link"):
        track(Memory(), save_model=tmp_path / "face.npz")
    assert (tmp_path / "precious").read_text() == "mine"


def test_a_model_of_other_cameras_is_refused(track: Track, tmp_path: Path) -> None:
    (tmp_path / "one.npz").write_bytes(model_bytes({"mean": np.zeros((10, 3))}, CAMERAS[:1], NAME))
    with pytest.raises(UsageError, match="different number of cameras, found 1, expected 2"):
        track(Memory(), load_model=tmp_path / "one.npz")
    assert not (tmp_path / "r.mcap").exists()
    assert not part_path(tmp_path / "r.mcap").exists()


def test_a_model_of_another_tracker_is_refused(track: Track, tmp_path: Path) -> None:
    (tmp_path / "mono.npz").write_bytes(model_bytes({"mean": np.zeros((10, 3))}, CAMERAS, "head-mono"))
    with pytest.raises(UsageError, match="another tracker, found head-mono, expected head-stereo"):
        track(Memory(), load_model=tmp_path / "mono.npz")


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04 nonsense", b"\x89MCAP0\r\n and no more"])
def test_a_file_that_is_no_model_is_one_line(track: Track, tmp_path: Path, data: bytes) -> None:
    (tmp_path / "odd.npz").write_bytes(data)
    with pytest.raises(PosetrackError) as told:
        track(Memory(), load_model=tmp_path / "odd.npz")
    assert "\n" not in str(told.value)
    assert "odd.npz" in str(told.value)


def test_a_result_without_model_is_none(tmp_path: Path, track: Track) -> None:
    track(Memory(), stopped=after(5))
    with pytest.raises(ResultError, match=r"has no attachment 'model\.npz', found none"):
        load_model(part_path(tmp_path / "r.mcap"), CAMERAS, NAME)


def test_a_hand_s_result_knows_no_head(tmp_path: Path) -> None:
    hand = write_hand_result(tmp_path / "hand.mcap")
    with pytest.raises(
        ResultError, match=r"hand\.mcap: not a result of a head tracker, found a hand, expected a file"
    ):
        load_model(hand, CAMERAS, NAME)


def test_a_model_is_not_written_over(track: Track, tmp_path: Path) -> None:
    (tmp_path / "face.npz").write_bytes(b"mine")
    with pytest.raises(UsageError, match="already exists"):
        track(Memory(), save_model=tmp_path / "face.npz")
    assert (tmp_path / "face.npz").read_bytes() == b"mine"


def test_result_and_model_are_two_files(track: Track, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="result and model must be different files"):
        track(Memory(), save_model=tmp_path / "." / "r.mcap")
    assert not list(tmp_path.iterdir())


def test_two_cameras_of_one_name_are_refused(track: Track) -> None:
    with pytest.raises(ResultError, match="camera names are not unique"):
        track(Memory(cameras=(CAMERAS[0], CAMERAS[0])))


def test_a_resumed_run_refuses_cameras_in_another_place(track: Track, tmp_path: Path) -> None:
    track(Memory(), stopped=after(5))
    moved = replace(CAMERAS[1], camera_T_reference=((1.0, 0.0, 0.0, -121.0), *ASIDE[1:]))
    with pytest.raises(UsageError, match="belongs to another run"):
        track(Memory(cameras=(CAMERAS[0], moved)), resume=True)


def test_a_run_of_which_hardly_any_frame_is_tracked_says_what_images_show(
    track: Track, tmp_path: Path
) -> None:
    """2 of 60 frames are less than 5 %, 3 are not; an interrupted run says the same."""
    assert track(Memory(60, appears=57), "enough.mcap").failure == ""
    outcome = track(Memory(60, appears=58))
    assert outcome.failure.startswith("only 2 of 60 frames tracked: ")
    assert "face in 0; brightness 0 to 0, median 0, 0 % of pixels white; images are dark" in outcome.failure
    remarks = read_result(tmp_path / "r.mcap").summary["remarks"]
    assert remarks == "; ".join((outcome.failure, *outcome.remarks))
    track(Memory(60, appears=58), "again.mcap", stopped=after(59))
    assert track(Memory(60, appears=58), "again.mcap", resume=True).failure == outcome.failure
    assert filecmp.cmp(tmp_path / "r.mcap", tmp_path / "again.mcap", shallow=False)
