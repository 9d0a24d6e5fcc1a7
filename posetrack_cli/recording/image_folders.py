"""Where the images of each camera lie, and which of them were taken at the same time."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posetrack_cli.errors import RecordingError
from posetrack_cli.recording.image_files import GREY_SUFFIXES, list_images
from posetrack_cli.recording.stamps import STAMPS_FILE_NAME, load_stamps, stamps_at_rate

NUMBER = re.compile(r"\d+")
Stamped = list[tuple[int, Path]]
"""Stamp, ns, and image."""


@dataclass(frozen=True)
class CameraFolders:
    """The images of the cameras of a folder.

    Attributes:
        path: the recording.
        by_name: images by camera; of the folder itself under "".
    """

    path: Path
    by_name: Mapping[str, list[Path]]

    def of(self, names: Iterable[str]) -> CameraFolders:
        """Return those of some cameras, in this order."""
        return CameraFolders(self.path, {name: self.by_name[name] for name in names})

    def stamped(self, fps: float | None) -> dict[str, Stamped]:
        """Return stamp and path of every camera's images.

        Each camera's folder may have a timestamps.csv. Else images of one name, or of names with the same
        number, belong together and have a stamp from the recording's timestamps.csv or from the rate.

        Args:
            fps: frame rate, Hz; replaces every timestamps.csv.

        Raises:
            RecordingError: if there are no stamps, or they do not fit the images.
        """
        own = self._own_stamps()
        if fps is None and all(file.exists() for file in own.values()):
            return {
                name: list(zip(load_stamps(own[name], _names(images)), images, strict=True))
                for name, images in self.by_name.items()
            }
        together = self.instants()
        common = [next(iter(instant.values())) for instant in together]
        stamps = common_stamps(self.path, common, fps)
        return {
            name: [(stamp, i[name]) for stamp, i in zip(stamps, together, strict=True) if name in i]
            for name in self.by_name
        }

    def stamps_files(self, fps: float | None) -> list[Path]:
        """Return the timestamps.csv files that ``stamped`` reads."""
        if fps is not None:
            return []
        own = list(self._own_stamps().values())
        return own if all(file.exists() for file in own) else [self.path / STAMPS_FILE_NAME]

    def instants(self) -> list[dict[str, Path]]:
        """Return the images of each instant by camera: of names that tell the same, or else by position.

        Raises:
            RecordingError: names have nothing in common, and there are not as many of every camera.
        """
        folders = self.by_name
        for key in (_stem, _last_number):
            keyed = {name: {key(image): image for image in images} for name, images in folders.items()}
            is_unique = all(len(keyed[name]) == len(images) for name, images in folders.items())
            shared = set.intersection(*(set(by_key) for by_key in keyed.values()))
            if is_unique and shared and None not in set.union(*(set(k) for k in keyed.values())):
                every: list[Any] = sorted(set.union(*(set(by_key) for by_key in keyed.values())))
                return [{n: by_key[k] for n, by_key in keyed.items() if k in by_key} for k in every]
        counts = {name: len(images) for name, images in folders.items()}
        if len(set(counts.values())) > 1:
            raise RecordingError(
                "images of the cameras cannot be told to belong together",
                where=self.path,
                found=", ".join(f"{count} in {name}" for name, count in counts.items()),
                expected=f"the same names or numbers, or a {STAMPS_FILE_NAME} in each folder",
            )
        return [dict(zip(folders, images, strict=True)) for images in zip(*folders.values(), strict=True)]

    def _own_stamps(self) -> dict[str, Path]:
        """Where each camera's own timestamps.csv would be."""
        return {name: images[0].parent / STAMPS_FILE_NAME for name, images in self.by_name.items()}


def find_folders(path: Path) -> CameraFolders:
    """Return the images of each camera: of the folder itself, named "", else of its subfolders by name.

    Raises:
        RecordingError: if the folder cannot be listed or there are no images.
    """
    try:
        folders = sorted(entry for entry in path.iterdir() if entry.is_dir() and entry.name[0] != ".")
        holds_images = any(_is_image(entry) for entry in path.iterdir())
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    if holds_images or not folders:
        return CameraFolders(path, {"": list_images(path, GREY_SUFFIXES)})
    found = {folder.name: list_images(folder, GREY_SUFFIXES) for folder in folders if _has_images(folder)}
    if not found:
        raise RecordingError(
            "no images", where=path, found=f"folders {', '.join(f.name for f in folders)} without images"
        )
    return CameraFolders(path, found)


def common_stamps(path: Path, images: Sequence[Path], fps: float | None) -> list[int]:
    """Return the stamps of images, ns, from their rate or the recording's timestamps.csv.

    Raises:
        RecordingError: if there are no stamps, or they do not fit the images.
    """
    if fps is not None:
        return stamps_at_rate(len(images), fps)
    if not (path / STAMPS_FILE_NAME).exists():
        raise RecordingError(
            "no stamps", where=path, hint=f"pass --fps, or add a {STAMPS_FILE_NAME} with a stamp_ns column"
        )
    return load_stamps(path / STAMPS_FILE_NAME, _names(images))


def _stem(image: Path) -> Hashable:
    return image.stem


def _last_number(image: Path) -> Hashable:
    numbers = NUMBER.findall(image.stem)
    return int(numbers[-1]) if numbers else None


def _names(images: Sequence[Path]) -> list[str]:
    return [image.name for image in images]


def _is_image(entry: Path) -> bool:
    return entry.suffix.lower() in GREY_SUFFIXES and entry.name[0] != "." and entry.is_file()


def _has_images(folder: Path) -> bool:
    try:
        return any(_is_image(entry) for entry in folder.iterdir())
    except OSError:
        return False
