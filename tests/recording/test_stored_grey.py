"""Grey of PNG with palettes, transparency and few bits, and of video with more than eight bits."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.grey import decode_shown, grey_like
from posetrack_cli.recording.opening import describe, open_recording

Array = np.ndarray[Any, Any]
SIDE = 8
ROUNDING = 1
"""Grey levels: libpng and OpenCV round the luma of colours differently."""
GREY, RGB, PALETTE, GREY_ALPHA, RGBA = 0, 2, 3, 4, 6
"""Colour types of PNG."""


def png(values: Array, bits: int, colour: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """Return a PNG of values (height, width, channels), packed by the published layout."""
    height, width = values.shape[:2]
    rows = []
    for row in values.reshape(height, -1):
        text = "".join(format(int(value), f"0{bits}b") for value in row)
        text += "0" * (-len(text) % 8)
        rows.append(b"\0" + int(text, 2).to_bytes(len(text) // 8, "big"))
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    parts = [(b"IHDR", head), *chunks, (b"IDAT", zlib.compress(b"".join(rows))), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )


def grey_of_file(data: bytes, where: object = "image") -> Array:
    return grey_like(decode_shown(data), where).from_file(data, where)


def random_values(bits: int, channels: int = 1) -> Array:
    values = np.random.default_rng(bits).integers(0, 1 << bits, (SIDE, SIDE, channels))
    values[0, 0] = (1 << bits) - 1  # so that all bits are significant
    return values


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
@pytest.mark.parametrize("transparent", [False, True])
def test_grey_of_few_bits_spans_black_to_white(bits: int, transparent: bool) -> None:
    values = random_values(bits)
    chunks = [(b"tRNS", struct.pack(">H", int(values[0, 0, 0])))] if transparent else []
    found = grey_of_file(png(values, bits, GREY, *chunks))
    np.testing.assert_array_equal(found, values[..., 0] * 255 // ((1 << bits) - 1))


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
@pytest.mark.parametrize("transparent", [False, True])
def test_palettes_give_the_luma_of_their_colours(bits: int, transparent: bool) -> None:
    """Transparent colours are those that are stored, not black or white."""
    values = random_values(bits)
    palette = np.random.default_rng(9).integers(0, 256, (1 << bits, 3)).astype(np.uint8)
    chunks = [(b"PLTE", palette.tobytes())]
    chunks += [(b"tRNS", bytes(len(palette)))] if transparent else []
    found = grey_of_file(png(values, bits, PALETTE, *chunks))
    expected = cv2.cvtColor(palette[values[..., 0]], cv2.COLOR_RGB2GRAY)
    np.testing.assert_allclose(found, expected.astype(int), atol=ROUNDING)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("opacity", [0, 128, 255])
def test_alpha_does_not_change_the_grey(bits: int, opacity: int) -> None:
    values = random_values(bits)
    alpha = np.full_like(values, opacity)
    for colour, stored in (
        (GREY_ALPHA, np.dstack([values, alpha])),
        (RGBA, np.dstack([values, values, values, alpha])),
    ):
        found = grey_of_file(png(stored, bits, colour))
        np.testing.assert_array_equal(found, values[..., 0] >> bits - 8)


def test_colour_of_sixteen_bits() -> None:
    values = random_values(16, 3)
    luma = cv2.cvtColor(values.astype(np.uint16), cv2.COLOR_RGB2GRAY) >> 8
    np.testing.assert_allclose(grey_of_file(png(values, 16, RGB)), luma.astype(int), atol=ROUNDING)


# Video

STEPS = 8
LIMITED, FULL, PQ, BT2020 = 1, 2, 16, 9
"""Numbers of FFmpeg: ranges of luma, the brightness curve of HDR10, its colours."""
CUT_BITS = 2.0
"""Grey levels: a quantisation of luma, a conversion that cuts bits instead of rounding them."""


def steps_video(path: Path, codec: str, format_name: str, *, bits: int, full: bool, pq: bool = False) -> Path:
    """Write three frames of eight grey steps from black to white (48, 128), without colour."""
    import av

    levels = np.repeat(np.linspace(0.0, 1.0, STEPS), 128 // STEPS)
    scale = 1 << bits - 8
    luma = np.round(levels * ((1 << bits) - 1) if full else (16 + 219 * levels) * scale)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = 128, 48, format_name
        stream.options = {"qp": "0", "x265-params": "log-level=none"} if codec.startswith("lib") else {}
        stream.codec_context.color_range = FULL if full else LIMITED
        if pq:
            stream.codec_context.color_trc = PQ
            stream.codec_context.color_primaries = stream.codec_context.colorspace = BT2020
        for number in range(3):
            frame = av.VideoFrame(128, 48, format_name)
            frame.pts, frame.color_range = number, FULL if full else LIMITED
            for k, plane in enumerate(frame.planes):
                rows = np.full((plane.height, plane.line_size // 2), 1 << bits - 1, "<u2")
                if k == 0:
                    rows[:, :128] = luma
                plane.update(rows.tobytes())
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("name", "codec", "format_name", "bits", "full"),
    [
        ("v.mp4", "libx264", "yuv420p10le", 10, False),
        ("v.mp4", "libx264", "yuv420p10le", 10, True),
        ("v.mp4", "libx265", "yuv420p12le", 12, False),
        ("v.mkv", "ffv1", "gray10le", 10, True),
        ("v.mkv", "ffv1", "gray12le", 12, True),
        ("v.mkv", "ffv1", "gray16le", 16, True),
    ],
)
def test_videos_of_more_bits_span_black_to_white(
    tmp_path: Path, name: str, codec: str, format_name: str, bits: int, full: bool
) -> None:
    path = steps_video(tmp_path / name, codec, format_name, bits=bits, full=full)
    recording = open_recording(path, "grey", guess=Guess())
    image = next(iter(recording.frames())).images[0]
    assert image is not None and recording.remarks == ()
    middles = image[24, 8 :: 128 // STEPS].astype(float)
    np.testing.assert_allclose(middles, np.linspace(0.0, 255.0, STEPS), atol=CUT_BITS)


def test_hdr_is_used_as_it_is_coded_and_reported(tmp_path: Path) -> None:
    path = steps_video(tmp_path / "v.mp4", "libx265", "yuv420p10le", bits=10, full=False, pq=True)
    recording = open_recording(path, "grey", guess=Guess())
    image = next(iter(recording.frames())).images[0]
    assert image is not None
    middles = image[24, 8 :: 128 // STEPS].astype(float)
    np.testing.assert_allclose(middles, np.linspace(0.0, 255.0, STEPS), atol=CUT_BITS)
    remark = "video is HDR (PQ): coded brightness is used without tone mapping"
    assert recording.remarks == tuple(describe(path)["remarks"]) == (remark,)
