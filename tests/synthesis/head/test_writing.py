"""What is written reads back as a recording and as truth, the same every time; nothing else is replaced."""

from __future__ import annotations

import filecmp
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.rotations import quaternion_rate
from posetrack_cli.head.subject import head_subject
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.estimate_json import estimate_from_json
from posetrack_cli.results.fields import check_estimate
from posetrack_cli.synthesis.head.frames import (
    COMPONENTS,
    SyntheticHeadFrame,
    make_cameras,
    make_plan,
    synthesise,
)
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.person import EXPRESSIONS
from posetrack_cli.synthesis.head.writing import write_synthetic
from posetrack_cli.synthesis.recording import SYNTH_RECORD

SMALL = HeadSynthOptions(frames=3, seed=5, width=160, height=120)
TOPICS = {f"/truth/head/{name}" for name in ("odometry", "expression", "estimate")}
METRES = 1e-9
"""mm: metres of a message and back, a quaternion and back."""


@dataclass(frozen=True)
class Made:
    """One recording as frames, as a file and as a folder; to make a person takes most of each."""

    options: HeadSynthOptions
    frames: Sequence[SyntheticHeadFrame]
    file: Path
    folder: Path


def make(options: HeadSynthOptions, folder: Path, image_format: str = "png") -> Made:
    write_synthetic(options, folder / "a.mcap", image_format=image_format)
    write_synthetic(options, folder / "a", image_format="png")
    return Made(options, list(synthesise(options)), folder / "a.mcap", folder / "a")


@pytest.fixture(scope="module")
def stereo(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return make(SMALL, tmp_path_factory.mktemp("stereo"))


@pytest.fixture(scope="module", params=[1, 2])
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, stereo: Made) -> Made:
    """Of one camera, with distortion and raw images, and of two."""
    if request.param == 2:
        return stereo
    return make(replace(SMALL, cameras=1, distortion=True), tmp_path_factory.mktemp("mono"), "raw")


def test_a_file_reads_as_the_recording_that_was_made(both: Made) -> None:
    recording = open_recording(both.file, "grey")
    for read, made in zip(recording.cameras, make_cameras(both.options), strict=True):
        assert (read.matrix == made.matrix).all() and read.distortion == made.distortion
        np.testing.assert_allclose(read.camera_T_reference, made.camera_T_reference, atol=METRES)
    expected, frames = both.frames, list(recording.frames())
    assert not recording.losses
    for frame, made_frame in zip(frames, expected, strict=True):
        assert frame.stamp_ns == made_frame.stamp_ns
        for read_image, image in zip(frame.images, made_frame.images, strict=True):
            assert np.array_equal(read_image, image)
    truth = list(recording.truth())
    assert {message.topic for message in truth} == TOPICS
    estimates = [estimate_from_json(m.data) for m in truth if m.topic == "/truth/head/estimate"]
    for estimate, made_frame in zip(estimates, expected, strict=True):
        check_estimate(estimate, head_subject("left", COMPONENTS))
        assert (estimate.points == made_frame.pose.points(made_frame.shape)).all()
        assert (estimate.position == made_frame.pose.position).all()


def test_a_folder_reads_as_the_recording_that_was_made(both: Made) -> None:
    names = {path.name for path in both.folder.iterdir()}
    folders = {"left", "right"} if both.options.cameras == 2 else {"camera"}
    assert names == {"camera.toml", "timestamps.csv", "truth.mcap", *folders}
    recording = open_recording(both.folder, "grey")
    assert recording.cameras == make_cameras(both.options)
    for frame, made in zip(recording.frames(), both.frames, strict=True):
        assert frame.stamp_ns == made.stamp_ns
        assert all(np.array_equal(a, b) for a, b in zip(frame.images, made.images, strict=True))


def test_truth_and_record_of_folder_and_file_are_the_same(stereo: Made) -> None:
    contents = []
    for path in (stereo.folder / "truth.mcap", stereo.file):
        with path.open("rb") as stream:
            reader = make_reader(stream)
            record = next(m.metadata for m in reader.iter_metadata() if m.name == SYNTH_RECORD)
            truth = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages(sorted(TOPICS))]
        contents.append((record, truth))
    assert contents[0] == contents[1]
    assert contents[0][0]["identity"] == "1" and contents[0][0]["turn_s"] == ""


def test_the_truth_of_a_folder_is_that_of_the_file(stereo: Made) -> None:
    """So that a run carries it over; not where images are mirrored or their stamps are made."""
    file, folder = (open_recording(path, "grey") for path in (stereo.file, stereo.folder))
    truth = list(folder.truth())
    assert truth == list(file.truth()) and {message.topic for message in truth} == TOPICS
    for options in ({"mirror": True}, {"fps": 30.0}):
        assert list(open_recording(stereo.folder, "grey", **options).truth()) == []


def test_the_same_options_give_the_same_bytes(stereo: Made, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    write_synthetic(SMALL, again, image_format="png")
    assert filecmp.cmp(stereo.file, again, shallow=False)
    write_synthetic(replace(SMALL, seed=6), again, image_format="png", overwrite=True)
    assert not filecmp.cmp(stereo.file, again, shallow=False)


def test_truth_has_rates_of_the_pose_and_the_expressions_by_name(tmp_path: Path) -> None:
    options = replace(SMALL, frames=10, fps=2.5, width=64, height=64, cameras=1)
    frames = list(synthesise(options))
    estimate = frames[5].truth()
    assert estimate.pose_rate is not None and estimate.twist is not None
    expected = quaternion_rate(estimate.quaternion, estimate.twist[3:])
    np.testing.assert_allclose(estimate.pose_rate, [*estimate.twist[:3], *expected])
    write_synthetic(options, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = [m for _, _, _, m in reader.iter_decoded_messages(["/truth/head/expression"])]
    for message, frame in zip(decoded, frames, strict=True):
        assert [joint.name for joint in message.joints] == list(EXPRESSIONS)
        np.testing.assert_array_equal([joint.position for joint in message.joints], frame.strengths)
    assert max(abs(frame.strengths[:7]).max() for frame in frames) > 0.2


def test_what_exists_is_kept_unless_it_may_be_replaced(stereo: Made, tmp_path: Path) -> None:
    one = replace(SMALL, frames=1)
    shutil.copy(stereo.file, tmp_path / "a.mcap")
    shutil.copytree(stereo.folder, tmp_path / "a")
    for name in ("a.mcap", "a"):
        with pytest.raises(UsageError, match="already exists"):
            write_synthetic(one, tmp_path / name)
        write_synthetic(one, tmp_path / name, overwrite=True)
    (tmp_path / "a" / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="not created by posetrack synth"):
        write_synthetic(one, tmp_path / "a", overwrite=True)
    assert (tmp_path / "a" / "notes.txt").read_text() == "mine"


def test_bad_outputs_are_one_line(tmp_path: Path) -> None:
    one = replace(SMALL, frames=1)
    with pytest.raises(UsageError, match=r"NAME\.mcap, or a folder"):
        write_synthetic(one, tmp_path / "a.bag")
    with pytest.raises(ResultError, match="cannot be written"):
        write_synthetic(one, tmp_path / "missing" / "a")
    with pytest.raises(UsageError, match="invalid --image-format"):
        write_synthetic(one, tmp_path / "a", image_format="raw")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.mcap", "a"])
def test_an_interrupted_synthesis_leaves_nothing(tmp_path: Path, name: str) -> None:
    def stop(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_synthetic(SMALL, tmp_path / name, report=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "cameras"), [("a", 1), ("a.mcap", 2)])
def test_images_that_are_missing_are_those_of_the_plan(tmp_path: Path, name: str, cameras: int) -> None:
    """The others are the same as without drops."""
    options = replace(SMALL, cameras=cameras, frames=12, seed=274, width=64, height=64, drops=True)
    plan = make_plan(options)
    made = write_synthetic(options, tmp_path / name, image_format="png")
    assert made.missing == plan.timeline.dropped.sum() > 0
    assert not plan.timeline.dropped[:, 0].any() and (
        cameras == 1 or not plan.timeline.dropped.all(axis=0).any()
    )
    taken = np.flatnonzero(~plan.timeline.dropped.all(axis=0))
    whole = list(synthesise(replace(options, drops=False)))
    for frame, index in zip(open_recording(tmp_path / name, "grey").frames(), taken, strict=True):
        assert frame.stamp_ns == plan.timeline.stamps_ns[index]
        for image, dropped, expected in zip(
            frame.images, plan.timeline.dropped[:, index], whole[index].images, strict=True
        ):
            assert image is None if dropped else np.array_equal(image, expected)
