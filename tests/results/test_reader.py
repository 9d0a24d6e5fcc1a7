from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from posetrack_cli.errors import PosetrackError, ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import (
    ESTIMATE_SCHEMA_NAME,
    ResultWarning,
    ResultWriter,
    estimate_to_json,
    load_arrays,
    read_result,
)
from posetrack_cli.results.fields import FIELD_NAMES
from support.results import (
    CAMERA,
    RUN,
    SUBJECT,
    begin,
    make_estimate,
    make_truth,
    write_frames,
    write_result,
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("result") / "r.mcap")


def test_estimates_come_back_bit_by_bit(path: Path) -> None:
    for index, estimate in enumerate(read_result(path).estimates()):
        for name in FIELD_NAMES:
            assert np.array_equal(getattr(estimate, name), getattr(make_estimate(index), name)), name
    assert index == 25


def test_the_subject_and_camera_come_back(path: Path) -> None:
    result = read_result(path)
    assert result.subject.point_names == SUBJECT.point_names
    assert result.subject.point_parents == SUBJECT.point_parents
    assert result.subject.colour == SUBJECT.colour
    np.testing.assert_array_equal(result.subject.triangles, SUBJECT.triangles)
    assert result.camera() == replace(CAMERA, name="kinect")


def test_a_fisheye_camera_comes_back(tmp_path: Path) -> None:
    camera = Camera(64, 48, 50.0, 51.0, 31.5, 23.5, (0.1, 0.2, 0.3, 0.4), "equidistant")
    with ResultWriter(tmp_path / "r.mcap", SUBJECT, camera, RUN) as writer:
        writer.write(make_estimate(0))
        writer.finish({})
    assert read_result(tmp_path / "r.mcap").camera() == replace(camera, name="kinect")


def test_truth_comes_back_unchanged(path: Path) -> None:
    result = read_result(path)
    assert result.truth_topics == ("/truth/hand/pose",)
    assert list(result.truth()) == [make_truth(index) for index in range(0, 26, 2)]


def test_arrays_are_stacked_by_field(path: Path) -> None:
    arrays = load_arrays(path)
    assert tuple(arrays) == FIELD_NAMES
    assert arrays["points"].shape == (26, 4, 3)
    np.testing.assert_array_equal(arrays["stamp_ns"], [make_estimate(i).stamp_ns for i in range(26)])
    np.testing.assert_array_equal(arrays["status"][:4], ["tracking", "tracking", "tracking", "lost"])
    np.testing.assert_array_equal(np.isnan(arrays["cost"]), np.arange(26) % 5 == 0)
    assert arrays["resampled"].dtype == np.bool_


def test_arrays_of_no_frames_keep_their_shapes(tmp_path: Path) -> None:
    arrays = load_arrays(write_result(tmp_path / "r.mcap", 0))
    assert arrays["points"].shape == (0, 4, 3)
    assert arrays["twist"].shape == (0, 9)
    assert arrays["stamp_ns"].dtype == np.int64


@pytest.mark.parametrize("cut", [1, 50, 400, 3000])
def test_a_file_cut_anywhere_gives_its_whole_chunks(path: Path, tmp_path: Path, cut: int) -> None:
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:-cut])
    result = read_result(tmp_path / "cut.mcap")
    count = len(list(result.estimates()))
    assert count in {10, 20, 26}
    assert result.truncated
    assert [loss.what for loss in result.losses] == ["file is truncated, the rest is missing"]
    assert result.truth_topics == ("/truth/hand/pose",)


def test_any_cut_reads_or_says_why(path: Path, tmp_path: Path) -> None:
    """No cut may end in anything but fewer frames or one of our errors."""
    data = path.read_bytes()
    counts = []
    for size in range(0, len(data), 997):
        (tmp_path / "cut.mcap").write_bytes(data[:size])
        try:
            counts.append(len(list(read_result(tmp_path / "cut.mcap").estimates())))
        except ResultError:
            counts.append(-1)
    assert counts == sorted(counts)
    assert {-1, 0, 10, 20, 26} == set(counts)


def chunk_middles(path: Path) -> list[int]:
    """A byte within each chunk; each holds ten frames, the first the channels, too."""
    with path.open("rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
    return [index.chunk_start_offset + index.chunk_length // 2 for index in indexes]


def with_damage(path: Path, copy: Path, position: int, keep: int | None = None) -> Path:
    data = bytearray(path.read_bytes())
    data[position] ^= 0xFF
    copy.write_bytes(data[:keep])
    return copy


def test_a_damaged_chunk_is_left_out_and_told(path: Path, tmp_path: Path) -> None:
    middle = chunk_middles(path)[1]
    result = read_result(with_damage(path, tmp_path / "damaged.mcap", middle))
    assert [estimate.frame_index for estimate in result.estimates()] == [*range(10), *range(20, 26)]
    (loss,) = result.losses
    assert (loss.what, loss.count) == ("chunk is damaged, its messages are lost", 1)
    assert result.columns()["frame_index"].tolist() == [*range(10), *range(20, 26)]
    assert len(list(result.truth())) == 8
    assert result.losses == (loss,), "the same chunk is counted once"
    assert (result.truncated, result.finished) == (False, True)


def test_damage_and_a_cut_are_both_told(path: Path, tmp_path: Path) -> None:
    middles = chunk_middles(path)
    result = read_result(with_damage(path, tmp_path / "r.mcap", middles[1], keep=middles[2]))
    assert result.truncated
    assert result.columns()["frame_index"].tolist() == list(range(10))
    assert [loss.what for loss in result.losses] == [
        "file is truncated, the rest is missing",
        "chunk is damaged, its messages are lost",
    ]


def test_messages_whose_channels_were_damaged_are_told(path: Path, tmp_path: Path) -> None:
    middles = chunk_middles(path)
    result = read_result(with_damage(path, tmp_path / "r.mcap", middles[0], keep=middles[2]))
    assert list(result.estimates()) == []
    told = {loss.what: loss.count for loss in result.losses}
    assert told["message skipped, its topic was lost with damaged data"] == 10 * 4 + 7 + 5  # meshes, truths


def test_arrays_of_a_damaged_file_come_with_a_warning(path: Path, tmp_path: Path) -> None:
    damaged = with_damage(path, tmp_path / "damaged.mcap", chunk_middles(path)[0])
    with pytest.warns(ResultWarning, match=r"damaged\.mcap: chunk is damaged, its messages are lost: 1"):
        arrays = load_arrays(damaged)
    assert arrays["frame_index"].tolist() == list(range(10, 26))


def test_a_chunk_that_is_cut_gives_its_whole_messages(path: Path, tmp_path: Path) -> None:
    """One chunk of everything, larger than a block of the compression: what lies before the cut is read."""
    frames = 300
    data = write_result(tmp_path / "r.mcap", frames, flush_frames=1000).read_bytes()
    counts = []
    for share in (0.3, 0.6, 0.9):
        (tmp_path / "cut.mcap").write_bytes(data[: int(share * len(data))])
        result = read_result(tmp_path / "cut.mcap")
        indices = result.columns()["frame_index"].tolist()
        assert indices == list(range(len(indices)))
        assert [loss.what for loss in result.losses] == ["file is truncated, the rest is missing"]
        counts.append(len(indices))
    assert 0 < counts[0] < counts[1] < counts[2] < frames


def test_any_flipped_byte_ends_in_frames_and_losses_or_one_line(path: Path, tmp_path: Path) -> None:
    for position in range(8, path.stat().st_size, 211):
        damaged = with_damage(path, tmp_path / "damaged.mcap", position)
        try:
            result = read_result(damaged)
            count = len(result.columns()["stamp_ns"])
        except PosetrackError as error:
            assert "\n" not in str(error)
        else:
            assert count == 26 or result.losses


def test_truth_of_our_own_schema_reads_as_estimates(tmp_path: Path) -> None:
    truth = make_estimate(4)
    topic = "/truth/hand/estimate"
    data = estimate_to_json(truth)
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 1)
        writer.add_truth(
            TruthMessage(topic, ESTIMATE_SCHEMA_NAME, "jsonschema", b"{}", "json", truth.stamp_ns, data)
        )
        writer.finish({})
    np.testing.assert_array_equal(load_arrays(tmp_path / "r.mcap", topic)["position"], [truth.position])


def with_fewer(path: Path, copy: Path, name: str) -> Path:
    """A copy whose estimates lack the last entry of a field."""
    with path.open("rb") as source, copy.open("wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start()
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        topics: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages():
            if channel.topic not in topics:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                topics[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id
                )
            data = message.data
            if channel.topic == "/hand/estimate":
                values = json.loads(data)
                data = json.dumps(values | {name: values[name][:-1]}).encode()
            writer.add_message(topics[channel.topic], message.log_time, data, message.publish_time)
        writer.finish()
    return copy


@pytest.mark.parametrize("name", ["shape", "points"])
def test_estimates_that_are_not_the_subject_s_are_refused(path: Path, tmp_path: Path, name: str) -> None:
    result = read_result(with_fewer(path, tmp_path / "r.mcap", name))
    expected = {"shape": SUBJECT.shape_names, "points": SUBJECT.point_names}[name]
    found = f"{len(expected) - 1} entries, expected {len(expected)}"
    with pytest.raises(ResultError, match=f"size of {name} differs from the subject.s, found {found}"):
        result.columns(fields=("stamp_ns", name))
    assert len(result.columns(fields=("stamp_ns",))["stamp_ns"]) == 26


def test_an_unknown_topic_is_an_error_that_names_the_near_one(path: Path) -> None:
    with pytest.raises(ResultError, match=r"did you mean '/hand/estimate'\?"):
        list(read_result(path).estimates("/hand/estimates"))


def test_a_result_that_ends_before_its_first_estimate_says_so(path: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    data = path.read_bytes()
    cut.write_bytes(data)
    while read_result(cut).channels:  # until it ends before the chunk that tells them
        data = data[: len(data) // 2]
        cut.write_bytes(data)
    with pytest.raises(ResultError, match="the file has no estimates"):
        read_result(cut).topic_of_estimates("/hand/estimate")


def test_a_missing_result_points_at_the_unfinished_one(tmp_path: Path) -> None:
    begin(tmp_path / "r.mcap").abort()
    with pytest.raises(ResultError, match=r"found an unfinished run, .*r\.mcap\.part"):
        read_result(tmp_path / "r.mcap")
    with pytest.raises(ResultError, match="No such file"):
        read_result(tmp_path / "nothing.mcap")
    assert read_result(part_path(tmp_path / "r.mcap")).run == RUN


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("hello, world")
    with pytest.raises(ResultError, match="is not an MCAP file"):
        read_result(tmp_path / "text.mcap")
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    with pytest.raises(ResultError, match="is not a posetrack result"):
        read_result(tmp_path / "other.mcap")


def test_a_head_without_mesh_or_angles_has_fewer_topics(tmp_path: Path) -> None:
    subject = replace(SUBJECT, name="head", shape_names=(), triangles=None)
    with ResultWriter(tmp_path / "r.mcap", subject, CAMERA, RUN) as writer:
        writer.write(make_estimate(0, k=0))
        writer.finish({})
    result = read_result(tmp_path / "r.mcap")
    topics = [channel.topic for _, channel in result.channels]
    assert topics == ["/camera/calibration", "/head/estimate", "/head/odometry", "/tf"]
    assert load_arrays(result.path)["shape"].shape == (1, 0)


def test_importing_results_loads_neither_mcap_nor_protobuf() -> None:
    code = (
        "import sys; from posetrack_cli.results import Estimate; "
        "print([m for m in ('mcap', 'google.protobuf', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60
    )
    assert done.stdout == "[]\n"
