"""Lines of text below pictures."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.evaluation.viewing.colours import Colour

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SIZE, _SMALLEST = 0.45, 0.33
_LINE_PX, _BASE_PX, _LEFT_PX, _GAP_PX = 18, 13, 4, 14
_GROUND: Colour = (24, 24, 24)


def caption(lines: Sequence[tuple[Sequence[str], Colour]], width: int) -> ImageArray:
    """Lines of words (one after the other, with gaps) as a picture (18 per line, width, 3).

    Every line is written on one row, smaller if it must be, so pictures of one width are equally high.
    What still does not fit is cut off. Characters that the font lacks are written as ``?``.
    """
    picture = np.full((_LINE_PX * len(lines), width, 3), _GROUND, dtype=np.uint8)
    for number, (words, colour) in enumerate(lines):
        _write(picture, [_plain(word) for word in words], number * _LINE_PX + _BASE_PX, colour)
    return picture


def _write(picture: ImageArray, words: list[str], base: int, colour: Colour) -> None:
    free = picture.shape[1] - 2 * _LEFT_PX
    length = sum(_length(word) for word in words)
    gaps = max(0, len(words) - 1)
    shrunk = min(1.0, free / (length + gaps * _GAP_PX)) if length else 1.0
    size = max(_SMALLEST, _SIZE * shrunk)
    left = float(_LEFT_PX)
    for word in words:
        cv2.putText(picture, word, (round(left), base), _FONT, size, colour, 1, cv2.LINE_AA)
        left += (_length(word) + _GAP_PX) * size / _SIZE


@lru_cache(maxsize=4096)
def _length(word: str) -> int:
    """Width at the usual size, pixels."""
    (width, _), _ = cv2.getTextSize(word, _FONT, _SIZE, 1)
    return int(width)


def _plain(text: str) -> str:
    """The text in the letters that the font has: accents are left off, other letters are ``?``."""
    letters = (c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(letters).encode("ascii", "replace").decode()
