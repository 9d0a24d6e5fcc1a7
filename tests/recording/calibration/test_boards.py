"""Boards in rendered images: corners where OpenCV's projection has them, in an order that views share."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import UsageError
from posetrack_cli.recording.calibration.views import Board, BoardFinder
from support import boards as support

CORNER_PX = 0.15
"""Root mean square of found corners in noisy images whose edges lie on thirds of pixels."""


@pytest.mark.parametrize("board", [support.CHESSBOARD, support.CHARUCO], ids=["chessboard", "charuco"])
def test_corners_are_where_the_camera_sees_them(board: Board) -> None:
    finder, errors = BoardFinder(board), []
    for index, pose in enumerate(support.poses(3)):
        for camera in support.cameras():
            found = finder.find(support.render(board, camera, pose, seed=index))
            assert found is not None
            assert (np.diff(found.ids) > 0).all()
            errors.append(found.pixels - support.corner_pixels(board, camera, pose)[found.ids])
    every = np.concatenate(errors)
    assert np.sqrt(np.mean(every**2)) < CORNER_PX
    assert np.abs(every.mean(axis=0)).max() < 0.05, "no offset: pixel centres are whole numbers"


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_a_chessboard_keeps_its_order_however_it_is_turned(turn: int) -> None:
    board = Board(8, 5, 22.0)  # 7 x 4 corners: the colours tell the ends apart
    camera = support.cameras()[0]
    rotation = np.array(cv2.Rodrigues(np.array([0.0, 0.0, np.radians(turn + 8)]))[0])
    pose = np.column_stack([rotation, [0.0, 0.0, 500.0]])
    found = BoardFinder(board).find(support.render(board, camera, pose))
    assert found is not None
    assert np.abs(found.pixels - support.corner_pixels(board, camera, pose)).max() < 0.5


def test_a_board_that_looks_the_same_after_half_a_turn_begins_up_and_left() -> None:
    board = Board(8, 6, 22.0)  # 7 x 5 corners
    camera = support.cameras()[0]
    for turn in (0.1, np.pi + 0.1):
        rotation = np.array(cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0])
        found = BoardFinder(board).find(
            support.render(board, camera, np.column_stack([rotation, [0, 0, 500.0]]))
        )
        assert found is not None
        assert found.pixels[0].sum() < found.pixels[-1].sum()


def test_a_charuco_board_may_be_seen_in_part_and_be_of_the_old_kind() -> None:
    board = Board(7, 6, 26.0, 19.0)  # even rows: where old and new prints differ
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    layout = cv2.aruco.CharucoBoard((7, 6), 26.0, 19.0, dictionary)
    layout.setLegacyPattern(True)
    image = cv2.copyMakeBorder(
        layout.generateImage((560, 480)), 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255
    )
    finder = BoardFinder(board)
    found = finder.find(image)
    assert found is not None
    assert len(found.ids) == 30
    part = finder.find(image[:, :400])
    assert part is not None
    assert 6 <= len(part.ids) < 30
    np.testing.assert_allclose(part.pixels, found.pixels[np.isin(found.ids, part.ids)], atol=0.1)


def test_an_image_without_a_board() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (200, 300), dtype=np.uint8)
    assert BoardFinder(support.CHESSBOARD).find(noise) is None
    assert BoardFinder(support.CHARUCO).find(noise) is None


def test_corners_are_numbered_row_by_row() -> None:
    points = Board(4, 3, 10.0).points
    np.testing.assert_array_equal(points[:, :2], [[0, 0], [10, 0], [20, 0], [0, 10], [10, 10], [20, 10]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((2, 7, 20.0), "found 2x7 squares"),
        ((9, 7, 0.0), "squares of 0 mm"),
        ((9, 7, 20.0, 21.0), "markers do not fit the squares, found 21 mm"),
        ((9, 7, 20.0, 15.0, "4X4_51"), "unknown dictionary '4X4_51'; did you mean '4X4_50'?"),
    ],
)
def test_boards_that_cannot_be(arguments: tuple[float, ...], message: str) -> None:
    with pytest.raises(UsageError) as caught:
        Board(*arguments)  # type: ignore[arg-type]
    assert message in str(caught.value)
