"""Text below pictures."""

from __future__ import annotations

import numpy as np

from posetrack_cli.evaluation.viewing.drawing import caption

WHITE = (255, 255, 255)
WORDS = ["frame 12", "0.400 s", "tracking", "confidence 0.75"]


def written(picture: np.ndarray) -> np.ndarray:
    """Which columns have writing."""
    return (picture.max(axis=2) > 100).any(axis=0)


def test_pictures_of_one_width_are_equally_high() -> None:
    few, many = caption([(["a"], WHITE)], 300), caption([(WORDS * 3, WHITE)], 300)
    assert few.shape == many.shape == (18, 300, 3)
    assert caption([(WORDS, WHITE), (WORDS, WHITE)], 300).shape == (36, 300, 3)


def test_long_lines_shrink_until_they_fit() -> None:
    wide, narrow = caption([(WORDS, WHITE)], 800), caption([(WORDS, WHITE)], 290)
    length = np.flatnonzero(written(wide)).max()
    assert 290 < length < 500
    assert np.flatnonzero(written(narrow)).max() < 290, "nothing touches the edge"


def test_colours_are_those_asked_for_line_by_line() -> None:
    picture = caption([(["one"], (255, 0, 0)), (["two"], (0, 0, 255))], 200).astype(int)
    first, second = picture[:18].max(axis=(0, 1)), picture[18:].max(axis=(0, 1))
    assert first[0] > 200 and first[2] < 100 and second[2] > 200 and second[0] < 100


def test_letters_that_the_font_lacks() -> None:
    np.testing.assert_array_equal(caption([(["résumé"], WHITE)], 200), caption([(["resume"], WHITE)], 200))
    np.testing.assert_array_equal(caption([(["手"], WHITE)], 200), caption([(["?"], WHITE)], 200))


def test_no_words_are_no_writing() -> None:
    assert not written(caption([([], WHITE)], 100)).any()
