"""LZFSE against bytes of Apple's encoder, and what damage does."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.compression import decode_lzfse
from support.datasets import LZFSE_DEPTH, LZFSE_LEVELS, lzfse_as_stored, r3d_depth, r3d_levels


@pytest.mark.parametrize(
    ("stream", "content"),
    [
        (LZFSE_DEPTH, r3d_depth().tobytes()),
        (LZFSE_LEVELS, r3d_levels().tobytes()),
        (lzfse_as_stored(b"posetrack"), b"posetrack"),
        (LZFSE_DEPTH[:-4] + lzfse_as_stored(b"more"), r3d_depth().tobytes() + b"more"),
        # matches of a block may reach back to the block before it; here none do
        (LZFSE_LEVELS[:-4] + LZFSE_DEPTH, r3d_levels().tobytes() + r3d_depth().tobytes()),
        (b"bvx$", b""),
    ],
)
def test_streams_are_decoded(stream: bytes, content: bytes) -> None:
    assert decode_lzfse(stream, len(content)) == content


@pytest.mark.parametrize("size", [0, 1, r3d_depth().nbytes - 1, r3d_depth().nbytes + 1])
def test_another_size_is_refused(size: int) -> None:
    with pytest.raises(UnreadableImageError, match="damaged"):
        decode_lzfse(LZFSE_DEPTH, size)


@pytest.mark.parametrize("keep", [0, 3, 4, 31, 32, 60, 300, len(LZFSE_DEPTH) - 5, len(LZFSE_DEPTH) - 1])
def test_a_cut_stream_is_refused(keep: int) -> None:
    with pytest.raises(UnreadableImageError, match="damaged"):
        decode_lzfse(LZFSE_DEPTH[:keep], r3d_depth().nbytes)


def test_damage_changes_no_more_than_the_image() -> None:
    random, content = np.random.default_rng(0), r3d_depth()
    refused = 0
    for _ in range(300):
        data = bytearray(LZFSE_DEPTH)
        data[random.integers(4, len(data))] = random.integers(256)
        try:
            assert len(decode_lzfse(bytes(data), content.nbytes)) == content.nbytes
        except UnreadableImageError:
            refused += 1
    assert refused > 30  # counts and frequencies are checked, the content itself has no checksum


@pytest.mark.parametrize(
    "stream",
    [
        b"bvxn" + struct.pack("<II", 9, 9) + bytes(9) + b"bvx$",
        b"bvx1" + bytes(800),
        b"bvx-" + struct.pack("<I", 1 << 31) + bytes(9),
        b"bvx2" + b"\xff" * 200,
        b"bvx2" + bytes(28) + b"bvx$",
        b"bvx-\0\0\0\0" * 9 + bytes(4),
        bytes(100),
    ],
)
def test_what_is_not_such_a_stream_is_refused(stream: bytes) -> None:
    with pytest.raises(UnreadableImageError, match="damaged"):
        decode_lzfse(stream, 9)
