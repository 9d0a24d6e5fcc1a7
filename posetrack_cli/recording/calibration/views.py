"""Images of a board in one folder per camera, and the corners found in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from posetrack_cli.arrays import BoolArray
from posetrack_cli.errors import RecordingError, nearest_name
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.calibration.boards import Board, BoardFinder, FoundBoard
from posetrack_cli.recording.grey import Grey, decode_as_stored, grey_like
from posetrack_cli.recording.image_files import read_image
from posetrack_cli.recording.image_folders import find_folders, instants


@dataclass(frozen=True, eq=False)
class CameraViews:
    """What one camera saw of the board.

    Attributes:
        name: of the camera.
        board: that was looked for.
        width, height: of its images, pixels.
        images: how many there are.
        boards: one per instant, None where it has no image or the image shows no board.
    """

    name: str
    board: Board
    width: int
    height: int
    images: int
    boards: tuple[FoundBoard | None, ...]

    @property
    def found(self) -> int:
        """In how many images the board was found."""
        return sum(board is not None for board in self.boards)

    def only(self, kept: BoolArray) -> CameraViews:
        """Return these views without the boards of instants that are not kept (instants,)."""
        boards = (board if keeps else None for board, keeps in zip(self.boards, kept, strict=True))
        return replace(self, boards=tuple(boards))


def find_views(
    path: Path,
    board: Board,
    names: Sequence[str] | None = None,
    report: Callable[[int, int], None] = lambda done, total: None,
    losses: LossLog | None = None,
) -> list[CameraViews]:
    """Look for the board in every image of every camera.

    Args:
        path: a folder with a folder of images per camera; images of one name or number were taken at once.
        board: what to look for.
        names: of the cameras, the reference first; None for all folders, left before right.
        report: told how many images of how many are done.
        losses: gets images that cannot be decoded.

    Raises:
        RecordingError: there are no images, or images of one camera differ in size.
    """
    folders = _chosen(path, find_folders(path), names)
    log = LossLog() if losses is None else losses
    every = instants(path, folders)
    finder, done = BoardFinder(board), 0
    total = sum(len(images) for images in folders.values())
    views = []
    for name in folders:
        camera = _Camera(name)
        for instant in every:
            camera.add(finder, instant.get(name), log)
            done += name in instant
            report(done, total)
        views.append(camera.views(path, board))
    return views


class _Camera:
    """Collects what one camera saw."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._pixels: Grey | None = None
        self._boards: list[FoundBoard | None] = []
        self._images = 0

    def add(self, finder: BoardFinder, image: Path | None, losses: LossLog) -> None:
        """Look at the image of the next instant, None if there is none."""
        self._images += image is not None
        self._boards.append(None if image is None else self._found(finder, image, losses))

    def views(self, path: Path, board: Board) -> CameraViews:
        """Return what was seen."""
        if self._pixels is None:
            raise RecordingError(
                "no image can be decoded", where=path / self.name, found=f"{self._images} files"
            )
        width, height = self._pixels.width, self._pixels.height
        boards = tuple(self._boards)
        return CameraViews(self.name or "camera", board, width, height, self._images, boards)

    def _found(self, finder: BoardFinder, image: Path, losses: LossLog) -> FoundBoard | None:
        try:
            stored = decode_as_stored(read_image(image))
        except UnreadableImageError as error:
            losses.add(f"image skipped, {error}", str(image))
            return None
        if self._pixels is None:
            self._pixels = grey_like(stored, image)
        return finder.find(self._pixels.from_stored(stored, image))


def _chosen(path: Path, folders: dict[str, list[Path]], names: Sequence[str] | None) -> dict[str, list[Path]]:
    for name in names or ():
        if name not in folders:
            raise RecordingError(f"no folder '{name}'", where=path, hint=nearest_name(name, folders))
    order = (
        list(names) if names else sorted(folders, key=lambda name: (name != "left", name != "right", name))
    )
    return {name: folders[name] for name in order}
