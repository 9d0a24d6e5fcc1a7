"""Views of a calibration board: chessboard and ChArUco detection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray, IntArray
from posetrack_cli.errors import RecordingError, UsageError, nearest_name
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.grey import Grey, decode_shown, grey_like
from posetrack_cli.recording.image_files import ImageFile, read_image
from posetrack_cli.recording.image_folders import CameraFolders, Instants, find_folders

# Boards and their detection

FEWEST_CORNERS = 6  # required for the pose of the board
FEWEST_SQUARES, MOST_SQUARES = 3, 100
DICTIONARY_PREFIX = "DICT_"
CHESSBOARD_FLAGS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE

REFINEMENT = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
# Half side of the refinement window, over the smallest square; its minimum in pixels
WINDOW, SMALLEST_WINDOW = 0.3, 2


@dataclass(frozen=True, eq=False)
class FoundBoard:
    """The corners of a board in one image.

    Attributes:
        ids: (n,) corner ids, ascending: row times corners per row plus column.
        pixels: (n, 2) positions.
    """

    ids: IntArray
    pixels: FloatArray


@dataclass(frozen=True)
class Board:
    """A printed board: a chessboard, or with markers in its white squares a ChArUco board.

    Attributes:
        columns, rows: number of squares, not inner corners.
        square_mm: side of a square.
        marker_mm: side of a marker; None for a chessboard.
        dictionary: marker dictionary, OpenCV's name without DICT_: 4X4_50, ...
    """

    columns: int
    rows: int
    square_mm: float
    marker_mm: float | None = None
    dictionary: str = "4X4_50"

    def __post_init__(self) -> None:
        size = f"{self.columns}x{self.rows}"
        if not FEWEST_SQUARES <= min(self.columns, self.rows) <= max(self.columns, self.rows) <= MOST_SQUARES:
            raise UsageError(
                "invalid board",
                found=f"{size} squares",
                expected=f"{FEWEST_SQUARES} to {MOST_SQUARES} across and down",
            )
        if not 0.0 < self.square_mm < 1e5:
            raise UsageError("invalid board", found=f"squares of {self.square_mm:g} mm")
        if self.marker_mm is not None:
            if not 0.0 < self.marker_mm < self.square_mm:
                raise UsageError(
                    "markers do not fit the squares",
                    found=f"{self.marker_mm:g} mm",
                    expected=f"above 0 and below {self.square_mm:g} mm",
                )
            _dictionary(self.dictionary)

    @property
    def across(self) -> int:
        """Inner corners in a row."""
        return self.columns - 1

    @cached_property
    def points(self) -> FloatArray:
        """(N, 3) corners in the board's axes, mm: x along a row, y down the columns, z = 0."""
        v, u = np.divmod(np.arange((self.columns - 1) * (self.rows - 1)), self.across)
        return np.column_stack([u, v, np.zeros_like(u)]) * self.square_mm

    @property
    def words(self) -> str:
        """Description: ``chessboard of 10x7 squares of 25 mm``."""
        kind = "chessboard" if self.marker_mm is None else f"ChArUco board ({self.dictionary})"
        return f"{kind} of {self.columns}x{self.rows} squares of {self.square_mm:g} mm"


class BoardFinder:
    """Detects a board in images, including ChArUco boards printed with OpenCV before 4.6."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._detectors = (
            []
            if board.marker_mm is None
            else [_charuco(board, board.marker_mm, old) for old in (False, True)]
        )

    def find(self, image: ImageArray) -> FoundBoard | None:
        """Return the corners in a grey image, None if the board is not detected.

        A chessboard is detected as a whole only, a ChArUco board from six corners on.
        """
        return self._find_chessboard(image) if not self._detectors else self._find_charuco(image)

    def _find_chessboard(self, image: ImageArray) -> FoundBoard | None:
        board = self._board
        size = (board.across, board.rows - 1)
        found, corners = cv2.findChessboardCornersSB(image, size, flags=CHESSBOARD_FLAGS)
        if not found:
            return None
        grid = _refined(corners.reshape(board.rows - 1, board.across, 2), image)
        pixels = _oriented(grid, image).reshape(-1, 2)
        return FoundBoard(np.arange(len(pixels)), pixels)

    def _find_charuco(self, image: ImageArray) -> FoundBoard | None:
        found = [(detector, *detector.detectBoard(image)[:2]) for detector in self._detectors]
        best, corners, ids = max(found, key=lambda one: 0 if one[2] is None else len(one[2]))
        if ids is None or len(ids) < FEWEST_CORNERS:
            return None
        self._detectors = [best]  # the other pattern finds fewer corners, so stop trying it
        order = np.argsort(ids.ravel())
        pixels = corners.reshape(-1, 2)[order].astype(np.float64)
        return FoundBoard(ids.ravel()[order].astype(np.int64), pixels)


def _charuco(board: Board, marker_mm: float, is_old: bool) -> cv2.aruco.CharucoDetector:
    size = (board.columns, board.rows)
    layout = cv2.aruco.CharucoBoard(size, board.square_mm, marker_mm, _dictionary(board.dictionary))
    layout.setLegacyPattern(is_old)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.CharucoDetector(layout, detectorParams=parameters)


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    known = [
        key.removeprefix(DICTIONARY_PREFIX) for key in dir(cv2.aruco) if key.startswith(DICTIONARY_PREFIX)
    ]
    if name not in known:
        raise UsageError(f"unknown dictionary '{name}'", hint=nearest_name(name, known))
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY_PREFIX + name))


def _refined(grid: ImageArray, image: ImageArray) -> FloatArray:
    """Return a chessboard's corners refined to saddle points of the image within their squares.

    The detector alone is biased by up to 0.1 px away from the board's centre, which biases the focal
    length.
    """
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
    half = max(SMALLEST_WINDOW, int(WINDOW * min(sides)))
    start = grid.reshape(-1, 1, 2).astype(np.float32)
    refined = cv2.cornerSubPix(image, start, (half, half), (-1, -1), REFINEMENT)
    return refined.reshape(grid.shape).astype(np.float64)


def _oriented(grid: FloatArray, image: ImageArray) -> FloatArray:
    """Return a chessboard's corners (rows, columns, 2) in an order independent of the view.

    The board is seen from its front, so rows and columns turn clockwise. Half a turn changes only the
    colours of its corner squares: if they differ the dark one is first, else the order that begins further
    up and left.
    """
    along, down = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    if along[0] * down[1] - along[1] * down[0] < 0.0:
        grid = grid[:, ::-1]
    turned = grid[::-1, ::-1]
    if sum(grid.shape[:2]) % 2:
        return grid if _corner_square(grid, image) <= _corner_square(turned, image) else turned
    return grid if grid[0, 0].sum() <= turned[0, 0].sum() else turned


def _corner_square(grid: FloatArray, image: ImageArray) -> float:
    """Return the grey value at the centre of the square beyond the first corner."""
    centre = 2.0 * grid[0, 0] - 0.5 * (grid[0, 1] + grid[1, 0])
    u, v = np.clip(np.rint(centre).astype(int), 0, np.array(image.shape[::-1]) - 1)
    return float(image[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2].mean())


# Board views in one image folder per camera


@dataclass(frozen=True, eq=False)
class CameraViews:
    """One camera's views of the board.

    Attributes:
        name: name of the camera.
        board: the board.
        width, height: image size, pixels.
        images: number of images.
        boards: one per instant, None without image or detection.
    """

    name: str
    board: Board
    width: int
    height: int
    images: int
    boards: tuple[FoundBoard | None, ...]

    @property
    def found(self) -> int:
        """Number of images with a detected board."""
        return sum(board is not None for board in self.boards)

    def only(self, kept: BoolArray) -> CameraViews:
        """Return these views without the boards of instants not in the mask ``kept`` (instants,)."""
        boards = (board if keeps else None for board, keeps in zip(self.boards, kept, strict=True))
        return replace(self, boards=tuple(boards))


def find_views(
    path: Path,
    board: Board,
    names: Sequence[str] | None = None,
    report: Callable[[int, int], None] = lambda done, total: None,
    losses: LossLog | None = None,
) -> list[CameraViews]:
    """Detect the board in every image of every camera.

    Args:
        path: folder with one image folder per camera; images with equal names or numbers, or with stamps as
            names at about the same time, are simultaneous.
        board: board to detect.
        names: names of the cameras, reference first; None for all folders, left before right.
        report: progress callback with the numbers of images done and in total.
        losses: receives undecodable images.

    Raises:
        RecordingError: there are no images, or images of one camera differ in size.
    """
    found = find_folders(path)
    folders = found.of(_chosen(found, names))
    log, done = LossLog() if losses is None else losses, 0
    total = sum(len(images) for images in folders.by_name.values())
    every, finder, views = _instants(folders), BoardFinder(board), []
    for remark in folders.every_remark:
        log.note(remark)
    for name in folders.by_name:
        camera = _Camera(path / name, finder, log)
        for instant in every:
            camera.add(instant.get(name))
            done += name in instant
            report(done, total)
        width, height = camera.size()
        boards = tuple(camera.boards)
        views.append(CameraViews(name or "camera", board, width, height, camera.images, boards))
    return views


class _Camera:
    """Collects one camera's views.

    Args:
        folder: folder of its images.
        finder: board detector.
        losses: receives undecodable images.

    Attributes:
        boards: board of each instant.
        images: number of images.
    """

    def __init__(self, folder: Path, finder: BoardFinder, losses: LossLog) -> None:
        self._folder, self._finder, self._losses = folder, finder, losses
        self._pixels: Grey | None = None
        self.boards: list[FoundBoard | None] = []
        self.images = 0

    def add(self, image: ImageFile | None) -> None:
        """Add the image of the next instant, None if there is none."""
        self.images += image is not None
        self.boards.append(None if image is None else self._found(image))

    def size(self) -> tuple[int, int]:
        """Return image width and height, pixels."""
        if self._pixels is None:
            raise RecordingError("no image can be decoded", where=self._folder, found=f"{self.images} files")
        return self._pixels.width, self._pixels.height

    def _found(self, image: ImageFile) -> FoundBoard | None:
        try:
            shown = decode_shown(read_image(image))
            if self._pixels is None:
                self._pixels = grey_like(shown, image)
            grey = self._pixels.from_stored(shown)
        except UnreadableImageError as error:
            self._losses.add(f"image skipped, {error}", str(image))
            return None
        return self._finder.find(grey)


def _instants(folders: CameraFolders) -> Instants:
    try:
        return folders.instants()
    except RecordingError as error:
        reason = str(error).partition(";")[0]  # its hint is an option that calibration does not have
        raise RecordingError(reason, hint="give simultaneous images equal names or numbers") from error


def _chosen(folders: CameraFolders, names: Sequence[str] | None) -> Sequence[str]:
    """Return the named cameras, by default all, left before right."""
    for name in names or ():
        if name not in folders.by_name:
            hint = nearest_name(name, folders.by_name)
            raise RecordingError(f"no folder '{name}'", where=folders.path, hint=hint)
    return names or sorted(folders.by_name, key=lambda name: (name != "left", name != "right", name))
