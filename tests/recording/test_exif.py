"""Focal lengths in the metadata of images and videos."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.exif import exif_numbers, focal_ratio_of_file, ratio_of_35_mm
from posetrack_cli.recording.opening import open_recording

SIZE = 90, 60
IMAGE = np.zeros(SIZE[::-1], np.uint8)


def jpeg(tags: dict[int, tuple[int, ...]], order: str = "<") -> bytes:
    """An image whose EXIF directory has numbers: two for a rational, else one."""
    begin = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8)
    pointer = struct.pack(f"{order}H", 1) + struct.pack(f"{order}HHII", 0x8769, 4, 1, 26) + bytes(4)
    after = 26 + 2 + 12 * len(tags) + 4
    entries, rationals = b"", b""
    for tag, value in tags.items():
        if len(value) == 2:
            entries += struct.pack(f"{order}HHII", tag, 5, 1, after + len(rationals))
            rationals += struct.pack(f"{order}II", *value)
        else:
            entries += struct.pack(f"{order}HHIHxx", tag, 3, 1, *value)
    block = (
        b"Exif\0\0" + begin + pointer + struct.pack(f"{order}H", len(tags)) + entries + bytes(4) + rationals
    )
    data = cv2.imencode(".jpg", IMAGE)[1].tobytes()
    return data[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + data[2:]


@pytest.mark.parametrize("order", "<>")
def test_the_equivalent_for_35_mm_has_the_same_diagonal_field_of_view(order: str) -> None:
    # a lens of 36 mm on film 36 mm wide, images of the film's shape
    assert focal_ratio_of_file(jpeg({0xA405: (36,)}, order), *SIZE) == pytest.approx(1.0)


def test_focal_length_and_density_of_the_sensor() -> None:
    # 5 mm, 4000 pixels of 1/640 mm: a sensor 6.25 mm wide
    tags = {0x920A: (50, 10), 0xA20E: (6400, 1), 0xA210: (3,), 0xA002: (4000,), 0xA003: (2667,)}
    assert focal_ratio_of_file(jpeg(tags), *SIZE) == pytest.approx(0.8, rel=1e-3)


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {0xA405: (0,)},
        {0x920A: (5, 1)},
        {0x920A: (5, 0)},
        {0xA405: (36,), 0xA002: (4000,), 0xA003: (3000,)},
    ],
    ids=["none", "unknown", "no sensor", "damaged", "cropped"],
)
def test_no_focal_length(tags: dict[int, tuple[int, ...]]) -> None:
    assert focal_ratio_of_file(jpeg(tags), *SIZE) is None


@given(st.binary(max_size=200), st.sampled_from([b"II*\0", b"MM\0*", b"\xff\xd8\xff\xe1\0\xc8Exif\0\0II*\0"]))
def test_no_bytes_make_it_fail(data: bytes, begin: bytes) -> None:
    assert all(np.isfinite(value) for _, value in exif_numbers(begin + data).values())
    focal_ratio_of_file(begin + data, *SIZE)


def test_a_folder_of_photos_states_its_focal_length(tmp_path: Path) -> None:
    for index in range(2):
        (tmp_path / f"{index}.jpg").write_bytes(jpeg({0xA405: (27,)}))
    recording = open_recording(tmp_path, "grey", fps=30.0, guess=Guess())
    assert recording.stated_focal == pytest.approx(0.75)


def test_a_video_of_a_phone_states_its_focal_length(tmp_path: Path) -> None:
    import av

    path = tmp_path / "phone.mov"
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata["com.apple.quicktime.camera.focal_length.35mm_equivalent"] = "26"
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, 54, "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.zeros((54, 96, 3), np.uint8), "bgr24")
        for packet in (*stream.encode(frame), *stream.encode()):
            container.mux(packet)
    recording = open_recording(path, "grey", guess=Guess())
    assert recording.stated_focal == ratio_of_35_mm(26.0, 96, 54) == pytest.approx(0.689, abs=1e-3)
