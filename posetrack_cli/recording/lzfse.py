"""LZFSE, Apple's compression, as apps use it for images: matches and literals, coded by finite state entropy.

A stream is a row of blocks: ``bvx-`` holds bytes as they are, ``bvx2`` compressed ones, ``bvx$`` ends it.
``bvxn``, which Apple's encoder writes for less than 4 kB only, is not read. A compressed block has tables of
frequencies, then literals, then triples: how many literals, how many bytes to copy, from how far back. Literals
and triples are each read from the last bit to the first.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.recording.base import UnreadableImageError

_RAW, _COMPRESSED, _END = 0x2D787662, 0x32787662, 0x24787662
_HEADER = 32
"""Bytes of a compressed block before its tables."""
_MOST_LITERALS, _MOST_MATCHES, _SPARE_LITERALS = 40_000, 10_000, 3
"""Of a block; literals come in fours. A block that makes more work than output is damaged."""
_EXPANSION = 2
"""Of data that do not compress, which encoders store as they are."""
_TAKEN_BITS = np.array([0] * 16 + [2, 3, 5, 8])
_COPIED_BITS = np.array([0] * 16 + [3, 5, 8, 11])
_BACK_BITS = np.repeat(np.arange(16), 4)
_LITERAL_BITS = np.zeros(256, np.int64)
"""Plain bits behind each symbol: of how many literals, how many bytes to copy, how far back; of literals none."""
_CODE_BITS = np.array([2, 3, 2, 5, 2, 3, 2, 8, 2, 3, 2, 5, 2, 3, 2, 14] * 2)
_CODED = np.array(
    [0, 2, 1, 4, 0, 3, 1, 8, 0, 2, 1, 5, 0, 3, 1, 24, 0, 2, 1, 6, 0, 3, 1, 8, 0, 2, 1, 7, 0, 3, 1, 24]
)
"""Bits of a frequency's code and the frequency, by the lowest five; codes of 8 and 14 bits add those above four."""


def decode_lzfse(data: bytes, size: int) -> bytes:
    """Return the ``size`` bytes that a stream holds.

    Raises:
        UnreadableImageError: it is cut or damaged, or holds more or fewer.
    """
    out = np.zeros(size, np.uint8)
    if len(data) > _EXPANSION * size + _HEADER or not _decode(np.frombuffer(data, np.uint8), out):
        raise UnreadableImageError("image is damaged")
    return out.tobytes()


@inlined
def _bits(data: ImageArray, position: int, count: int) -> int:
    """Return up to 32 bits from a position in bits on, the first one lowest."""
    byte = position >> 3
    value = np.int64(0)
    for i in range(5):
        if 0 <= byte + i < len(data):
            value |= np.int64(data[byte + i]) << (8 * i)
    return (value >> (position & 7)) & ((np.int64(1) << count) - 1)


@kernel
def _table(frequencies: ImageArray, extra: ImageArray, states: int) -> ImageArray:
    """Return a row for each state: bits to read, state to add to, plain bits of these, value to add to.

    The first row's bits are negative if the frequencies are not those of so many states.
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
    """Return a value, and the position and the state after it."""
    count, plain = table[state, 0], table[state, 2]
    position -= count
    read = _bits(data, position, count)
    return (
        table[state, 3] + (read & ((np.int64(1) << plain) - 1)),
        position,
        table[state, 1] + (read >> plain),
    )


@kernel
def _decode_block(data: ImageArray, at: int, out: ImageArray, filled: int) -> tuple[int, int]:
    """Decode the compressed block at a byte; return where the next begins and how much is filled, or -1."""
    begin = 8 * at
    literal_count, literal_bytes = _bits(data, begin + 64, 20), _bits(data, begin + 84, 20)
    match_count, literal_pad = _bits(data, begin + 104, 20), _bits(data, begin + 124, 3) - 7
    match_bytes, match_pad = _bits(data, begin + 168, 20), _bits(data, begin + 188, 3) - 7
    tables = at + _bits(data, begin + 192, 32)
    taken_state, copied_state = _bits(data, begin + 224, 10), _bits(data, begin + 234, 10)
    back_state = _bits(data, begin + 244, 10)
    literals_end = tables + literal_bytes
    end = literals_end + match_bytes
    if (
        tables < at + _HEADER
        or end > len(data)
        or literal_count > _MOST_LITERALS
        or match_count > _MOST_MATCHES
    ):
        return -1, filled
    if taken_state > 63 or copied_state > 63 or back_state > 255:
        return -1, filled

    frequencies = np.zeros(360, np.int64)
    position = begin + 8 * _HEADER
    for i in range(360):
        code = _bits(data, position, 14)
        length = _CODE_BITS[code & 31]
        frequencies[i] = _CODED[code & 31]
        if length >= 8:
            frequencies[i] += (code & ((1 << length) - 1)) >> 4
        position += length
    if tables > at + _HEADER and (position > 8 * tables or 8 * tables - position >= 8):
        return -1, filled
    taken_table = _table(frequencies[:20], _TAKEN_BITS, 64)
    copied_table = _table(frequencies[20:40], _COPIED_BITS, 64)
    back_table = _table(frequencies[40:104], _BACK_BITS, 256)
    literal_table = _table(frequencies[104:], _LITERAL_BITS, 1024)
    if min(taken_table[0, 0], copied_table[0, 0], back_table[0, 0], literal_table[0, 0]) < 0:
        return -1, filled

    literals = np.zeros(literal_count, np.uint8)
    position = 8 * literals_end + literal_pad
    states = np.zeros(4, np.int64)
    for i in range(4):
        states[i] = _bits(data, begin + 128 + 10 * i, 10)
    for i in range(literal_count):
        literals[i], position, states[i & 3] = _value(data, position, states[i & 3], literal_table)
        if position < 8 * tables:
            return -1, filled

    position = 8 * end + match_pad
    used, back = 0, np.int64(0)
    for _ in range(match_count):
        taken, position, taken_state = _value(data, position, taken_state, taken_table)
        copied, position, copied_state = _value(data, position, copied_state, copied_table)
        other, position, back_state = _value(data, position, back_state, back_table)
        back = other if other else back
        is_work = taken + copied > 0 and position >= 8 * literals_end
        if not is_work or used + taken > literal_count or filled + taken + copied > len(out):
            return -1, filled
        for i in range(taken):
            out[filled + i] = literals[used + i]
        used += taken
        filled += taken
        if copied and not 0 < back <= filled:
            return -1, filled
        for _ in range(copied):
            out[filled] = out[filled - back]
            filled += 1
    return (end if literal_count - used <= _SPARE_LITERALS else -1), filled


@kernel
def _decode(data: ImageArray, out: ImageArray) -> bool:
    """Fill the output; return whether the stream holds exactly so much."""
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
            if at < 0:
                return False
        else:
            return False
    return False
