from __future__ import annotations

import filecmp
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.rotations import quaternion_rate
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.estimate_json import estimate_from_json
from posetrack_cli.results.fields import check_estimate
from posetrack_cli.synthesis.hand.frames import SUBJECT, synthesise, write_synthetic
from posetrack_cli.synthesis.hand.options import Switches, SynthOptions
from posetrack_cli.synthesis.recording import SYNTH_RECORD

TRUTH_TOPICS = {f"/truth/hand/{name}" for name in ("odometry", "joint_states", "estimate")}


def test_the_file_reads_as_a_recording_with_its_truth(tmp_path: Path) -> None:
    options = SynthOptions(motion="C", frames=40, seed=5)
    made = write_synthetic(options, tmp_path / "a.mcap")
    recording = open_recording(tmp_path / "a.mcap")
    expected = list(synthesise(options))
    frames = list(recording.frames())
    assert len(frames) == made.frames == len(expected) and made.frames + made.missing == 40
    assert recording.cameras[0].fx == 365.0 and not recording.losses
    truth = list(recording.truth())
    assert {message.topic for message in truth} == TRUTH_TOPICS
    estimates = [estimate_from_json(m.data) for m in truth if m.topic == "/truth/hand/estimate"]
    for frame, synthetic, estimate in zip(frames, expected, estimates, strict=True):
        assert frame.stamp_ns == synthetic.stamp_ns == estimate.stamp_ns
        assert frame.index == estimate.frame_index
        assert (frame.depth == synthetic.depth).all()
        assert (estimate.points == synthetic.joints).all()
        assert (estimate.twist == synthetic.twist).all()
        check_estimate(estimate, SUBJECT)


def test_the_same_options_give_the_same_bytes(tmp_path: Path) -> None:
    options = SynthOptions(motion="C", frames=6, seed=3)
    for name in ("a.mcap", "b.mcap"):
        write_synthetic(options, tmp_path / name)
    assert filecmp.cmp(tmp_path / "a.mcap", tmp_path / "b.mcap", shallow=False)
    write_synthetic(SynthOptions(motion="C", frames=6, seed=4), tmp_path / "b.mcap", overwrite=True)
    assert not filecmp.cmp(tmp_path / "a.mcap", tmp_path / "b.mcap", shallow=False)


def test_truth_of_a_random_walk_has_no_velocity(tmp_path: Path) -> None:
    write_synthetic(SynthOptions(motion="A", frames=2, switches=Switches()), tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        record = {m.name: m.metadata for m in reader.iter_metadata()}[SYNTH_RECORD]
        topics = ["/truth/hand/odometry", "/truth/hand/joint_states"]
        decoded = [message for _, _, _, message in reader.iter_decoded_messages(topics)]
        estimates = [message.data for _, _, message in reader.iter_messages(["/truth/hand/estimate"])]
    assert record["velocity"] == "none" and record["motion"] == "A" and record["switch.noise"] == "false"
    odometry, joints = decoded[:2]
    assert not odometry.HasField("linear_velocity") and not odometry.velocity_covariance
    assert not joints.joints[0].HasField("velocity")
    for estimate in map(estimate_from_json, estimates):
        assert (estimate.pose_rate, estimate.twist, estimate.twist_variance) == (None, None, None)


def test_the_pose_rate_is_that_of_the_quaternion() -> None:
    frame = list(synthesise(SynthOptions(motion="B", frames=5, switches=Switches())))[-1]
    estimate = frame.truth()
    assert frame.twist is not None
    assert estimate.pose_rate is not None
    assert estimate.pose_rate[3:7] == pytest.approx(quaternion_rate(frame.pose[3:7], frame.twist[3:6]))
    assert estimate.pose_rate[7:] == pytest.approx(frame.twist[6:])
    assert np.dot(estimate.pose_rate[3:7], frame.pose[3:7]) == pytest.approx(0.0, abs=1e-12)


def test_a_file_that_exists_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(UsageError, match="already exists"):
        write_synthetic(SynthOptions(frames=1), out)
    assert out.read_bytes() == b"precious"


def test_output_must_be_named_as_an_mcap_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\.mcap"):
        write_synthetic(SynthOptions(frames=1), tmp_path / "a.bag")


def test_output_that_cannot_be_written_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="cannot be written"):
        write_synthetic(SynthOptions(frames=1), tmp_path / "missing" / "a.mcap")


def test_an_interrupted_synthesis_leaves_nothing(tmp_path: Path) -> None:
    def stop(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_synthetic(SynthOptions(frames=3, switches=Switches()), tmp_path / "a.mcap", report=stop)
    assert list(tmp_path.iterdir()) == []
