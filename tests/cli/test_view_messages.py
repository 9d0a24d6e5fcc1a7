"""``posetrack view -o FILE.mcap``: the result, unchanged in value, with the images of its frames."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_INTERRUPTED, EXIT_USAGE
from posetrack_cli.evaluation.viewing import with_images
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results import ResultWriter, Subject, read_result
from support import images as support
from support.results import RUN, make_estimate, with_fields
from support.viewing import make_recording, make_result, write_camera

FRAMES = 5
HEAD = Subject("head", "camera", (), ("nose", "chin"), (-1, 0), lines=((0, 1),))
JPEG_LEVELS = 3.0
"""Mean error of smooth pictures at quality 95."""


def messages(path: Path, topic: str, kind: Any) -> list[tuple[int, Any]]:
    return [(m.log_time, kind.FromString(m.data)) for _, _, m in McapFile(path).messages([topic])]


def view(*arguments: object) -> int:
    return run(["view", *map(str, arguments)])


def write_head(path: Path, source: Recording, rows: Sequence[int]) -> Path:
    """A result of some frames of a recording of images."""
    camera, *others = source.cameras
    identity = {f"input.{name}": value for name, value in source.identity().items()}
    stamps = [frame.stamp_ns for frame in source.frames()]
    subject = Subject("head", camera.name, (), HEAD.point_names, HEAD.point_parents, lines=HEAD.lines)
    with ResultWriter(path, subject, camera, RUN | identity, others=others) as writer:
        for row in rows:
            writer.write(with_fields(make_estimate(row, k=0, p=2), stamp_ns=stamps[row]))
        writer.finish({})
    return path


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("made") / "hand.mcap", FRAMES)


@pytest.fixture(scope="module")
def result(hand: Path) -> Path:
    opened = open_recording(hand)
    return make_result(hand.with_name("result.mcap"), opened, with_truth=True, smoothed=lambda one: one)


@pytest.fixture(scope="module")
def joined(result: Path) -> Path:
    out = result.with_name("joined.mcap")
    assert view(result, "-o", out) == 0
    return out


def test_depth_is_raw_at_the_stamps_of_the_estimates(hand: Path, result: Path, joined: Path) -> None:
    found = messages(joined, "/camera/depth/image", RawImage)
    frames = list(open_recording(hand).frames())
    assert [stamp for stamp, _ in found] == read_result(result).columns()["stamp_ns"].tolist()
    for (stamp, message), frame in zip(found, frames, strict=True):
        assert (message.encoding, message.frame_id, message.step) == ("16UC1", "camera", 2 * 512)
        assert message.timestamp.ToNanoseconds() == stamp
        depth = np.frombuffer(message.data, "<u2").reshape(message.height, message.width)
        np.testing.assert_array_equal(depth, frame.depth)


def test_tracks_truth_and_record_are_those_of_the_result(result: Path, joined: Path) -> None:
    one, other = read_result(result), read_result(joined)
    assert (other.run, other.summary, other.tracks) == (one.run, one.summary, one.tracks)
    for topic in ("/hand/estimate", "/smoothed/hand/estimate", "/truth/hand/estimate"):
        mine, theirs = one.columns(topic), other.columns(topic)
        for name, column in mine.items():
            np.testing.assert_array_equal(column, theirs[name], err_msg=f"{topic} {name}")


def test_points_are_there_for_viewers_without_scenes(result: Path, joined: Path) -> None:
    for topic, track in (("/hand/points", "filtered"), ("/smoothed/hand/points", "smoothed")):
        found = messages(joined, topic, PointCloud)
        points = read_result(result).to_numpy(track)["points"]
        assert len(found) == FRAMES
        for (_, cloud), expected in zip(found, points, strict=True):
            assert [(f.name, f.offset, f.type) for f in cloud.fields] == [
                ("x", 0, 7),
                ("y", 4, 7),
                ("z", 8, 7),
            ]
            own = np.frombuffer(cloud.data, "<f4").reshape(-1, cloud.point_stride // 4)
            np.testing.assert_allclose(1e3 * own, expected, rtol=1e-6)  # single precision


def test_a_second_time_gives_the_same_file(joined: Path, tmp_path: Path) -> None:
    assert view(joined, "-o", tmp_path / "again.mcap") == 0
    assert (tmp_path / "again.mcap").read_bytes() == joined.read_bytes()


def test_a_joined_file_is_evaluated_like_the_result(result: Path, joined: Path, tmp_path: Path) -> None:
    tables = []
    for path in (result, joined):
        report = tmp_path / f"{path.stem}.json"
        assert run(["eval", str(path), "--json", str(report)]) == 0
        tables.append(json.loads(report.read_text())["results"][0]["metrics"])
    assert tables[0] == tables[1]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--track", "smoothed"], "holds one result with all its tracks, found --track"),
        (["--select", "worst:2"], "found --select"),
        (["--zoom", "2"], "found --zoom"),
        (["--device", "cpu"], "found --device"),
        (["--show-truth"], "found --show-truth"),
        (["twice"], "found 2 results"),
    ],
)
def test_what_does_not_apply_is_refused(
    result: Path, tmp_path: Path, arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    more = [result] if arguments == ["twice"] else arguments
    assert view(result, "-o", tmp_path / "j.mcap", *more) == EXIT_USAGE
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_replaced_unless_asked(
    result: Path, joined: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = result.read_bytes()
    assert view(result, "-o", joined) == EXIT_USAGE
    assert "already exists" in capsys.readouterr().err
    assert view(result, "-o", result, "--overwrite") == EXIT_USAGE
    assert "output would replace the result" in capsys.readouterr().err
    assert result.read_bytes() == before


def test_an_interruption_leaves_nothing(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr(with_images, "image_message", interrupted)
    assert view(result, "-o", tmp_path / "j.mcap") == EXIT_INTERRUPTED
    assert list(tmp_path.iterdir()) == []


def test_images_of_several_cameras_are_copied(tmp_path: Path) -> None:
    pictures = {name: support.grey_images(FRAMES, seed=k) for k, name in enumerate(("left", "right"))}
    pictures["right"][2] = None
    folder = support.write_rig(tmp_path / "r", pictures)
    path = write_head(tmp_path / "result.mcap", open_recording(folder, "grey"), (1, 2, 4))
    assert view(path, "-o", tmp_path / "j.mcap") == 0
    for name, rows in (("left", (1, 2, 4)), ("right", (1, 4))):
        found = messages(tmp_path / "j.mcap", f"/camera/{name}/image", CompressedImage)
        files = [(folder / name / f"{row:06d}.png").read_bytes() for row in rows]
        assert [(m.frame_id, m.data) for _, m in found] == [(name, data) for data in files]


def test_an_image_that_cannot_be_decoded_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = support.write_images(tmp_path / "r", support.grey_images(FRAMES))
    support.write_stamps(folder, support.stamps(FRAMES))
    source = open_recording(folder, "grey", guess=Guess())
    write_camera(folder / "camera.toml", source.cameras[0])
    path = write_head(tmp_path / "result.mcap", open_recording(folder, "grey"), range(FRAMES))
    (folder / "000003.png").write_bytes(b"damaged")
    asked = ("--recording", folder, "--any-recording")
    assert view(path, "-o", tmp_path / "j.mcap", *asked) == EXIT_DATA_LOST
    caught = capsys.readouterr()
    assert caught.out == f"{FRAMES - 1} frames: {tmp_path / 'j.mcap'}\n"
    assert "image skipped, unsupported image format: 1, first frame 3, 000003.png" in caught.err


def write_video(path: Path) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.integers(0, 256, (120, 160, 3), dtype=np.uint8), (0, 0), 4)
    pictures = [np.ascontiguousarray(texture[2 * k : 2 * k + 96, :128]) for k in range(FRAMES)]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"bf": "0"})
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    path.with_suffix(".toml").write_text("fx = 120.0\nfy = 120.0\ncx = 63.5\ncy = 47.5\n")
    return pictures


def test_a_whole_video_is_copied_and_a_part_of_it_is_not(tmp_path: Path) -> None:
    """Pictures without those before cannot be decoded."""
    pictures = write_video(tmp_path / "v.mp4")
    source = open_recording(tmp_path / "v.mp4", "grey")
    whole = write_head(tmp_path / "whole.mcap", source, range(FRAMES))
    part = write_head(tmp_path / "part.mcap", source, (1, 3))
    assert view(whole, "-o", tmp_path / "a.mcap") == view(part, "-o", tmp_path / "b.mcap") == 0
    found = messages(tmp_path / "a.mcap", "/camera/image", CompressedVideo)
    assert len(found) == FRAMES and found[0][1].format == "h264"
    stills = messages(tmp_path / "b.mcap", "/camera/image", CompressedImage)
    for (_, message), row in zip(stills, (1, 3), strict=True):
        assert message.format == "jpeg"
        shown = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        assert np.abs(shown.astype(int) - pictures[row]).mean() < 2 * JPEG_LEVELS, "colour is kept"
