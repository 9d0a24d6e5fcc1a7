"""RVL, the run-length code of 16-bit depth images that ROS's compressedDepth uses besides PNG.

A. D. Wilson, Fast Lossless Depth Image Compression, 2017. An image is a sequence of pairs of runs: a number
of pixels without a reading, a number of pixels with one, and for each of these the difference to the reading
before it. Numbers are split into groups of three bits, the lowest first, each with a fourth bit that is set
if another group follows. These nibbles fill little-endian words of 32 bits from the top.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.recording.base import UnreadableImageError

_LONGEST_BITS = 27
"""Of a number, in groups of three: more than every number of pixels and every difference of an image has."""
_WHOLE, _CUT, _DAMAGED = 0, 1, 2


def decode_rvl(data: bytes, width: int, height: int) -> ImageArray:
    """Return the (height, width) uint16 codes of an image that words hold.

    Raises:
        UnreadableImageError: the image is larger than any that is read, or the data are cut or damaged.
    """
    if not width * height:
        raise UnreadableImageError("image is empty")
    if width * height > limits.IMAGE_PIXELS:
        raise UnreadableImageError(f"image has more than {limits.IMAGE_PIXELS} pixels")
    codes = np.zeros(width * height, np.uint16)
    words = np.frombuffer(data[: len(data) // 4 * 4], "<u4").astype(np.uint32)
    state = _decode(words, codes)
    if state != _WHOLE:
        raise UnreadableImageError("image is incomplete" if state == _CUT else "image is damaged")
    return codes.reshape(height, width)


@inlined
def _number(words: ImageArray, nibble: int) -> tuple[int, int]:
    """Return a number and where the next begins; -1 if it is cut, -2 if it is longer than any."""
    value: Any = 0
    shift = 0
    while nibble < 8 * len(words):
        bits = (words[nibble >> 3] >> np.uint32(28 - 4 * (nibble & 7))) & np.uint32(15)
        nibble += 1
        value |= np.int64(bits & np.uint32(7)) << shift
        if bits < 8:
            return value, nibble
        shift += 3
        if shift >= _LONGEST_BITS:
            return -2, nibble
    return -1, nibble


@kernel
def _decode(words: ImageArray, codes: ImageArray) -> int:
    """Fill the codes of an image, zero before; return whether the words hold it."""
    pixel, nibble, code = 0, 0, 0
    while pixel < len(codes):
        empty, nibble = _number(words, nibble)
        count, nibble = _number(words, nibble)
        if empty < 0 or count < 0:
            return _CUT if -1 in (empty, count) else _DAMAGED
        pixel += empty
        if pixel + count > len(codes):
            return _DAMAGED
        for at in range(pixel, pixel + count):
            folded, nibble = _number(words, nibble)
            if folded < 0:
                return _CUT if folded == -1 else _DAMAGED
            code += (folded >> 1) ^ -(folded & 1)
            codes[at] = code & 0xFFFF  # as the encoder's 16-bit numbers, it wraps
        pixel += count
    return _WHOLE
