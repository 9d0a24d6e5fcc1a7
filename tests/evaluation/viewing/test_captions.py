"""Captions: all of every word is there at every width, and pictures of one width are equally high."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.evaluation.viewing.drawing import Captions, widest

WHITE = (255, 255, 255)
ROW_PX = 18
WORDS = ["frame 12", "0.400 s", "tracking", "confidence 0.75", "error 11.5 mm", "roll -12.1"]


def caption(words: list[str], width: int, longest: list[str] | None = None) -> np.ndarray:
    """What stands below a picture one pixel high."""
    body = np.zeros((1, width, 3), np.uint8)
    return Captions([longest or words], width).below(body, [(words, WHITE)])[1:]


def ink(picture: np.ndarray) -> int:
    """How much is written; letters of one size take as much wherever they stand."""
    return int((picture.max(axis=2) > 100).sum())


def columns(picture: np.ndarray) -> np.ndarray:
    """Which columns have writing."""
    return np.flatnonzero((picture.max(axis=2) > 100).any(axis=0))


@pytest.mark.parametrize("width", [1, 60, 130, 200, 260, 390, 512, 1536])
def test_no_word_is_cut_at_any_width(width: int) -> None:
    picture = caption(WORDS, width)
    assert picture.shape[1] >= width
    assert columns(picture).max() < picture.shape[1] - 2, "nothing touches the edge"
    every = sum(ink(caption([word], 2000)) for word in WORDS)
    assert (
        ink(picture) > 0.7 * every
    )  # smaller letters take less, at least 0.38 / 0.45 of the strokes' length
    rows = picture.reshape(-1, ROW_PX, *picture.shape[1:])
    assert all((row.max(axis=2) > 100).any() for row in rows), "no row is empty"


def test_rows_are_as_few_as_can_be() -> None:
    heights = [caption(WORDS, width).shape[0] // ROW_PX for width in (120, 200, 390, 1000)]
    assert heights == sorted(heights, reverse=True) and heights[0] >= 4 and heights[-1] == 1


def test_pictures_of_one_width_are_equally_high_whatever_they_say() -> None:
    captions = Captions([["frame 999", "9.999 s"], WORDS], 200)
    body = np.zeros((50, 200, 3), np.uint8)
    told = [["frame 1", "0.100 s"], ["frame 888", "8.123 s"], ["frame 123456789", "123456.123 s"]]
    shapes = {captions.below(body, [(when, WHITE), (WORDS[:1], WHITE)]).shape for when in told}
    assert len(shapes) == 1


def test_a_caption_longer_than_was_told_of_is_smaller_and_whole() -> None:
    usual, long = caption(WORDS[:2], 300, WORDS[:2]), caption(WORDS, 300, WORDS[:2])
    assert usual.shape == long.shape
    assert columns(long).max() < 300 - 2


def test_a_picture_narrower_than_a_word_has_a_margin() -> None:
    body = np.full((20, 10, 3), 200, np.uint8)
    picture = Captions([["confidence 0.75"]], 10).below(body, [(["confidence 0.75"], WHITE)])
    assert (picture[:20, :10] == 200).all() and (picture[:20, 10:] < 100).all() and picture.shape[1] > 80


def test_digits_take_as_much_room_whatever_they_are() -> None:
    assert caption(["error 1.1 mm"], 130).shape == caption(["error 8.8 mm"], 130).shape


def test_colours_are_those_asked_for_line_by_line() -> None:
    body = np.zeros((1, 200, 3), np.uint8)
    lines = [(["one"], (255, 0, 0)), (["two"], (0, 0, 255))]
    picture = Captions([["one"], ["two"]], 200).below(body, lines)[1:].astype(int)
    first, second = picture[:ROW_PX].max(axis=(0, 1)), picture[ROW_PX:].max(axis=(0, 1))
    assert first[0] > 200 and first[2] < 100 and second[2] > 200 and second[0] < 100


def test_letters_that_the_font_lacks() -> None:
    np.testing.assert_array_equal(caption(["résumé"], 200), caption(["resume"], 200))
    np.testing.assert_array_equal(caption(["手"], 200), caption(["?"], 200))


def test_no_words_are_no_writing() -> None:
    assert not ink(caption([], 100))


def test_the_widest_word() -> None:
    assert widest(["lost", "reinitialised", "tracking"]) == "reinitialised"
