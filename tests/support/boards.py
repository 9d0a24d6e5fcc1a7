"""Images of boards as cameras with known intrinsics, distortion and places see them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import placed
from posetrack_cli.recording.calibration.views import Board

FINE = 3
"""Rays per pixel and direction: edges are grey as a sensor sees them."""
TEXELS = 80
"""Of a square."""
LENS = (-0.21, 0.08, 0.0012, -0.0017)
WIDTH, HEIGHT = 480, 360
NOISE = 1.5
CHESSBOARD = Board(8, 6, 22.0)
CHARUCO = Board(7, 5, 26.0, 19.0)


def cameras(count: int = 2) -> list[Camera]:
    """Toed-in cameras in a row, none like the other."""
    first = Camera(WIDTH, HEIGHT, 620.0, 623.0, 236.0, 183.5, LENS, name="left")
    second = Camera(WIDTH, HEIGHT, 605.0, 604.0, 243.0, 178.0, (-0.18, 0.05, -0.001, 0.0008), name="right")
    third = Camera(WIDTH, HEIGHT, 640.0, 642.0, 240.0, 180.0, (-0.1, 0.02, 0.0, 0.0), name="third")
    return [
        first,
        placed(second, place(-9.6, (-118.0, 1.5, 20.0))),
        placed(third, place(9.0, (110.0, -2.0, 15.0))),
    ][:count]


def place(turn_deg: float, t: tuple[float, float, float]) -> np.ndarray:
    return np.column_stack([Rotation.from_euler("yx", [-turn_deg, 0.4], degrees=True).as_matrix(), t])


def poses(count: int, seed: int = 1) -> list[np.ndarray]:
    """reference_T_board: tilted boards about 500 mm away, here and there in the image."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        tilt = Rotation.from_euler(
            "xyz", rng.uniform((-35, -35, -20), (35, 35, 20)), degrees=True
        ).as_matrix()
        centre = rng.uniform((-45, -40, 420), (45, 40, 600))
        found.append(np.column_stack([tilt, centre]))
    return found


def render(board: Board, camera: Camera, reference_T_board: np.ndarray, seed: int = 0) -> np.ndarray:
    """What a camera sees; the board's middle is at the pose's origin."""
    transform = np.array(camera.camera_T_reference)
    rotation = transform[:, :3] @ reference_T_board[:, :3]
    origin = transform[:, :3] @ reference_T_board[:, 3] + transform[:, 3]
    rays = rays_of(camera)
    normal = rotation[:, 2].astype(np.float32)
    points = (rays * ((origin.astype(np.float32) @ normal) / (rays @ normal))[:, None]) @ rotation[
        :, :2
    ].astype(np.float32) - (origin @ rotation[:, :2]).astype(np.float32)
    fine = texture_at(board, points).reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3))
    noise = np.random.default_rng(seed).normal(0.0, NOISE, fine.shape)
    return np.clip(np.rint(30.0 + 0.75 * fine + noise), 0, 255).astype(np.uint8)


@lru_cache
def rays_of(camera: Camera) -> np.ndarray:
    """(N, 3) rays of FINE x FINE places in every pixel, by OpenCV's undistortion."""
    steps = (np.arange(FINE) + 0.5) / FINE - 0.5
    rows, columns = (np.arange(n)[:, None] + steps for n in (HEIGHT, WIDTH))
    v, u = np.meshgrid(rows.ravel(), columns.ravel(), indexing="ij")
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    xy = cv2.undistortPointsIter(pixels, camera.matrix, np.array(camera.distortion), None, None, criteria)[
        :, 0
    ]
    return np.column_stack([xy, np.ones(len(xy))]).astype(np.float32)


def texture_at(board: Board, points: np.ndarray) -> np.ndarray:
    """Grey values of points (N, 2), mm from the board's middle, in a white frame of one square."""
    texture = np.full(((board.rows + 2) * TEXELS, (board.columns + 2) * TEXELS), 255, np.uint8)
    texture[TEXELS:-TEXELS, TEXELS:-TEXELS] = printed(board)
    middle = np.array([board.columns + 2, board.rows + 2]) / 2
    texels = np.rint((points / board.square_mm + middle) * TEXELS - 0.5).astype(int)
    inside = np.all((texels >= 0) & (texels < np.array(texture.shape[::-1])), axis=1)
    values = np.full(len(points), 128.0)
    values[inside] = texture[texels[inside, 1], texels[inside, 0]]
    return values


def printed(board: Board) -> np.ndarray:
    """The board as it is printed, TEXELS a square."""
    if board.marker_mm is None:
        squares = (np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2) * 255
        return np.kron(squares, np.ones((TEXELS, TEXELS))).astype(np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    layout = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_mm, board.marker_mm, dictionary)
    return layout.generateImage((board.columns * TEXELS, board.rows * TEXELS))


def corner_pixels(board: Board, camera: Camera, reference_T_board: np.ndarray) -> np.ndarray:
    """Where a camera sees the inner corners, by OpenCV's projection."""
    middle = np.array([board.columns, board.rows]) * board.square_mm / 2
    points = board.points + np.array([board.square_mm - middle[0], board.square_mm - middle[1], 0.0])
    transform = np.array(camera.camera_T_reference)
    rotation = transform[:, :3] @ reference_T_board[:, :3]
    t = transform[:, :3] @ reference_T_board[:, 3] + transform[:, 3]
    vector = cv2.Rodrigues(rotation)[0]
    return cv2.projectPoints(points, vector, t, camera.matrix, np.array(camera.distortion))[0][:, 0]


def write_views(
    path: Path,
    board: Board,
    rig: Sequence[Camera],
    where: Sequence[np.ndarray],
    unseen: Sequence[tuple[str, int]] = (),
) -> Path:
    """A folder of images per camera; ``unseen`` names camera and instant of which there is no image."""
    for number, camera in enumerate(rig):
        (path / camera.name).mkdir(parents=True)
        for index, pose in enumerate(where):
            if (camera.name, index) not in unseen:
                image = render(board, camera, pose, seed=100 * number + index)
                cv2.imwrite(str(path / camera.name / f"{index:03d}.png"), image)
    return path
