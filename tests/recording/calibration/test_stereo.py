"""Calibration of cameras that render boards: what was put in comes out, wrong input is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.geometry.rigid import CameraPair
from posetrack_cli.recording.calibration.solve import (
    StereoCalibration,
    adjust,
    calibrate_stereo,
    fit_camera,
    place_cameras,
)
from posetrack_cli.recording.calibration.views import Board, CameraViews, FoundBoard, find_views
from posetrack_cli.recording.camera_file import load_rig
from support import boards as support

VIEWS = 10
CORNER_PX = 0.1
"""Noise of corners in rendered images; what follows from it is at most a few times larger."""
EXACT_PX, EXACT_MM = 1e-3, 1e-3
"""Corners go into OpenCV as float32, 3e-5 px of rounding at 480 px."""


def exact_views(board: Board, rig: list[Camera], count: int = VIEWS) -> list[CameraViews]:
    """Corners as OpenCV projects them; of the third camera only every other view."""
    found = []
    for number, camera in enumerate(rig):
        boards: list[FoundBoard | None] = []
        for index, pose in enumerate(support.poses(count)):
            pixels = support.corner_pixels(board, camera, pose)
            hidden = number == 2 and index % 2
            boards.append(None if hidden else FoundBoard(np.arange(len(pixels)), pixels))
        found.append(CameraViews(camera.name, board, support.WIDTH, support.HEIGHT, count, tuple(boards)))
    return found


def check_cameras(found: list[Camera], expected: list[Camera], pixel: float, place_mm: float) -> None:
    """Cameras are alike if they see points of the working volume at the same pixels, from the same place."""
    rng = np.random.default_rng(4)
    points = rng.uniform((-60, -50, 420), (60, 50, 600), (200, 3))
    for camera, truth in zip(found, expected, strict=True):
        seen, expected_pixels = pixels_from_points(camera, points)[0], pixels_from_points(truth, points)[0]
        # principal point and turn of a camera can stand for each other: only their sum is seen
        offset = np.median(seen - expected_pixels, axis=0)
        assert np.abs(seen - expected_pixels - offset).max() < pixel, camera.name
        place, true_place = np.array(camera.camera_T_reference), np.array(truth.camera_T_reference)
        np.testing.assert_allclose(place[:, 3], true_place[:, 3], atol=place_mm)


def test_exact_corners_give_the_cameras_exactly() -> None:
    rig = support.cameras(3)
    views = exact_views(support.CHESSBOARD, rig)
    fits = [fit_camera(own, "four") for own in views]
    found = place_cameras([fit.camera for fit, _ in fits], [used for _, used in fits])
    check_cameras(found, rig, EXACT_PX, EXACT_MM)
    for camera, truth in zip(found, rig, strict=True):
        np.testing.assert_allclose(camera.matrix, truth.matrix, atol=0.05)
        np.testing.assert_allclose(camera.camera_T_reference, truth.camera_T_reference, atol=EXACT_MM)
    assert [fit.used for fit, _ in fits] == [VIEWS, VIEWS, VIEWS // 2]


def test_a_camera_that_shares_no_view_with_the_reference_is_placed_by_another() -> None:
    rig = support.cameras(3)
    left, right, third = exact_views(support.CHESSBOARD, rig, 24)
    boards = [tuple(b if k < 14 else None for k, b in enumerate(left.boards))]
    boards += [
        right.boards,
        tuple(
            b if k >= 14 else None
            for k, b in enumerate(exact_views(support.CHESSBOARD, [rig[2]], 24)[0].boards)
        ),
    ]
    views = [replace(v, boards=b) for v, b in zip((left, right, third), boards, strict=True)]
    fits = [fit_camera(own, "four") for own in views]
    found = place_cameras([fit.camera for fit, _ in fits], [used for _, used in fits])
    check_cameras(found, rig, EXACT_PX, 10 * EXACT_MM)


def test_adjustment_finds_exact_cameras_from_wrong_ones_and_tells_its_uncertainty() -> None:
    rig = support.cameras(3)
    views = exact_views(support.CHESSBOARD, rig)
    wrong = [
        replace(c, fx=c.fx + 15, fy=c.fy - 9, cx=c.cx + 6, distortion=(-0.1, 0.0, 0.0, 0.0)) for c in rig
    ]
    fit = adjust(wrong, views)
    for camera, truth in zip(fit.cameras, rig, strict=True):
        np.testing.assert_allclose(camera.matrix, truth.matrix, atol=EXACT_PX)
        np.testing.assert_allclose(camera.distortion, truth.distortion, atol=1e-4)
        np.testing.assert_allclose(camera.camera_T_reference, truth.camera_T_reference, atol=EXACT_MM)
    assert (fit.rms_px < EXACT_PX).all()


def test_the_uncertainty_of_the_focal_length_is_the_scatter_over_noise() -> None:
    rig = support.cameras()
    exact = exact_views(support.CHESSBOARD, rig)
    found, stated = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        noisy = [
            replace(
                own,
                boards=tuple(
                    FoundBoard(b.ids, b.pixels + rng.normal(0, CORNER_PX, b.pixels.shape))
                    for b in own.boards
                    if b
                ),
            )
            for own in exact
        ]
        fit = adjust(rig, noisy)
        found.append([max(c.fx - t.fx, c.fy - t.fy, key=abs) for c, t in zip(fit.cameras, rig, strict=True)])
        stated.append(fit.focal_sd_px)
        np.testing.assert_allclose(fit.rms_px, np.sqrt(2) * CORNER_PX, rtol=0.15)
    ratio = np.sqrt(np.mean(np.square(found))) / np.mean(stated)
    # the larger of two errors, 16 samples: between 1 and 1.3, give or take three times 1 / sqrt(32)
    assert 0.4 < ratio < 1.9


def test_a_view_that_is_wrong_is_left_out() -> None:
    rig = support.cameras()
    views = exact_views(support.CHESSBOARD, rig)
    wrong = views[0].boards[3]
    assert wrong is not None
    moved = FoundBoard(wrong.ids, wrong.pixels[np.random.default_rng(1).permutation(len(wrong.ids))])
    boards = (*views[0].boards[:3], moved, *views[0].boards[4:])
    fit, used = fit_camera(replace(views[0], boards=boards), "four")
    assert (fit.used, fit.found) == (VIEWS - 1, VIEWS)
    assert used.boards[3] is None
    check_cameras([fit.camera], rig[:1], EXACT_PX, EXACT_MM)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Board]:
    """Either kind's corners ``test_boards`` finds, and the exact ones above are a chessboard's."""
    board = support.CHARUCO
    unseen = [("right", 2), ("left", 5)]
    folder = tmp_path_factory.mktemp("board") / "views"
    return support.write_views(folder, board, support.cameras(), support.poses(VIEWS), unseen), board


@pytest.fixture(scope="module")
def seen(rendered: tuple[Path, Board]) -> list[CameraViews]:
    return find_views(*rendered)


@pytest.fixture(scope="module")
def measured(seen: list[CameraViews]) -> StereoCalibration:
    return calibrate_stereo(seen)


def test_rendered_boards_give_the_cameras(measured: StereoCalibration) -> None:
    check_cameras(list(measured.cameras), support.cameras(), 10 * CORNER_PX, 25 * CORNER_PX)
    assert [camera.name for camera in measured.cameras] == ["left", "right"]
    (pair,) = measured.pairs
    assert pair.baseline_mm == pytest.approx(np.linalg.norm([118.0, 1.5, 20.0]), abs=0.5)
    assert pair.square_mm == pytest.approx(measured.board.square_mm, rel=2e-3)
    assert measured.doubts() == []


def test_its_errors_are_what_independent_points_show(measured: StereoCalibration) -> None:
    for fit in measured.fits:
        assert 0.02 < fit.rms_px < 2 * CORNER_PX
        assert (fit.images, fit.used) == (VIEWS - 1, VIEWS - 1)
    (pair,) = measured.pairs
    assert pair.views == VIEWS - 2
    assert pair.epipolar_rms_px < 2 * CORNER_PX
    rig, errors = support.cameras(), []
    for pose in support.poses(6, seed=9):  # boards that it has not seen, true corners
        seen = [support.corner_pixels(measured.board, camera, pose) for camera in rig]
        errors.append(CameraPair(*measured.cameras).epipolar_errors(*seen))
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 2 * CORNER_PX


def test_the_file_holds_the_cameras_and_the_errors(measured: StereoCalibration, tmp_path: Path) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(measured.file_text(Path("views")))
    size = (support.WIDTH, support.HEIGHT)
    read = load_rig(file).stored_cameras({"left": size, "right": size})
    for camera, expected in zip(read, measured.cameras, strict=True):
        assert camera.values() == expected.values()
        np.testing.assert_allclose(camera.camera_T_reference, expected.camera_T_reference, atol=1e-12)
    text = file.read_text()
    assert text.startswith("# measured by posetrack calibrate stereo on views, ")
    for line in measured.lines():
        assert f"# {line}\n" in text
    assert "reprojection error" in text
    assert "epipolar error" in text


def test_the_reference_is_the_first_that_is_named(rendered: tuple[Path, Board]) -> None:
    found = calibrate_stereo(find_views(*rendered, names=["right", "left"]), "five")
    assert [camera.name for camera in found.cameras] == ["right", "left"]
    assert found.cameras[1].camera_T_reference[0][3] > 100.0
    assert len(found.cameras[0].distortion) == 5


@pytest.mark.parametrize(("distortion", "count"), [("none", 0), ("four", 4), ("five", 5), ("eight", 8)])
def test_the_number_of_coefficients(distortion: str, count: int) -> None:
    views = exact_views(support.CHESSBOARD, support.cameras()[:1])
    assert len(fit_camera(views[0], distortion)[0].camera.distortion) == count


def test_images_not_taken_at_once_are_doubted(seen: list[CameraViews]) -> None:
    left, right = seen
    found = calibrate_stereo([left, replace(right, boards=(*right.boards[1:], right.boards[0]))])
    assert any("epipolar error" in doubt and "synchronised" in doubt for doubt in found.doubts())
    assert not found.fits_together
    assert found.is_inaccurate
    for camera, own in zip(found.cameras, (left, right), strict=True):
        alone = fit_camera(own, "four")[0].camera
        # the order of views changes the last digits
        np.testing.assert_allclose(camera.matrix, alone.matrix, rtol=1e-6, err_msg="of its own views")


def test_views_taken_at_once_fit_together(measured: StereoCalibration) -> None:
    assert measured.fits_together
    assert not measured.is_inaccurate


def test_board_images_are_paired_by_the_stamps_of_their_names(
    tmp_path: Path, rendered: tuple[Path, Board], seen: list[CameraViews]
) -> None:
    """Each camera lacks an image, as the numbered ones do: pairs must be the same."""
    folder, board = rendered
    for number, side in enumerate(("left", "right")):
        (tmp_path / side).mkdir()
        for image in (folder / side).iterdir():
            us = 1_305_031_102_160_407 + 200_000 * int(image.stem) + 4000 * number
            (tmp_path / side / f"{us // 10**6}.{us % 10**6:06d}.png").write_bytes(image.read_bytes())
    found = find_views(tmp_path, board)
    for views, numbered in zip(found, seen, strict=True):
        assert [one is None for one in views.boards] == [one is None for one in numbered.boards]
        for one, other in zip(views.boards, numbered.boards, strict=True):
            if one is not None and other is not None:
                np.testing.assert_array_equal(one.pixels, other.pixels)


def test_board_images_with_stamps_further_apart_are_refused(
    tmp_path: Path, rendered: tuple[Path, Board]
) -> None:
    folder, board = rendered
    for number, side in enumerate(("left", "right")):
        (tmp_path / side).mkdir()
        for image in (folder / side).iterdir():
            ms = 1_305_031_102_160 + 200 * int(image.stem) + 40 * number
            (tmp_path / side / f"{ms}.png").write_bytes(image.read_bytes())
    with pytest.raises(RecordingError, match=r"at least 40 ms apart.*; give simultaneous images equal names"):
        find_views(tmp_path, board)


def test_too_few_views_are_told_with_what_may_be_wrong(rendered: tuple[Path, Board]) -> None:
    folder, board = rendered
    other = Board(board.columns + 3, board.rows + 2, board.square_mm, board.marker_mm and 3.0, "7X7_50")
    with pytest.raises(
        RecordingError, match=r"too few images of camera 'left', found 0 of 9.*one more than inner"
    ):
        calibrate_stereo(find_views(folder, other))


def test_cameras_that_never_see_the_board_together(tmp_path: Path, rendered: tuple[Path, Board]) -> None:
    folder, board = rendered
    for side, keep in (("left", (0, 1, 2, 4, 6)), ("right", (3, 6, 7, 8, 9))):
        (tmp_path / side).mkdir()
        for index in keep:
            name = f"{side}/{index:03d}.png"
            (tmp_path / name).write_bytes((folder / name).read_bytes())
    with pytest.raises(
        RecordingError, match=r"too few shared board views for camera 'right'.*found 1 shared"
    ):
        calibrate_stereo(find_views(tmp_path, board))


def test_folders_that_are_not_there_and_images_that_differ_in_size(
    tmp_path: Path, rendered: tuple[Path, Board]
) -> None:
    folder, board = rendered
    with pytest.raises(RecordingError, match="no folder 'rigth'; did you mean 'right'"):
        find_views(folder, board, names=["left", "rigth"])
    (tmp_path / "left").mkdir()
    for index, size in enumerate([(40, 30), (50, 30)]):
        cv2.imwrite(str(tmp_path / "left" / f"{index}.png"), np.zeros(size, np.uint8))
    with pytest.raises(RecordingError, match="board"):
        calibrate_stereo(find_views(tmp_path, board))
