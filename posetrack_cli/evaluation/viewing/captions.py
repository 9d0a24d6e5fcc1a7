"""Captions below pictures: never cut, and equally high below pictures that are equally wide."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from typing import TypeAlias

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.evaluation.viewing.colours import Colour

CaptionLine: TypeAlias = tuple[Sequence[str], Colour]
"""Words, one after the other with gaps between them, and their colour."""

USUAL_SIZE, SMALLEST_SIZE = 0.45, 0.38
"""Of letters, in OpenCV's units: below the smaller one they are hard to read."""
_TINY_SIZE = 0.1
_STEP = 0.01
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_ROW_PX, _BASE_PX, _LEFT_PX, _GAP_PX = 18, 13, 4, 11
_STROKE_PX = 3
"""By so much letters reach beyond the width that OpenCV tells."""
_GROUND: Colour = (24, 24, 24)


class Captions:
    """Writes captions below pictures of one width.

    Words that do not fit beside each other stand in several rows, as many as the longest caption needs: so
    pictures with captions are of one size, as a video wants it. A picture that is narrower than the longest
    word gets a margin on its right.

    Args:
        longest: for each line its words, each as long as it gets (digits may be any).
        width: of the pictures, pixels.

    Attributes:
        width: of pictures with captions, pixels.
    """

    def __init__(self, longest: Sequence[Sequence[str]], width: int) -> None:
        widest = [[re.sub(r"\d", "8", _plain(word)) for word in words] for words in longest]
        needed = max((_length(word, SMALLEST_SIZE) for words in widest for word in words), default=0)
        self.width = max(width, needed + 2 * _LEFT_PX)
        self._rows = [len(_broken(words, SMALLEST_SIZE, self.width)) for words in widest]
        self._sizes = [
            _largest_size(words, rows, self.width) for words, rows in zip(widest, self._rows, strict=True)
        ]

    def below(self, body: ImageArray, lines: Sequence[CaptionLine]) -> ImageArray:
        """Return a picture (height, width, 3) with lines below it, as many as were told of."""
        height, margin = sum(self._rows) * _ROW_PX, self.width - body.shape[1]
        caption = np.full((height, self.width, 3), _GROUND, dtype=np.uint8)
        top = 0
        for (words, colour), rows, size in zip(lines, self._rows, self._sizes, strict=True):
            plain = [_plain(word) for word in words]
            fitting = min(size, _largest_size(plain, rows, self.width))
            for place, row in enumerate(_broken(plain, fitting, self.width)):
                _write(caption, row, top + place * _ROW_PX + _BASE_PX, fitting, colour)
            top += rows * _ROW_PX
        shown = cv2.copyMakeBorder(body, 0, 0, 0, margin, cv2.BORDER_CONSTANT, value=_GROUND)
        return np.vstack([shown, caption])


def _largest_size(words: Sequence[str], rows: int, width: int) -> float:
    """The largest size, not above the usual one, at which words fit into so many rows of a width."""
    size = USUAL_SIZE
    while size > _TINY_SIZE and not _fits(words, size, rows, width):
        size = round(size - _STEP, 2)
    return size


def _fits(words: Sequence[str], size: float, rows: int, width: int) -> bool:
    longest = max((_length(word, size) for word in words), default=0)
    return longest <= width - 2 * _LEFT_PX and len(_broken(words, size, width)) <= rows


def _broken(words: Sequence[str], size: float, width: int) -> list[list[str]]:
    """Words in rows that are not wider than a width, each as full as it can be; at least one row."""
    rows: list[list[str]] = [[]]
    left = float(_LEFT_PX)
    for word in words:
        end = left + _length(word, size)
        if rows[-1] and end > width - _LEFT_PX:
            rows.append([])
            end = _LEFT_PX + _length(word, size)
        rows[-1].append(word)
        left = end + _GAP_PX * size / USUAL_SIZE
    return rows


def _write(picture: ImageArray, words: Sequence[str], base: int, size: float, colour: Colour) -> None:
    left = float(_LEFT_PX)
    for word in words:
        cv2.putText(picture, word, (round(left), base), _FONT, size, colour, 1, cv2.LINE_AA)
        left += _length(word, size) + _GAP_PX * size / USUAL_SIZE


@lru_cache(maxsize=4096)
def _length(word: str, size: float) -> int:
    """Width of a word, pixels."""
    (width, _), _ = cv2.getTextSize(word, _FONT, size, 1)
    return int(width) + _STROKE_PX


def widest(words: Sequence[str]) -> str:
    """Return the word that takes the most room."""
    return max(words, key=lambda word: _length(_plain(word), USUAL_SIZE))


def _plain(text: str) -> str:
    """The text in the letters that the font has: accents are left off, other letters are ``?``."""
    letters = (c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(letters).encode("ascii", "replace").decode()
