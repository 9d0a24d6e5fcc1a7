"""Videos, folders and sheets: what is written can be read, and nothing is replaced unasked."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.evaluation.viewing import outputs
from posetrack_cli.evaluation.viewing.outputs import (
    LEAST_PICTURE_PX,
    SHEET_PX,
    PictureFolder,
    Sheet,
    VideoFile,
    check_view_output,
    fitting_sheet,
    open_output,
    sheet_columns,
    sheet_of,
)
from support.viewing import pictures_of

RATE = 12.5
COLOUR_TOLERANCE = 40
"""The codec's loss on plain colours; the colours of the tests differ by over 100."""


def plain(level: int, height: int = 64, width: int = 96) -> np.ndarray:
    return np.full((height, width, 3), level, np.uint8)


def test_a_video_plays_back_with_every_picture_in_order(tmp_path: Path) -> None:
    path = tmp_path / "ü.mp4"
    video = VideoFile(path, RATE)
    levels = [0, 120, 250, 120, 0]
    for index, level in enumerate(levels):
        video.add(index, plain(level))
    assert not path.exists(), "the name stands for a whole video"
    video.close()
    played = pictures_of(path)
    assert [picture.shape for picture in played] == [(64, 96, 3)] * 5
    np.testing.assert_allclose([p.mean() for p in played], levels, atol=COLOUR_TOLERANCE)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS) == pytest.approx(RATE)
    assert [p.name for p in tmp_path.iterdir()] == ["ü.mp4"]


@pytest.mark.parametrize("size", [(63, 97), (65, 96), (17, 1), (1, 1)])
def test_pictures_of_odd_size_keep_every_pixel(tmp_path: Path, size: tuple[int, int]) -> None:
    path = tmp_path / "v.mp4"
    video = VideoFile(path, RATE)
    video.add(0, plain(200, *size))
    video.close()
    (played,) = pictures_of(path)
    height, width = size
    assert played.shape[:2] == (height + height % 2, width + width % 2)
    assert played[:height, :width].min() > 200 - 2 * COLOUR_TOLERANCE


@pytest.mark.parametrize("rate", [0.001, 0.1, 1 / 3, 29.97, 1e9 / 33333333, 240.0, 1e6])
def test_rates_that_no_player_knows_are_brought_into_range(tmp_path: Path, rate: float) -> None:
    path = tmp_path / "v.mp4"
    video = VideoFile(path, rate)
    for index in range(3):
        video.add(index, plain(50))
    video.close()
    assert len(pictures_of(path)) == 3
    expected = min(max(rate, 0.1), 240.0)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS) == pytest.approx(expected, abs=0.01)


def test_a_video_without_pictures_leaves_no_file_and_a_failed_one_neither(tmp_path: Path) -> None:
    VideoFile(tmp_path / "a.mp4", RATE).close()
    failed = VideoFile(tmp_path / "b.mp4", RATE)
    failed.add(0, plain(1))
    failed.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_video_that_was_cut_short_is_not_taken_for_one(tmp_path: Path) -> None:
    """A full disk: FFmpeg says nothing, so the file is looked at before it gets its name."""
    path = tmp_path / "v.mp4"
    video = VideoFile(path, RATE)
    for index in range(5):
        video.add(index, plain(50))
    video._count += 1  # as if the last one had not reached the disk
    with pytest.raises(ResultError, match=r"v.mp4: video cannot be read back"):
        video.close()
    assert list(tmp_path.iterdir()) == []


def test_a_video_that_another_process_writes_is_left_alone(tmp_path: Path) -> None:
    first = VideoFile(tmp_path / "v.mp4", RATE)
    first.add(0, plain(100))
    with pytest.raises(UsageError, match="is being written by another process"):
        VideoFile(tmp_path / "v.mp4", RATE)
    first.close()
    assert len(pictures_of(tmp_path / "v.mp4")) == 1
    VideoFile(tmp_path / "v.mp4", RATE).close()


def test_an_unwritable_place_is_one_line(tmp_path: Path) -> None:
    video = VideoFile(tmp_path / "nowhere" / "v.mp4", RATE)
    with pytest.raises(ResultError, match=r"v.mp4: cannot be written, found No such file or directory"):
        video.add(0, plain(1))


def test_a_folder_holds_a_picture_per_frame_and_loses_those_of_before(tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    for frames in ([3, 1_234_567], [4]):
        out = PictureFolder(folder)
        for frame in frames:
            out.add(frame, plain(frame % 200))
        out.close()
    (folder / "notes.txt").write_text("mine")
    assert sorted(p.name for p in folder.iterdir()) == ["frame_000004.png", "notes.txt"]
    np.testing.assert_array_equal(cv2.imread(str(folder / "frame_000004.png")), plain(4))


def test_a_full_disk_names_the_picture_and_leaves_no_half_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, data: bytes) -> None:
        path.write_bytes(data[:9])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(outputs, "write_output", full)
    folder = PictureFolder(tmp_path / "pictures")
    with pytest.raises(ResultError, match=r"frame_000003.png: cannot be written, found No space left"):
        folder.add(3, plain(3))
    assert not list((tmp_path / "pictures").iterdir())


def test_no_picture_is_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "victim").write_bytes(b"precious")
    folder = PictureFolder(tmp_path / "pictures")
    (tmp_path / "pictures" / "frame_000003.png").symlink_to("../victim")
    with pytest.raises(ResultError, match="a symbolic link"):
        folder.add(3, plain(3))
    assert (tmp_path / "victim").read_bytes() == b"precious"


@pytest.mark.parametrize(("count", "width", "columns"), [(1, 96, 1), (6, 30, 3), (7, 700, 1), (3, 5000, 1)])
def test_a_sheet_shows_every_picture_where_reading_order_has_it(count: int, width: int, columns: int) -> None:
    sheet = sheet_of([plain(10 + number, 20, width) for number in range(count)])
    rows = -(-count // columns)
    assert sheet.shape[:2] == (26 * rows - 6, (width + 6) * columns - 6)
    for number in range(count):
        row, column = divmod(number, columns)
        part = sheet[26 * row : 26 * row + 20, (width + 6) * column : (width + 6) * column + width]
        assert (part == 10 + number).all()


@pytest.mark.parametrize("size", [(1536, 424), (640, 480), (1280, 480), (300, 300), (640, 840), (1920, 1080)])
@pytest.mark.parametrize("count", [1, 6, 8, 24])
def test_sheets_are_as_large_as_a_screen_shows_and_their_pictures_can_be_read(
    size: tuple[int, int], count: int
) -> None:
    """Three depth panels, one camera, two, a cut-out hand, one above the other, a telephone's video."""
    shrunk = fitting_sheet(count, size)
    width, height = (round(shrunk * side) for side in size)
    captioned = width, height + 36
    columns = sheet_columns(count, captioned)
    rows = -(-count // columns)
    assert columns * (width + 6) - 6 <= SHEET_PX[0] + 3 * columns
    assert rows * (captioned[1] + 6) - 6 <= SHEET_PX[1] + 3 * rows or height == LEAST_PICTURE_PX
    assert height >= min(LEAST_PICTURE_PX, size[1]) and shrunk <= 1.0
    assert shrunk > 0.99 or columns * width > 0.6 * SHEET_PX[0] or rows * height > 0.6 * SHEET_PX[1]


def test_places_of_a_sheet_are_filled() -> None:
    assert [sheet_columns(count, (430, 470)) for count in (1, 2, 3, 4, 6, 8, 9)] == [1, 2, 3, 2, 3, 4, 3]


def test_of_very_many_pictures_a_sheet_is_higher_and_they_keep_their_size() -> None:
    assert fitting_sheet(120, (1536, 424)) == LEAST_PICTURE_PX / 424
    assert sheet_columns(120, (580, 196)) == 5


def test_a_sheet_is_written_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "s.png"
    sheet = Sheet(path)
    sheet.add(0, plain(7))
    assert not path.exists()
    sheet.close()
    assert cv2.imread(str(path)).shape == (64, 96, 3)
    Sheet(tmp_path / "none.png").close()
    assert not (tmp_path / "none.png").exists()


def test_the_name_decides(tmp_path: Path) -> None:
    kinds = {"a.mp4": VideoFile, "a.MP4": VideoFile, "a.png": Sheet, "a": PictureFolder}
    for name, kind in kinds.items():
        assert isinstance(open_output(tmp_path / name, RATE), kind)


def test_outputs_that_are_refused(tmp_path: Path) -> None:
    (tmp_path / "v.mp4").write_bytes(b"")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").write_bytes(b"")
    full = tmp_path / "full"
    full.mkdir()
    (full / "frame_000001.png").write_bytes(b"")
    for name, words in {
        "v.avi": "unsupported output format, found .avi, expected FILE.mp4",
        "v.mp4": "already exists; use --overwrite",
        "full": "already exists; use --overwrite",
        "folder.png": "output exists and is of another kind, found a folder",
        "file": "output exists and is of another kind, found a file",
    }.items():
        with pytest.raises(UsageError, match=words):
            check_view_output(tmp_path / name, overwrite=False)
    with pytest.raises(ResultError, match="no folder"):
        check_view_output(tmp_path / "no" / "v.mp4", overwrite=False)
    for name in ("v.mp4", "full", "new.mp4", "new"):
        check_view_output(tmp_path / name, overwrite=True)
    (full / "frame_000001.png").rename(full / "mine.png")
    check_view_output(full, overwrite=False)
