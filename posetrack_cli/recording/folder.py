"""A folder of 16-bit depth images, sorted by name, with camera.toml and stamps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.recording.camera_file import CAMERA_FILE_NAME, CameraFile, load_camera_file, no_intrinsics
from posetrack_cli.recording.depth import depth_from_codes
from posetrack_cli.recording.identity import files_digest, shown_name
from posetrack_cli.recording.image_files import (
    PNG_SIGNATURE,
    decode_codes,
    first_decoded,
    list_images,
    read_image,
)
from posetrack_cli.recording.single_camera import SingleCameraRecording
from posetrack_cli.recording.stamps import STAMPS_FILE_NAME, load_stamps, stamps_at_rate
from posetrack_cli.recording.stored import StoredFrame


class FolderRecording(SingleCameraRecording):
    """Depth frames from image files; a ``Recording``.

    Args:
        path: the folder.
        camera_file: replaces the folder's camera.toml.
        fps: frame rate, Hz; replaces the folder's timestamps.csv.
        depth_unit_mm, missing, mirror: replace the camera file's values.

    Raises:
        RecordingError: if there are no images, no intrinsics or no stamps, or the first readable image
            is not 16-bit single-channel or does not fit the camera file. Later images of another size
            or kind raise it while they are read; unreadable ones are skipped and counted.
        UsageError: if an option has a value that cannot be used.
    """

    def __init__(
        self,
        path: Path,
        *,
        camera_file: Path | None = None,
        fps: float | None = None,
        depth_unit_mm: float | None = None,
        missing: int | None = None,
        mirror: bool | None = None,
    ) -> None:
        self._images = list_images(path)
        self._camera_path = camera_path(path, camera_file)
        given = {"depth_unit_mm": depth_unit_mm, "missing": missing, "mirror": mirror}
        self._settings = override(load_camera_file(self._camera_path), given)
        self._fps = fps
        self._stamps_path = None if fps is not None else path / STAMPS_FILE_NAME
        self._stamps = self._load_stamps(path, fps)
        self._shape = first_readable(self._images).shape
        height, width = self._shape
        stored_camera = self._settings.stored_camera(width, height)
        super().__init__(path, self._settings.window.camera(stored_camera))

    @property
    def frame_count(self) -> int | None:
        """The number of image files."""
        return len(self._images)

    def identity(self) -> Mapping[str, str]:
        """Name, kind, size and SHA-256 over images, stamps and camera file, and what options replaced."""
        files = [(image.name, image) for image in self._images]
        if self._stamps_path is not None:
            files.append((STAMPS_FILE_NAME, self._stamps_path))
        files.append((CAMERA_FILE_NAME, self._camera_path))
        size, digest = files_digest(files)
        return {
            "name": shown_name(self._path.resolve()),
            "kind": "folder",
            "bytes": str(size),
            "sha256": digest,
            "frames": str(len(self._images)),
            "depth_unit_mm": str(self._settings.depth_unit_mm),
            "missing": str(self._settings.missing),
            "mirror": str(self._settings.mirror).lower(),
            **({} if self._fps is None else {"fps": str(self._fps)}),
        }

    def truth(self) -> Iterator[TruthMessage]:
        """Yield nothing: a folder carries no truth."""
        return iter(())

    def _load_stamps(self, path: Path, fps: float | None) -> list[int]:
        if self._stamps_path is None:
            return stamps_at_rate(len(self._images), fps or 0.0)
        if not self._stamps_path.exists():
            raise RecordingError(
                "no stamps",
                where=path,
                hint=f"pass --fps, or add a {STAMPS_FILE_NAME} with a stamp_ns column",
            )
        return load_stamps(self._stamps_path, [image.name for image in self._images])

    def _stored(self, losses: LossLog) -> Iterator[StoredFrame]:
        for image, stamp in zip(self._images, self._stamps, strict=True):
            yield self._stored_frame(image, stamp)

    def _stored_frame(self, image: Path, stamp_ns: int) -> StoredFrame:
        return StoredFrame(
            stamp_ns=stamp_ns,
            where=image.name,
            encoding="16UC1" if self._settings.depth_unit_mm == 1.0 else "32FC1",
            decode=lambda: self._depth(image),
            png=lambda: self._png(image),
        )

    def _depth(self, image: Path) -> ImageArray:
        codes = decode_codes(read_image(image), str(image))
        if codes.shape != self._shape:
            raise RecordingError(
                "images differ in size",
                where=image,
                found=f"{codes.shape[1]}x{codes.shape[0]}",
                expected=f"{self._shape[1]}x{self._shape[0]} as in the images before",
            )
        depth = depth_from_codes(codes, self._settings.depth_unit_mm, self._settings.missing)
        return self._settings.window.apply(depth)

    def _png(self, image: Path) -> bytes | None:
        settings = self._settings
        if settings.depth_unit_mm != 1.0 or settings.missing != 0 or not settings.window.keeps_pixels:
            return None
        data = read_image(image)
        return data if data.startswith(PNG_SIGNATURE) else None


def camera_path(folder: Path, camera_file: Path | None) -> Path:
    """Return the camera file to use: the one given, else the folder's.

    Raises:
        RecordingError: if none is given and the folder has none.
    """
    path = camera_file or folder / CAMERA_FILE_NAME
    if camera_file is None and not path.exists():
        raise no_intrinsics(folder)
    return path


def override(settings: CameraFile, given: Mapping[str, object]) -> CameraFile:
    """Return the settings with the given values that are not None in their place.

    Raises:
        UsageError: if a value cannot be used.
    """
    values = {key: value for key, value in given.items() if value is not None}
    try:
        return CameraFile.model_validate(settings.model_dump() | values)
    except ValueError as error:
        text = ", ".join(f"{key} {value}" for key, value in values.items())
        raise UsageError("depth option cannot be used", found=text) from error


def first_readable(images: list[Path]) -> ImageArray:
    """Return the codes of the first image that can be decoded.

    Raises:
        RecordingError: if none can, or it is not a 16-bit single-channel image.
    """
    return first_decoded(images, lambda image: decode_codes(read_image(image), str(image)))
