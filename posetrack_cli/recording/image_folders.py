"""Image folders of cameras: finding them, stamps, and images taken at the same time."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from posetrack_cli.errors import RecordingError
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import CAMERA_FILE_NAME, StoredImage, UnreadableImageError
from posetrack_cli.recording.image_files import (
    DEPTH_SUFFIXES,
    GREY_SUFFIXES,
    ImageFile,
    ListedImages,
    decode_any,
    first_decoded,
    listed_images,
    read_image,
)
from posetrack_cli.recording.image_lists import (
    CAMERA_IMAGES,
    DEPTH_WORD,
    ImageList,
    camera_list,
    colour_list,
    depth_list,
    load_times,
)
from posetrack_cli.recording.matching import NS_PER_MS, match_images
from posetrack_cli.recording.recording import DEFAULT_TOLERANCE_MS
from posetrack_cli.recording.stamps import (
    DIGITS,
    STAMPS_FILE_NAME,
    NameStamps,
    layouts_of_one_sequence,
    load_stamps,
    natural_order,
    number,
    numbered_sequence,
    stamp_at_rate,
    stamps_at_rate,
    stamps_in_names,
    varying_numbers,
)

Stamped = list[tuple[int, ImageFile]]  # stamp, ns, and image
Instants = list[dict[str, ImageFile]]  # images of each instant by camera
TOLERANCE_NS = round(DEFAULT_TOLERANCE_MS * NS_PER_MS)
DEPTH_TYPES = (np.uint16, np.float32)  # data types that mark a folder as depth
# Share of the smaller folder's names that all cameras must have, unless names count frames.
SHARED = 0.5
COLOUR_WORDS = ("color", "colour", "rgb")  # mark colour images among other kinds
RATE_DIFFERENCE = 0.05  # relative tolerance of a stated rate: 24 frames/s is not called 25
# Numbers further apart on average are times, not frame counts: times in ms are at least 8 apart.
SPARSE = 5


@dataclass(frozen=True)
class Timing:
    """Stamps of the images of each camera.

    Attributes:
        stamped: stamps and images by camera.
        files: files read for the stamps.
        remarks: source of the stamps unless timestamps.csv or a given rate, and gaps.
        fps: frame rate of synthetic stamps, Hz; None if stamps are stored.
    """

    stamped: dict[str, Stamped]
    files: list[Path] = field(default_factory=list)
    remarks: tuple[str, ...] = ()
    fps: float | None = None


@dataclass(frozen=True)
class CameraFolders:
    """The images of a folder's cameras.

    Attributes:
        path: the recording.
        by_name: images by camera; the folder itself is "".
        remarks: remarks by camera.
        lists: image lists by camera, if any.
    """

    path: Path
    by_name: Mapping[str, list[ImageFile]]
    remarks: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    lists: Mapping[str, ImageList] = field(default_factory=dict)

    def of(self, names: Iterable[str]) -> CameraFolders:
        """Return the named cameras only, in this order."""
        return self._renamed({name: name for name in names})

    def renamed(self, name: str) -> CameraFolders:
        """Return the only camera under another name."""
        (own,) = self.by_name
        return self._renamed({name: own})

    def without_depth(self, named: Iterable[str] = ()) -> CameraFolders:
        """Return the cameras without depth folders, except ``named``; all if only depth remains."""
        kept = [name for name in self.by_name if DEPTH_WORD not in name.lower() or name in named]
        if not kept or len(kept) == len(self.by_name):
            return self
        left = ", ".join(name for name in self.by_name if name not in kept)
        chosen = self.of(kept)
        said = (*chosen.remarks.get(kept[0], ()), f"folders not read: {left}")
        return replace(chosen, remarks={**chosen.remarks, kept[0]: said})

    def _renamed(self, names: Mapping[str, str]) -> CameraFolders:
        """Return the cameras in ``names``, which maps new names to present ones."""
        return CameraFolders(
            self.path,
            {new: self.by_name[name] for new, name in names.items()},
            {new: self.remarks[name] for new, name in names.items() if name in self.remarks},
            {new: self.lists[name] for new, name in names.items() if name in self.lists},
        )

    @property
    def every_remark(self) -> tuple[str, ...]:
        """The remarks on all cameras, without duplicates."""
        return tuple(dict.fromkeys(remark for remarks in self.remarks.values() for remark in remarks))

    def timing(
        self, fps: float | None, tolerance_ns: int = TOLERANCE_NS, nominal_fps: float | None = None
    ) -> Timing:
        """Return the stamps and images of every camera.

        Stamps come from a timestamps.csv in each camera's folder, or from lists or file names; else images
        of one instant (``instants``) get a stamp from the recording's timestamps.csv or from the rate. A
        rate overrides every timestamps.csv, but not stamps in lists and names that contradict it.

        Args:
            fps: frame rate, Hz.
            tolerance_ns: maximum stamp difference within an instant.
            nominal_fps: rate for images without stamps.

        Raises:
            RecordingError: there are no stamps, or they do not match the images.
            UsageError: the rate is out of range.
        """
        if fps is not None:
            stamps_at_rate(0, fps)  # validates the rate
        own = self._own_stamps()
        if fps is None and all(file.exists() for file in own.values()):
            return Timing(
                {
                    name: list(zip(load_stamps(own[name], _names(images)), images, strict=True))
                    for name, images in self.by_name.items()
                },
                list(own.values()),
            )
        common = self.path / STAMPS_FILE_NAME
        held = self._stamps_from_names()
        if held and (not common.exists() if fps is None else not all(s.fit_rate(fps) for s in held.values())):
            _check_rate(self.path, held, fps)
            return self._timing_from_names(held, fps)
        together = self.instants(tolerance_ns)
        firsts = [next(iter(instant.values())) for instant in together]
        remarks: tuple[str, ...] = ()
        files = [common]
        if fps is None and common.exists():
            stamps = load_stamps(common, _names(firsts))
        elif fps is None and (times := load_times(self.path, len(firsts))) is not None:
            stamps, files = list(times[1].stamps_ns), [times[0]]
            remarks = (f"stamps from {times[0].name}, {times[1].words}",)
        else:
            fps = nominal_fps if fps is None else fps
            if fps is None:
                _raise_no_stamps(self.path, firsts)
            stamps, remarks = _at_rate(firsts, fps)
            files = []
        stamped = {
            name: [(stamp, i[name]) for stamp, i in zip(stamps, together, strict=True) if name in i]
            for name in self.by_name
        }
        return Timing(stamped, files, remarks, fps)

    def instants(self, tolerance_ns: int = TOLERANCE_NS) -> Instants:
        """Return the images of each instant by camera.

        Images are matched by nearest stamps in lists or names, or by equal names or numbers; names without
        numbers, and numbers in equal steps, by position.

        Args:
            tolerance_ns: maximum stamp difference.

        Raises:
            RecordingError: names do not determine which images belong together.
        """
        folders = self.by_name
        if len(folders) == 1:
            (name,) = folders
            return [{name: image} for image in folders[name]]
        if held := self._stamps_from_names():
            return _nearest(folders, held, tolerance_ns)
        numbers = {name: varying_numbers([i.stem for i in images]) for name, images in folders.items()}
        keys: tuple[Mapping[str, Sequence[Hashable]], ...] = (
            {name: [_stem(image) for image in images] for name, images in folders.items()},
            {name: [_last_number(image) for image in images] for name, images in folders.items()},
            {name: values or [] for name, values in numbers.items()},
        )
        for key in keys:
            if together := _by_key(folders, key):
                return together
        if len({len(images) for images in folders.values()}) == 1 and _in_step(list(numbers.values())):
            return [dict(zip(folders, images, strict=True)) for images in zip(*folders.values(), strict=True)]
        raise RecordingError(
            "images of the cameras cannot be matched",
            where=self.path,
            found=", ".join(f"{len(images)} in {name}" for name, images in folders.items())
            + f" named {' and '.join(f'{i[0].name} to {i[-1].name}' for i in folders.values())}",
            expected=f"equal names or numbers, stamps as names, or a {STAMPS_FILE_NAME} in each folder",
        )

    def _timing_from_names(self, held: Mapping[str, NameStamps], fps: float | None) -> Timing:
        stamped = {
            name: list(zip(stamps.stamps_ns, self.by_name[name], strict=True))
            for name, stamps in held.items()
        }
        remarks = []
        for name, stamps in held.items():
            listed = self.lists.get(name)
            source = "file names" if listed is None or listed.stamps is None else listed.path.name
            remarks.append(f"stamps from {source}{f' of {name}' if len(held) > 1 else ''}, {stamps.words}")
        if fps is not None:
            remarks.append(
                f"{fps:g} frames/s is ignored, the stamps contradict it; to override them, add a "
                f"{STAMPS_FILE_NAME} and omit --fps"
            )
        return Timing(stamped, [one.path for one in self.lists.values()], tuple(remarks))

    def _stamps_from_names(self) -> dict[str, NameStamps]:
        """Return the stamps in lists or names; empty unless all cameras have them."""
        held = {}
        for name, images in self.by_name.items():
            listed = self.lists.get(name)
            found = None if listed is None else listed.stamps
            found = found or stamps_in_names([image.stem for image in images])
            if found is None:
                return {}
            held[name] = found
        return held

    def _own_stamps(self) -> dict[str, Path]:
        """Return the path of each camera's own timestamps.csv, which may not exist."""
        return {name: images[0].parent / STAMPS_FILE_NAME for name, images in self.by_name.items()}


def find_folders(path: Path) -> CameraFolders:
    """Return the images of each camera.

    They are those of the folder itself, named "", or listed in its rgb.txt; else those of its subfolders by
    name, or of a folder ``data`` in each of them.

    Raises:
        RecordingError: the folder cannot be listed or has no images.
    """
    folders, holds_images = _entries(path)
    if holds_images:
        return _single(path, _of_one_kind(path, listed_images(path, GREY_SUFFIXES), is_depth=False))
    if (listed := camera_list(path, GREY_SUFFIXES)) is not None:
        return _of_list(path, "", listed)
    if (listed := colour_list(path)) is not None:
        return _of_list(path, listed.images[0].parent.name, listed)
    if not folders:
        return _single(path, listed_images(path, GREY_SUFFIXES))
    found = {folder.name: listed_images(folder, GREY_SUFFIXES) for folder in folders if _has_images(folder)}
    if found:
        return CameraFolders(
            path, {n: one.images for n, one in found.items()}, {n: one.remarks for n, one in found.items()}
        )
    inner = [folder for folder in folders if _has_images(folder / CAMERA_IMAGES)]
    if inner:
        return _joined(path, inner)
    below = [folder for folder in folders if any(_has_images(f / CAMERA_IMAGES) for f in _subfolders(folder))]
    if len(below) == 1:
        found_below = find_folders(below[0])
        is_above = (path / CAMERA_FILE_NAME).exists()
        return CameraFolders(
            path if is_above else below[0], found_below.by_name, found_below.remarks, found_below.lists
        )
    raise RecordingError(
        "no images", where=path, found=f"folders without images: {', '.join(f.name for f in folders)}"
    )


def find_depth(path: Path) -> CameraFolders:
    """Return the depth images of a folder as one camera.

    They are its own, those listed in its depth.txt or associations.txt, or those of the only subfolder with
    16-bit single-channel images.

    Raises:
        RecordingError: there are no images, or several such folders.
    """
    folders, holds_images = _entries(path, DEPTH_SUFFIXES)
    if holds_images or not folders:
        return _single(path, _of_one_kind(path, listed_images(path), is_depth=True))
    if (below := depth_below(path)) is not None:
        return below
    found = [folder for folder in folders if _has_images(folder, DEPTH_SUFFIXES) and _holds_depth(folder)]
    if len(found) == 1:
        return _subfolder(path, found[0])
    if found:
        names = ", ".join(folder.name for folder in found)
        raise RecordingError(
            "several folders of 16-bit images",
            where=path,
            found=names,
            hint=f"pass one of them, e.g. {path / found[0].name}",
        )
    names = ", ".join(folder.name for folder in folders)
    raise RecordingError(
        "no depth images", where=path, found=f"folders {names}", expected="16-bit single-channel images"
    )


def depth_below(path: Path) -> CameraFolders | None:
    """Return a folder's listed depth images, or those of its only depth subfolder; None without.

    Raises:
        RecordingError: a list is invalid.
    """
    folders, holds_images = _entries(path)
    if holds_images:
        return None
    if (listed := depth_list(path)) is not None:
        return _of_list(path, "", listed)
    named = [folder for folder in folders if DEPTH_WORD in folder.name.lower() and _holds_depth(folder)]
    return _subfolder(path, named[0]) if len(named) == 1 else None


def _subfolder(path: Path, folder: Path) -> CameraFolders:
    listed = listed_images(folder)
    remark = f"depth is read from {folder.name}/"
    return CameraFolders(path, {"": listed.images}, {"": (remark, *listed.remarks)})


def _entries(path: Path, suffixes: tuple[str, ...] = GREY_SUFFIXES) -> tuple[list[Path], bool]:
    """Return the sorted subfolders, empty if the folder has images, and whether it has any."""
    try:
        holds_images = any(_is_image(entry, suffixes) for entry in path.iterdir())
        return [] if holds_images else _subfolders(path), holds_images
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def _subfolders(path: Path) -> list[Path]:
    found = [entry for entry in path.iterdir() if entry.is_dir() and entry.name[0] != "."]
    order = natural_order([folder.name for folder in found])
    return [found[i] for i in order]


def _single(path: Path, listed: ListedImages) -> CameraFolders:
    return CameraFolders(path, {"": listed.images}, {"": listed.remarks})


def _of_list(path: Path, name: str, listed: ImageList) -> CameraFolders:
    return CameraFolders(path, {name: listed.images}, {name: listed.remarks}, {name: listed})


def _of_one_kind(path: Path, listed: ListedImages, *, is_depth: bool) -> ListedImages:
    """Return the depth images, or the others, of a folder with several kinds per frame.

    Raises:
        RecordingError: names do not identify them.
    """
    kinds = layouts_of_one_sequence([image.stem for image in listed.images])
    if not kinds:
        return listed
    named = [text for text in kinds if (DEPTH_WORD in text.lower()) == is_depth]
    coloured = [text for text in named if any(word in text.lower() for word in COLOUR_WORDS)]
    chosen = named if len(named) == 1 else coloured
    if len(chosen) != 1:
        raise RecordingError(
            "several kinds of images in one folder",
            where=path,
            found=", ".join(listed.images[positions[0]].name for positions in kinds.values()),
            hint="move the images of each camera to their own folder",
        )
    images = [listed.images[i] for i in kinds[chosen[0]]]
    remark = f"read {len(images)} of {len(listed.images)} images, named like {images[0].name}"
    return ListedImages(images, (remark, *listed.remarks))


def _joined(path: Path, cameras: Sequence[Path]) -> CameraFolders:
    lists = {camera.name: camera_list(camera, GREY_SUFFIXES) for camera in cameras}
    listed = {name: one for name, one in lists.items() if one is not None}
    found = {
        camera.name: listed_images(camera / CAMERA_IMAGES, GREY_SUFFIXES)
        for camera in cameras
        if camera.name not in listed
    }
    images = {name: one.images for name, one in (listed | found).items()}
    remarks = {name: one.remarks for name, one in (listed | found).items()}
    return CameraFolders(path, images, remarks, listed).of([camera.name for camera in cameras])


def _holds_depth(folder: Path) -> bool:
    """Return whether the first decodable image has 16 bits (or float32) and one channel."""
    try:
        first = first_decoded(listed_images(folder).images, lambda image: decode_any(read_image(image)))
    except RecordingError:
        return False
    return first.ndim == 2 and first.dtype in DEPTH_TYPES


def _at_rate(images: Sequence[ImageFile], fps: float) -> tuple[list[int], tuple[str, ...]]:
    """Return stamps at a rate, with gaps for missing numbers of a sequence, and a remark on them."""
    stems = [image.stem for image in images]
    sequence = numbered_sequence(stems)
    if sequence is None and len({image.parent for image in images}) > 1:  # instants missing one camera
        sequence = numbered_sequence([str(_last_number(image)) for image in images])
    if sequence is None:
        return stamps_at_rate(len(images), fps), ()
    lost = sequence.positions[-1] + 1 - len(images)
    remark = f"{sequence.words} missing: assuming {lost} lost frame{'s' if lost > 1 else ''}"
    return [stamp_at_rate(position, fps) for position in sequence.positions], (remark,)


def _check_rate(path: Path, held: Mapping[str, NameStamps], fps: float | None) -> None:
    """Raise RecordingError if a given rate contradicts stamps recognised by their rate alone."""
    for stamps in held.values():
        if fps is not None and stamps.is_count and abs(stamps.rate_hz / fps - 1.0) > RATE_DIFFERENCE:
            raise RecordingError(
                "numbers in file names look like stamps that contradict --fps",
                where=path,
                found=f"{stamps.words}: {stamps.rate_hz:.4g} frames/s",
                expected=f"{fps:g} frames/s",
                hint=f"omit --fps to use them, or add a {STAMPS_FILE_NAME}",
            )


def _raise_no_stamps(path: Path, images: Sequence[ImageFile]) -> NoReturn:
    """Raise RecordingError for images without stamps, naming numbers that could be stamps."""
    numbers = [value[0] for value in varying_numbers([i.stem for i in images]) or [] if len(value) == 1]
    steps = {b - a for a, b in pairwise(numbers)}
    is_unclear = len(numbers) == len(images) and steps and min(steps) > 1
    raise RecordingError(
        "no stamps",
        where=path,
        found=f"numbers {numbers[0]} to {numbers[-1]}, either times or counts" if is_unclear else "",
        hint=f"pass --fps, or add a {STAMPS_FILE_NAME} with a stamp_ns column",
    )


def _nearest(
    folders: Mapping[str, list[ImageFile]], held: Mapping[str, NameStamps], tolerance_ns: int
) -> Instants:
    """Match images whose stamps differ by at most the tolerance, as ``match_images`` does."""
    by_stamp = {
        name: dict(zip(held[name].stamps_ns, images, strict=True)) for name, images in folders.items()
    }
    streams = [
        iter([StoredImage(stamp, name, _no_pixels) for stamp in sorted(images)])
        for name, images in by_stamp.items()
    ]
    return [
        {image.where: by_stamp[image.where][image.stamp_ns] for image in frame.images if image is not None}
        for frame in match_images(list(folders), streams, tolerance_ns, LossLog())
    ]


def _no_pixels() -> NoReturn:
    raise UnreadableImageError("placeholder for matching by stamp")


def _by_key(folders: Mapping[str, list[ImageFile]], keys: Mapping[str, Sequence[Hashable]]) -> Instants:
    """Match images by a key of their names; empty unless the key identifies images."""
    keyed = {name: dict(zip(keys[name], images, strict=False)) for name, images in folders.items()}
    if any(
        len(keyed[name]) < len(images) or {None, ()} & set(keyed[name]) for name, images in folders.items()
    ):
        return []
    shared = set.intersection(*(set(by_key) for by_key in keyed.values()))
    fewest = min(len(images) for images in folders.values())
    is_chance = len(shared) < SHARED * fewest and not all(map(_is_frame_count, folders.values()))
    if not shared or is_chance:
        return []
    every: list[Any] = list(set.union(*(set(by_key) for by_key in keyed.values())))
    ordered = [every[i] for i in natural_order(every)] if isinstance(every[0], str) else sorted(every)
    return [{n: by_key[k] for n, by_key in keyed.items() if k in by_key} for k in ordered]


def _is_frame_count(images: Sequence[ImageFile]) -> bool:
    """Return whether the last numbers of names are dense enough for frame counts with gaps."""
    numbers = [value for value in map(_last_number, images) if value is not None]
    return bool(numbers) and max(numbers) - min(numbers) <= SPARSE * len(numbers)


def _in_step(numbers: Sequence[list[tuple[int, ...]] | None]) -> bool:
    """Return whether names are consistent with images taken together one by one.

    Names have no varying numbers, or those of all cameras increase by the same steps.
    """
    steps = {
        tuple(
            tuple(b - a for a, b in zip(value, following, strict=True))
            for value, following in pairwise(values)
        )
        for values in numbers
        if values and values[0]
    }
    has_all = sum(bool(values and values[0]) for values in numbers) in (0, len(numbers))
    return len(steps) <= 1 and (has_all or all(len(set(one)) <= 1 for one in steps))


def _stem(image: ImageFile) -> str:
    return image.stem if image.page is None else image.name


def _last_number(image: ImageFile) -> int | None:
    numbers = DIGITS.findall(image.stem)
    return number(numbers[-1]) if numbers and image.page is None else None


def _names(images: Sequence[ImageFile]) -> list[str]:
    return [image.name for image in images]


def _is_image(entry: Path, suffixes: tuple[str, ...] = GREY_SUFFIXES) -> bool:
    return entry.suffix.lower() in suffixes and entry.name[0] != "." and entry.is_file()


def _has_images(folder: Path, suffixes: tuple[str, ...] = GREY_SUFFIXES) -> bool:
    try:
        return any(_is_image(entry, suffixes) for entry in folder.iterdir())
    except OSError:
        return False
