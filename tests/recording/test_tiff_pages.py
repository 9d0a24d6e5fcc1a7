"""Pages of TIFFs are frames: as OpenCV and the specification lay them out, and damaged."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.cli.info import info
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.image_files import decode_any, list_images, read_image
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.tiff import find_pages
from support import images as support

THUMBNAIL, MASK = 1, 4


def tiff(
    pages: Sequence[np.ndarray],
    order: str = "<",
    *,
    tile: int = 0,
    rows: int = 5,
    kinds: Sequence[int] = (),
    last: int = 0,
) -> bytes:
    """A TIFF of grey pages without compression, as the specification lays it out.

    Args:
        pages: 8 or 16 bits.
        order: of bytes.
        tile: side of a tile; 0 for strips.
        rows: of a strip.
        kinds: NewSubfileType of each page, all full images by default.
        last: where the directory after the last is, 0 for none.
    """
    data = bytearray((b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 0))
    link = 4
    for number, page in enumerate(pages):
        values = page.astype(page.dtype.newbyteorder(order))
        height, width = values.shape
        if tile:
            padded = np.zeros((-(-height // tile) * tile, -(-width // tile) * tile), values.dtype)
            padded[:height, :width] = values
            pieces = [
                padded[v : v + tile, u : u + tile].tobytes()
                for v in range(0, padded.shape[0], tile)
                for u in range(0, padded.shape[1], tile)
            ]
        else:
            pieces = [values[v : v + rows].tobytes() for v in range(0, height, rows)]
        offsets = []
        for piece in pieces:
            offsets.append(len(data))
            data += piece
        entries: dict[int, Sequence[int]] = {
            254: [kinds[number] if kinds else 0],
            256: [width],
            257: [height],
            258: [8 * values.itemsize],
            259: [1],
            262: [1],
            277: [1],
        }
        sizes = [len(piece) for piece in pieces]
        entries |= {322: [tile], 323: [tile], 324: offsets, 325: sizes} if tile else {}
        entries |= {} if tile else {273: offsets, 278: [rows], 279: sizes}
        packed = b""
        for tag, numbers in sorted(entries.items()):
            value = struct.pack(f"{order}{len(numbers)}I", *numbers)
            if len(value) > 4:
                place = len(data)
                data += value
                value = struct.pack(f"{order}I", place)
            packed += struct.pack(f"{order}HHI", tag, 4, len(numbers)) + value
        data += bytes(len(data) % 2)
        data[link : link + 4] = struct.pack(f"{order}I", len(data))
        data += struct.pack(f"{order}H", len(entries)) + packed
        link = len(data)
        data += struct.pack(f"{order}I", last if number == len(pages) - 1 else 0)
    return bytes(data)


def decoded(path: Path) -> list[np.ndarray]:
    return [decode_any(read_image(image)) for image in list_images(path)]


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("tile", [0, 16])
def test_every_page_is_an_image(tmp_path: Path, make: SimpleNamespace, order: str, tile: int) -> None:
    images = make.depth_codes(7)
    (tmp_path / "stack.tif").write_bytes(tiff(images, order, tile=tile))
    found = decoded(tmp_path)
    assert len(found) == 7
    for image, expected in zip(found, images, strict=True):
        np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize("compression", [1, 5, 8, 32773])
def test_pages_are_those_that_opencv_writes(tmp_path: Path, make: SimpleNamespace, compression: int) -> None:
    images = make.depth_codes(6)
    path = tmp_path / "stack.tiff"
    cv2.imwritemulti(str(path), images, [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    for image, expected in zip(decoded(tmp_path), images, strict=True):
        np.testing.assert_array_equal(image, expected)
    colour = [np.random.default_rng(k).integers(0, 255, (24, 32, 3), np.uint8) for k in range(5)]
    cv2.imwritemulti(str(path), colour, [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    for image, expected in zip(decoded(tmp_path), colour, strict=True):
        np.testing.assert_array_equal(image, expected)


def test_a_stack_of_depth_is_a_recording(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(16)
    cv2.imwritemulti(str(tmp_path / "stack.tif"), images)
    (tmp_path / "camera.toml").write_text(make.CAMERA_TOML)
    recording = open_recording(tmp_path, fps=30)
    assert recording.frame_count == 16
    frames = list(recording.frames())
    assert [frame.index for frame in frames] == list(range(16))
    assert [frame.stamp_ns for frame in frames] == [round(i * 1e9 / 30) for i in range(16)]
    for frame, image in zip(frames, images, strict=True):
        np.testing.assert_array_equal(frame.depth, image)
    assert recording.remarks == ("16 pages of stack.tif are read as frames",)
    lines = CliRunner().invoke(info, [str(tmp_path)], catch_exceptions=False).stdout.splitlines()
    assert lines[0].endswith(
        f": folder of 16 images, {(tmp_path / 'stack.tif').stat().st_size / 1000:.4g} kB"
    )
    assert lines[1].startswith("images: stack.tif page 1 to stack.tif page 16, 24x16, 16 bit")
    assert "16 pages of stack.tif are read as frames" in lines
    before = recording.identity()["sha256"]
    (tmp_path / "stack.tif").write_bytes((tmp_path / "stack.tif").read_bytes() + b"\0")
    assert open_recording(tmp_path, fps=30).identity()["sha256"] != before


def test_stacks_and_single_images_are_in_order(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(12)
    (tmp_path / "part_2.tif").write_bytes(tiff(images[:5]))
    (tmp_path / "part_3.tif").write_bytes(tiff(images[5:6]))
    (tmp_path / "part_10.tif").write_bytes(tiff(images[6:]))
    for image, expected in zip(decoded(tmp_path), images, strict=True):
        np.testing.assert_array_equal(image, expected)


def test_stacks_of_two_cameras_are_paired_page_by_page(tmp_path: Path) -> None:
    left, right = support.grey_images(6), support.grey_images(6, seed=1)
    for name, images in (("left", left), ("right", right)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "stack.tif").write_bytes(tiff(images))
    (tmp_path / "camera.toml").write_text(camera_file_text(support.rig()))
    frames = list(open_recording(tmp_path, "grey", fps=30).frames())
    assert len(frames) == 6
    for frame, one, two in zip(frames, left, right, strict=True):
        np.testing.assert_array_equal(frame.images[0], one)
        np.testing.assert_array_equal(frame.images[1], two)


def test_thumbnails_masks_and_pages_of_another_size_are_left_out(
    tmp_path: Path, make: SimpleNamespace
) -> None:
    images = make.depth_codes(3)
    small = images[0][::2, ::2].copy()
    pages = [small, images[0], images[0], images[1], small, images[2]]
    (tmp_path / "a.tif").write_bytes(tiff(pages, kinds=[THUMBNAIL, 0, MASK, 0, 0, 0]))
    (tmp_path / "camera.toml").write_text(make.CAMERA_TOML)
    recording = open_recording(tmp_path, fps=30)
    for frame, image in zip(recording.frames(), images, strict=True):
        np.testing.assert_array_equal(frame.depth, image)
    assert recording.remarks == (
        "3 pages of a.tif are read as frames",
        "skipped 1 pages of another size or kind in a.tif",
    )


def test_a_thumbnail_of_each_image_changes_nothing(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(3)
    for k, image in enumerate(images):
        pages = [image, image[::2, ::2].copy()]
        (tmp_path / f"{k}.tif").write_bytes(tiff(pages, kinds=[0, THUMBNAIL]))
    found = list_images(tmp_path)
    assert [image.name for image in found] == ["0.tif", "1.tif", "2.tif"]
    for image, expected in zip(decoded(tmp_path), images, strict=True):
        np.testing.assert_array_equal(image, expected)


def test_a_few_pages_of_each_of_several_files_are_channels(tmp_path: Path, make: SimpleNamespace) -> None:
    """Depth and amplitude of each frame: the first page is read, as it always was."""
    images = make.depth_codes(6)
    for k in range(3):
        (tmp_path / f"{k}.tif").write_bytes(tiff(images[2 * k : 2 * k + 2]))
    (tmp_path / "camera.toml").write_text(make.CAMERA_TOML)
    recording = open_recording(tmp_path, fps=30)
    for frame, image in zip(recording.frames(), images[::2], strict=True):
        np.testing.assert_array_equal(frame.depth, image)
    assert recording.remarks == ("each of 3 files has 2 pages: only the first is read",)


def test_a_page_is_read_alone(tmp_path: Path) -> None:
    """What a page takes does not grow with its file."""
    images = list(np.random.default_rng(0).integers(0, 999, (40, 60, 80)).astype(np.uint16))
    (tmp_path / "stack.tif").write_bytes(tiff(images))
    for image in list_images(tmp_path):
        assert len(read_image(image)) < images[0].nbytes + 1000


def test_damaged_pages_are_skipped(tmp_path: Path, make: SimpleNamespace) -> None:
    data = tiff(make.depth_codes(5))
    path = tmp_path / "stack.tif"
    path.write_bytes(data)
    (tmp_path / "camera.toml").write_text(make.CAMERA_TOML)
    recording = open_recording(tmp_path, fps=30)
    path.write_bytes(data[: len(data) // 2])
    assert 0 < len(list(recording.frames())) < 5
    (loss,) = recording.losses
    assert loss.count == 5 - len(list(recording.frames()))
    assert loss.first.startswith("frame ")
    assert "stack.tif page " in loss.first
    path.write_bytes(b"")
    assert list(recording.frames()) == []


def test_a_stack_that_was_cut_has_lost_frames(tmp_path: Path, make: SimpleNamespace) -> None:
    """Its writer was interrupted: the directory after the last whole page is not there."""
    data = tiff(make.depth_codes(5))
    path = tmp_path / "stack.tif"
    path.write_bytes(data)
    (tmp_path / "camera.toml").write_text(make.CAMERA_TOML)
    pages = find_pages(path)
    assert pages is not None
    path.write_bytes(data[: pages.images[3].offset])
    recording = open_recording(tmp_path, fps=30)
    assert [frame.index for frame in recording.frames()] == [0, 1, 2]
    (loss,) = recording.losses
    assert (loss.what, loss.first) == ("image skipped, page is damaged", "frame 3, stack.tif page 4")


def test_chains_that_come_back_or_leave_the_file_end(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(3)
    path = tmp_path / "a.tif"
    whole = tiff(images)
    path.write_bytes(whole)
    pages = find_pages(path)
    assert pages is not None
    assert [page.number for page in pages.images] == [0, 1, 2]
    for last in (pages.images[0].offset, pages.images[2].offset, len(whole) + 99, 2**32 - 1, 1):
        path.write_bytes(tiff(images, last=last))
        again = find_pages(path)
        assert again is not None
        assert again.images[:3] == pages.images
    for data in (b"", b"II*\0", b"II*\0\xff\xff\xff\xff", b"II*\0" + struct.pack("<I", 8) + b"\xff\xff"):
        path.write_bytes(data)
        assert find_pages(path) is None
    assert find_pages(tmp_path / "gone.tif") is None


def test_directories_that_overlap_are_not_followed_for_ever(tmp_path: Path) -> None:
    """Directories of 200 entries every few bytes, each of which claims the next one."""
    count, entries = 4000, 200
    words = np.zeros((count + entries * 6 + 10,), "<u2")
    words[:4] = np.frombuffer(b"II*\0" + struct.pack("<I", 8), "<u2")
    words[4:] = entries
    (tmp_path / "a.tif").write_bytes(words.tobytes())
    find_pages(tmp_path / "a.tif")
    with pytest.raises(UnreadableImageError):
        decode_any(read_image(list_images(tmp_path)[0]))


def test_pages_that_share_their_pixels_are_not_frames_without_end(tmp_path: Path) -> None:
    """A thousand pages of 100 bytes each that all show one strip of 30 kB."""
    data = bytearray(tiff([np.zeros((100, 150), np.uint16)], rows=100))
    first = int.from_bytes(data[4:8], "little")
    directory, link = bytes(data[first : len(data) - 4]), len(data) - 4
    for _ in range(1000):
        data[link : link + 4] = struct.pack("<I", len(data))
        data += directory + bytes(4)
        link = len(data) - 4
    (tmp_path / "a.tif").write_bytes(data)
    assert len(list_images(tmp_path)) < 2 * len(data) / 30_000 + 2


@pytest.mark.parametrize("count", [0, 1, 2**31, 2**32 - 1])
def test_values_that_are_not_there_take_no_memory(tmp_path: Path, make: SimpleNamespace, count: int) -> None:
    data = bytearray(tiff(make.depth_codes(2), rows=2))
    path = tmp_path / "a.tif"
    path.write_bytes(data)
    pages = find_pages(path)
    assert pages is not None
    at = pages.images[1].offset
    for k in range(int.from_bytes(data[at : at + 2], "little")):
        place = at + 2 + 12 * k
        if int.from_bytes(data[place : place + 2], "little") in (273, 279):
            data[place + 4 : place + 8] = struct.pack("<I", count)
    path.write_bytes(data)
    with pytest.raises(UnreadableImageError):
        decode_any(read_image(list_images(tmp_path)[1]))
