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
from posetrack_cli.recording.grey import Grey, decode_shown, grey_like
from posetrack_cli.recording.image_files import ImageFile, read_image
from posetrack_cli.recording.image_folders import CameraFolders, Instants, find_folders


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
        path: a folder with a folder of images per camera; images of one name or number, or whose names are
            stamps of about the same time, were taken at once.
        board: what to look for.
        names: of the cameras, the reference first; None for all folders, left before right.
        report: told how many images of how many are done.
        losses: gets images that cannot be decoded.

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
    """Collects what one camera saw.

    Args:
        folder: of its images.
        finder: finds the board.
        losses: gets images that cannot be decoded.

    Attributes:
        boards: of each instant.
        images: how many there are.
    """

    def __init__(self, folder: Path, finder: BoardFinder, losses: LossLog) -> None:
        self._folder, self._finder, self._losses = folder, finder, losses
        self._pixels: Grey | None = None
        self.boards: list[FoundBoard | None] = []
        self.images = 0

    def add(self, image: ImageFile | None) -> None:
        """Look at the image of the next instant, None if there is none."""
        self.images += image is not None
        self.boards.append(None if image is None else self._found(image))

    def size(self) -> tuple[int, int]:
        """Return width and height of its images, pixels."""
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
        reason = str(error).partition(";")[0]  # recordings have an option for it
        raise RecordingError(reason, hint="give images of one instant the same name or number") from error


def _chosen(folders: CameraFolders, names: Sequence[str] | None) -> Sequence[str]:
    """The cameras that are named, all of them by default, left before right."""
    for name in names or ():
        if name not in folders.by_name:
            hint = nearest_name(name, folders.by_name)
            raise RecordingError(f"no folder '{name}'", where=folders.path, hint=hint)
    return names or sorted(folders.by_name, key=lambda name: (name != "left", name != "right", name))
