"""A folder of grey images, or a folder with one folder of images per camera, with camera.toml and stamps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.camera_file import CAMERA_FILE_NAME
from posetrack_cli.recording.depth import Window
from posetrack_cli.recording.grey import StoredKind, decode_as_stored, decode_grey, kind_of_image
from posetrack_cli.recording.guess import Guess, check_one_camera
from posetrack_cli.recording.identity import files_digest, shown_name
from posetrack_cli.recording.image_files import first_decoded, read_image
from posetrack_cli.recording.image_folders import Stamped, find_folders, stamped_images, stamps_files
from posetrack_cli.recording.matching import NS_PER_MS, StoredImage, StoredImages, match_images
from posetrack_cli.recording.rig_file import Rig, found_rig, load_rig
from posetrack_cli.recording.several_cameras import DEFAULT_TOLERANCE_MS, SeveralCamerasRecording


class ImagesFolderRecording(SeveralCamerasRecording):
    """Grey images of one or more cameras from files; a ``Recording``.

    Args:
        path: a folder of images (one camera), or one with a folder of images for each camera.
        cameras: names of those to use; None for all.
        camera_file: replaces the folder's camera.toml.
        fps: frame rate, Hz; replaces timestamps.csv.
        mirror: replaces the camera file's value.
        tolerance_ms: largest difference of stamps within a frame.
        guess: of the only camera, where it is not calibrated.

    Raises:
        RecordingError: if there are no images, no stamps, a camera is not calibrated or has no folder, or
            sizes do not fit. Later images of another size raise it while they are read; unreadable ones are
            left out and counted.
        UsageError: if an option has a value that cannot be used.
    """

    def __init__(
        self,
        path: Path,
        *,
        cameras: Sequence[str] | None = None,
        camera_file: Path | None = None,
        fps: float | None = None,
        mirror: bool | None = None,
        tolerance_ms: float = DEFAULT_TOLERANCE_MS,
        guess: Guess | None = None,
    ) -> None:
        folders = find_folders(path)
        self._rig = _rig_of(path, folders, camera_file, cameras, guess)
        self._folders = _folders_of(path, self._rig, folders)
        self._fps = fps
        self._images = stamped_images(path, self._folders, fps)
        self._kinds = {name: _first_kind(self._rig, name, images) for name, images in self._folders.items()}
        self._mirror = self._rig.mirror if mirror is None else mirror
        self._windows = {name: self._rig.window(name, self._mirror) for name in self._folders}
        cameras_in_use, tolerance = self._windowed_cameras(), round(tolerance_ms * NS_PER_MS)
        super().__init__(path, cameras_in_use, tolerance, is_guessed=self._rig.is_guessed)
        self._frame_count = sum(1 for _ in self.matched())

    @property
    def frame_count(self) -> int | None:
        """The number of instants at which any camera took an image."""
        return self._frame_count

    def identity(self) -> Mapping[str, str]:
        """Name, kind, size and SHA-256 over images, stamps and camera file, and how it was read."""
        files = [(_label(name, image), image) for name, images in self._folders.items() for image in images]
        stamps = stamps_files(self._path, self._folders, self._fps)
        files += [(f"{number} {file.name}", file) for number, file in enumerate(stamps)]
        files += [] if self.is_guessed else [(CAMERA_FILE_NAME, self._rig.path)]
        size, digest = files_digest(files)
        return {
            "name": shown_name(self._path.resolve()),
            "kind": "folder",
            "bytes": str(size),
            "sha256": digest,
            "frames": str(self._frame_count),
            "cameras": ",".join(camera.name for camera in self._cameras),
            "stored": ", ".join(dict.fromkeys(kind.words for kind in self._kinds.values())),
            "mirror": str(self._mirror).lower(),
            "tolerance_ms": f"{self._tolerance_ns / NS_PER_MS:g}",
            **({} if self._fps is None else {"fps": str(self._fps)}),
        }

    def _windowed_cameras(self) -> list[Camera]:
        sizes = {name: (kind.width, kind.height) for name, kind in self._kinds.items()}
        stored = self._rig.stored_cameras(sizes)
        return [
            self._windows[name].camera(camera) for name, camera in zip(self._folders, stored, strict=True)
        ]

    def matched(self) -> Iterator[StoredImages]:
        """Yield all frames undecoded."""
        names = [camera.name for camera in self._cameras]
        return match_images(names, self._streams(LossLog()), self._tolerance_ns, LossLog())

    def _streams(self, losses: LossLog) -> Sequence[Iterator[StoredImage | None]]:
        return [self._stream(name, images) for name, images in self._images.items()]

    def _stream(self, name: str, images: Stamped) -> Iterator[StoredImage | None]:
        kind, window = self._kinds[name], self._windows[name]
        for stamp, image in images:
            yield StoredImage(stamp, _label(name, image), partial(_grey, image, kind, window))


def _rig_of(
    path: Path,
    folders: Mapping[str, object],
    camera_file: Path | None,
    names: Sequence[str] | None,
    guess: Guess | None,
) -> Rig:
    """Return the cameras to use; one of them if intrinsics may be guessed."""
    rig = _named_rig(path, folders, found_rig(path, _camera_file(path, camera_file), folders, guess), names)
    if guess is not None:
        check_one_camera(path, rig.cameras)
    return rig


def _named_rig(path: Path, folders: Mapping[str, object], rig: Rig, names: Sequence[str] | None) -> Rig:
    """Return the cameras to use, by what the folders and the camera file are called."""
    if names is not None:
        return rig.chosen(names)
    _check_calibrated(path, rig, folders)
    if "" not in folders or len(rig.cameras) == 1:
        return rig
    name = path.resolve().name
    if name not in rig.cameras:
        known = ", ".join(rig.cameras)
        raise RecordingError(
            "one folder of images and several cameras",
            where=path,
            found=known,
            hint="choose one with --cameras",
        )
    return rig.chosen([name])


def _camera_file(path: Path, given: Path | None) -> Path | None:
    """The camera file given, the folder's own, or that of the recording the folder is a camera of, if any."""
    above = path.resolve().parent / CAMERA_FILE_NAME
    own = path / CAMERA_FILE_NAME
    if given is not None or own.exists():
        return given or own
    if above.exists() and path.resolve().name in load_rig(above).cameras:
        return above
    return None


def _folders_of(path: Path, rig: Rig, folders: Mapping[str, list[Path]]) -> dict[str, list[Path]]:
    """Return the images of each camera of the rig, in its order."""
    if len(folders) == len(rig.cameras) == 1:
        return {next(iter(rig.cameras)): next(iter(folders.values()))}
    found = ", ".join(folders) if "" not in folders else "images of one camera"
    if "" in rig.cameras:
        hint = "write a table [cameras.NAME] for each; posetrack calibrate stereo measures them"
        raise RecordingError("several cameras and the calibration of one", where=path, found=found, hint=hint)
    for name in rig.cameras:
        if name not in folders:
            raise RecordingError(
                f"no images of camera '{name}'", where=path, found=found, expected=f"a folder {name}"
            )
    return {name: folders[name] for name in rig.cameras}


def _check_calibrated(path: Path, rig: Rig, folders: Mapping[str, object]) -> None:
    """Refuse folders of images of cameras that the file does not know, as long as nobody chose."""
    unknown = [name for name in folders if name and name not in rig.cameras]
    if unknown and "" not in rig.cameras:
        raise RecordingError(
            f"camera '{unknown[0]}' is not calibrated",
            where=path,
            found=f"[cameras.NAME] of {', '.join(rig.cameras)} in {rig.path.name}",
            hint="posetrack calibrate stereo measures cameras; --cameras leaves some out",
        )


def _first_kind(rig: Rig, name: str, images: list[Path]) -> StoredKind:
    """Tell what a camera's images are like from the first that can be decoded."""
    bits = rig.cameras[name].bits
    return first_decoded(
        images, lambda image: kind_of_image(decode_as_stored(read_image(image)), image, bits)
    )


def _grey(image: Path, kind: StoredKind, window: Window) -> ImageArray:
    return window.apply(decode_grey(read_image(image), kind, image))


def _label(name: str, image: Path) -> str:
    return f"{name}/{image.name}" if name else image.name
