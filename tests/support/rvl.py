"""RVL as its paper describes it, written digit by digit: slow, and nothing like the decoder."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np


def nibbles(number: int) -> str:
    """Hexadecimal digits of a number: its octal digits from the last, 8 more where another follows."""
    digits = [int(digit) for digit in reversed(f"{number:o}")]
    return "".join(f"{digit + 8 * (place < len(digits) - 1):x}" for place, digit in enumerate(digits))


def encoded(codes: np.ndarray) -> bytes:
    """The paper's code, by strings: size, then words of eight digits."""
    text = "".join(runs([int(code) for code in codes.ravel()]))
    text += "0" * (-len(text) % 8)
    words = [int(text[i : i + 8], 16) for i in range(0, len(text), 8)]
    return struct.pack("<II", codes.shape[1], codes.shape[0]) + struct.pack(f"<{len(words)}I", *words)


def runs(codes: list[int]) -> Iterator[str]:
    previous = 0
    while codes:
        empty = next((i for i, code in enumerate(codes) if code), len(codes))
        rest = codes[empty:]
        count = next((i for i, code in enumerate(rest) if not code), len(rest))
        yield nibbles(empty) + nibbles(count)
        for code in rest[:count]:
            difference = code - previous
            yield nibbles(2 * difference if difference >= 0 else -2 * difference - 1)
            previous = code
        codes = rest[count:]
