"""Image files that are damaged: told by an exception, and by nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.recording.image_files import decode_codes, encode_png
from posetrack_cli.recording.stored import UnreadableImageError

CODES = np.random.default_rng(0).integers(0, 999, (30, 40)).astype(np.uint16)


def damaged() -> list[bytes]:
    """A PNG with one bit flipped, everywhere behind the signature; and cut, also right before its end."""
    whole = encode_png(CODES)
    images = [whole[:cut] for cut in (9, 20, 60, len(whole) // 2, len(whole) - 12, len(whole) - 1)]
    for position in range(8, len(whole), 31):
        flipped = bytearray(whole)
        flipped[position] ^= 0x10
        images.append(bytes(flipped))
    return images


def test_a_whole_image_is_decoded() -> None:
    np.testing.assert_array_equal(decode_codes(encode_png(CODES), "x"), CODES)


def test_every_damage_is_found_and_no_library_prints_about_it(capfd: pytest.CaptureFixture[str]) -> None:
    for data in damaged():
        with pytest.raises(UnreadableImageError):
            decode_codes(data, "x")
    assert capfd.readouterr() == ("", "")
