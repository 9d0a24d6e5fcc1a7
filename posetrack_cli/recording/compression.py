"""Decompression of depth: RVL and LZFSE."""

from __future__ import annotations

from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.recording.base import UnreadableImageError

# RVL, a run-length code for 16-bit depth that ROS's compressedDepth supports next to PNG
#
# A. D. Wilson, Fast Lossless Depth Image Compression, 2017. An image is a sequence of run pairs: the number
# of pixels without a reading, the number with one, and for each of the latter the difference to the previous
# reading. Numbers are split into groups of three bits, lowest first, each with a fourth bit that is set if
# another group follows. The nibbles fill little-endian 32-bit words from the top.

_LONGEST_BITS = 27  # bits of a number, above any pixel count or depth difference
_WHOLE, _CUT, _DAMAGED = 0, 1, 2


def decode_rvl(data: bytes, width: int, height: int) -> ImageArray:
    """Return the (height, width) uint16 codes of an RVL image.

    Raises:
        UnreadableImageError: the image exceeds ``limits``, or the data are truncated or damaged.
    """
    if not width * height:
        raise UnreadableImageError("image is empty")
    if width * height > limits.IMAGE_PIXELS:
        raise UnreadableImageError(f"image has more than {limits.IMAGE_PIXELS} pixels")
    codes = np.zeros(width * height, np.uint16)
    words = np.frombuffer(data[: len(data) // 4 * 4], "<u4").astype(np.uint32)
    state = _decode_rvl(words, codes)
    if state != _WHOLE:
        raise UnreadableImageError("image is incomplete" if state == _CUT else "image is damaged")
    return codes.reshape(height, width)


@inlined
def _number(words: ImageArray, nibble: int) -> tuple[int, int]:
    """Return a number and the position of the next one; -1 if truncated, -2 if too long."""
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
def _decode_rvl(words: ImageArray, codes: ImageArray) -> int:
    """Fill the codes of an image, initially zero; return its state."""
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
            codes[at] = code & 0xFFFF  # wraps like the encoder's 16-bit arithmetic
        pixel += count
    return _WHOLE


# LZFSE, Apple's compression: Lempel-Ziv matches and literals with finite state entropy coding
#
# A stream is a sequence of blocks: ``bvx-`` holds raw bytes, ``bvx2`` compressed ones, ``bvx$`` ends it.
# ``bvxn``, which Apple's encoder writes below 4 kB only, is not supported. A compressed block has frequency
# tables, literals, and triples: number of literals, length and distance of the match. Both bit streams are
# read backwards.


_RAW, _COMPRESSED, _END = 0x2D787662, 0x32787662, 0x24787662
_HEADER = 32  # bytes of a compressed block before its tables
# A block has at most 40,000 literals and a quarter as many triples; literals come in fours. Larger counts
# mean damage and would cost time without output.
_MOST_LITERALS, _MOST_MATCHES_TO_LITERALS, _SPARE_LITERALS = 40_000, 4, 3
_EXPANSION = 2  # encoders store incompressible data raw, so no valid stream is longer than this
# Extra bits per symbol: literal count, match length, distance; none for literals
_TAKEN_BITS = np.array([0] * 16 + [2, 3, 5, 8])
_COPIED_BITS = np.array([0] * 16 + [3, 5, 8, 11])
_BACK_BITS = np.repeat(np.arange(16), 4)
_LITERAL_BITS = np.zeros(256, np.int64)
# Code length and value of a frequency by its lowest five bits; longer codes add the bits above four.
_CODE_BITS = np.array([2, 3, 2, 5, 2, 3, 2, 8, 2, 3, 2, 5, 2, 3, 2, 14] * 2)
_CODED = np.array(
    [0, 2, 1, 4, 0, 3, 1, 8, 0, 2, 1, 5, 0, 3, 1, 24, 0, 2, 1, 6, 0, 3, 1, 8, 0, 2, 1, 7, 0, 3, 1, 24]
)


def decode_lzfse(data: bytes, size: int) -> bytes:
    """Return the ``size`` bytes of a stream.

    Raises:
        UnreadableImageError: the stream is truncated, damaged, or of another size.
    """
    out = np.zeros(size, np.uint8)
    if len(data) > _EXPANSION * size + _HEADER or not _decode_lzfse(np.frombuffer(data, np.uint8), out):
        raise UnreadableImageError("image is damaged")
    return out.tobytes()


@inlined
def _bits(data: ImageArray, position: int, count: int) -> int:
    """Return up to 32 bits starting at a bit position, the first one lowest."""
    byte = position >> 3
    value: Any = np.int64(0)
    for i in range(5):
        if 0 <= byte + i < len(data):
            value |= np.int64(data[byte + i]) << (8 * i)
    found: int = (value >> (position & 7)) & ((np.int64(1) << count) - 1)
    return found


@kernel
def _table(frequencies: ImageArray, extra: ImageArray, states: int) -> ImageArray:
    """Return a row per state: bits to read, state base, extra bits of these, value base.

    The first row's bits are negative if the frequencies do not sum to ``states``.
    """
    table = np.zeros((states, 4), np.int64)
    state, base = 0, np.int64(0)
    for symbol in range(len(frequencies)):
        count = frequencies[symbol]
        if state + count > states:
            table[0, 0] = -1
            return table
        shift = 0
        while 0 < count << shift < states:
            shift += 1
        few = ((2 * states) >> shift) - count
        for j in range(count):
            if j < few:
                table[state, 0], table[state, 1] = shift, ((count + j) << shift) - states
            else:
                table[state, 0], table[state, 1] = shift - 1, (j - few) << (shift - 1)
            table[state, 0] += extra[symbol]
            table[state, 2], table[state, 3] = extra[symbol], base
            state += 1
        base += np.int64(1) << extra[symbol]
    return table


@inlined
def _value(data: ImageArray, position: int, state: int, table: ImageArray) -> tuple[int, int, int]:
    """Return a value, and the bit position and state after it."""
    count, plain = table[state, 0], table[state, 2]
    position -= count
    read = _bits(data, position, count)
    return (
        table[state, 3] + (read & ((np.int64(1) << plain) - 1)),
        position,
        table[state, 1] + (read >> plain),
    )


@kernel
def _frequencies(data: ImageArray, at: int, end: int) -> ImageArray:
    """Return the frequencies of 20, 20, 64 and 256 symbols; the first is -1 if the length is wrong."""
    frequencies = np.zeros(360, np.int64)
    position = 8 * at
    for i in range(360 if end > at else 0):
        code = _bits(data, position, 14)
        length = _CODE_BITS[code & 31]
        frequencies[i] = _CODED[code & 31]
        if length >= 8:
            frequencies[i] += (code & ((1 << length) - 1)) >> 4
        position += length
    if not 0 <= 8 * end - position < 8:
        frequencies[0] = -1
    return frequencies


@kernel
def _literals(data: ImageArray, at: int, begin: int, end: int, table: ImageArray) -> ImageArray:
    """Return the literals of a block, coded between two bytes; empty if the length is wrong."""
    literals = np.zeros(_bits(data, 8 * at + 64, 20), np.uint8)
    position = 8 * end + _bits(data, 8 * at + 124, 3) - 7
    states = np.array([_bits(data, 8 * at + 128 + 10 * i, 10) for i in range(4)])
    for i in range(len(literals)):
        literals[i], position, states[i & 3] = _value(data, position, states[i & 3], table)
        if position < 8 * begin:
            return literals[:0]
    return literals


@kernel
def _copy(
    data: ImageArray,
    at: int,
    begin: int,
    end: int,
    tables: tuple[ImageArray, ...],
    literals: ImageArray,
    out: ImageArray,
    filled: int,
) -> int:
    """Execute the triples of a block, coded between two bytes; return the output length, or -1."""
    position = 8 * end + _bits(data, 8 * at + 188, 3) - 7
    taken_state, copied_state = _bits(data, 8 * at + 224, 10) & 63, _bits(data, 8 * at + 234, 10) & 63
    back_state = _bits(data, 8 * at + 244, 10) & 255
    back: Any = np.int64(0)
    used = 0
    for _ in range(_bits(data, 8 * at + 104, 20)):
        taken, position, taken_state = _value(data, position, taken_state, tables[0])
        copied, position, copied_state = _value(data, position, copied_state, tables[1])
        other, position, back_state = _value(data, position, back_state, tables[2])
        back = other if other else back
        is_work = taken + copied > 0 and position >= 8 * begin
        if not is_work or used + taken > len(literals) or filled + taken + copied > len(out):
            return -1
        for i in range(taken):
            out[filled + i] = literals[used + i]
        used += taken
        filled += taken
        if copied and not 0 < back <= filled:
            return -1
        for _ in range(copied):
            out[filled] = out[filled - back]
            filled += 1
    return filled if len(literals) - used <= _SPARE_LITERALS else -1


@kernel
def _decode_block(data: ImageArray, at: int, out: ImageArray, filled: int) -> tuple[int, int]:
    """Decode a compressed block; return the position of the next and the output length, or -1."""
    counts = max(_bits(data, 8 * at + 64, 20), _MOST_MATCHES_TO_LITERALS * _bits(data, 8 * at + 104, 20))
    first = at + _bits(data, 8 * at + 192, 32)
    second = first + _bits(data, 8 * at + 84, 20)
    end = second + _bits(data, 8 * at + 168, 20)
    if first < at + _HEADER or end > len(data) or counts > _MOST_LITERALS:
        return end, -1
    frequencies = _frequencies(data, at + _HEADER, first)
    tables = (
        _table(frequencies[:20], _TAKEN_BITS, 64),
        _table(frequencies[20:40], _COPIED_BITS, 64),
        _table(frequencies[40:104], _BACK_BITS, 256),
    )
    literal_table = _table(frequencies[104:], _LITERAL_BITS, 1024)
    least = min(tables[0][0, 0], tables[1][0, 0], tables[2][0, 0], literal_table[0, 0], frequencies[0])
    if least < 0:
        return end, -1
    literals = _literals(data, at, first, second, literal_table)
    return end, _copy(data, at, second, end, tables, literals, out, filled)


@kernel
def _decode_lzfse(data: ImageArray, out: ImageArray) -> bool:
    """Fill the output; return whether the stream holds exactly that many bytes."""
    at, filled = 0, 0
    while at + 4 <= len(data):
        magic = _bits(data, 8 * at, 32)
        if magic == _END:
            return filled == len(out)
        if magic == _RAW:
            count = _bits(data, 8 * at + 32, 32)
            if count > len(data) - at - 8 or count > len(out) - filled:
                return False
            out[filled : filled + count] = data[at + 8 : at + 8 + count]
            filled += count
            at += 8 + count
        elif magic == _COMPRESSED and at + _HEADER <= len(data):
            at, filled = _decode_block(data, at, out, filled)
            if filled < 0:
                return False
        else:
            return False
    return False
