"""Image lists with stamps: depth.txt, rgb.txt and associations.txt of TUM, data.csv of EuRoC.

Listed names are compared with existing images and never used as paths.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

from posetrack_cli.errors import RecordingError
from posetrack_cli.recording.image_files import GREY_SUFFIXES, ImageFile, list_images
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.recording.stamps import NameStamps, stamps_in_names
from posetrack_cli.tables import COMMENT, TextFile
from posetrack_cli.units import NS_PER_S

DEPTH_LISTS, COLOUR_LISTS = ("depth.txt",), ("rgb.txt", "color.txt", "colour.txt")
ASSOCIATIONS = re.compile(r"assoc\w*\.txt", re.IGNORECASE)
CAMERA_LIST, CAMERA_IMAGES = "data.csv", "data"  # EuRoC camera folder: list, image folder
TIMES_FILES = ("times.txt", "timestamps.txt")  # KITTI: one stamp per line
DEPTH_WORD = "depth"
STAMP = re.compile(r"[0-9]{1,20}(\.[0-9]{0,20})?([eE][+-]?[0-9]{1,2})?")
# Smaller steps are image numbers: 0.1 ms would be 10,000 images per second.
LEAST_STEP_NS = 100_000
EXPECTED = "each line must have a stamp and a file name"


@dataclass(frozen=True)
class ImageList:
    """Images in the order of a list.

    Attributes:
        path: the list.
        images: existing images, in stamp order.
        stamps: their stamps, None if the list only numbers them.
        remarks: remarks on missing and unlisted images.
    """

    path: Path
    images: list[ImageFile]
    stamps: NameStamps | None
    remarks: tuple[str, ...]


def depth_list(folder: Path) -> ImageList | None:
    """Return the depth images in a folder's depth.txt or associations.txt; None without a list.

    Raises:
        RecordingError: the list cannot be read, or none of its images exists.
    """
    return _tum_list(folder, DEPTH_LISTS, is_depth=True)


def colour_list(folder: Path) -> ImageList | None:
    """Return the images in a folder's rgb.txt or associations.txt; None without a list.

    Raises:
        RecordingError: the list cannot be read, or none of its images exists.
    """
    return _tum_list(folder, COLOUR_LISTS, is_depth=False)


def camera_list(folder: Path, suffixes: tuple[str, ...]) -> ImageList | None:
    """Return the images of a camera folder with data.csv and data/, None without them.

    Raises:
        RecordingError: the list cannot be read, or none of its images exists.
    """
    path, images = folder / CAMERA_LIST, folder / CAMERA_IMAGES
    if not path.is_file() or not images.is_dir():
        return None
    existing = {image.name: image for image in list_images(images, suffixes)}
    return _listed(path, [(row[0], row[1]) for row in _rows(path)], existing, "ns")


def load_times(folder: Path, count: int) -> tuple[Path, NameStamps] | None:
    """Return the stamps in a folder's times.txt or timestamps.txt (KITTI); None without it.

    Args:
        folder: folder of the recording.
        count: number of images, one line each.

    Raises:
        RecordingError: a line is not a stamp, or the number of lines differs.
    """
    path = next((folder / name for name in TIMES_FILES if (folder / name).is_file()), None)
    if path is None:
        return None
    texts = [line for _, line in _lines(path)]
    if len(texts) != count:
        raise RecordingError(
            "numbers of stamps and images differ",
            where=path,
            found=f"{len(texts)} lines",
            expected=f"{count}, one per image",
            hint="to ignore the file pass --fps",
        )
    stamps = stamps_in_names(texts) or _stamps(texts, "s", path)
    if stamps is None:
        raise RecordingError(
            "lines may be times or image numbers",
            where=path,
            found=f"{texts[0]} to {texts[-1]}",
            hint="pass --fps",
        )
    return path, stamps


def _tum_list(folder: Path, names: Sequence[str], *, is_depth: bool) -> ImageList | None:
    for name in names:
        if (folder / name).is_file():
            entries = [(row[0], row[1]) for row in _rows(folder / name)]
            return _listed(folder / name, entries, _images_below(folder, entries), "s")
    try:
        found = sorted(e for e in folder.iterdir() if ASSOCIATIONS.fullmatch(e.name) and e.is_file())
    except OSError:
        return None
    for path in found[:1]:
        entries = list(_of_kind(_rows(path), is_depth=is_depth))
        if entries:
            return _listed(path, entries, _images_below(folder, entries), "s")
    return None


def _of_kind(rows: Sequence[list[str]], *, is_depth: bool) -> Iterator[tuple[str, str]]:
    """Yield stamp and name of the depth (or other) image in rows that list both."""
    for row in rows:
        for stamp, name in zip(row[::2], row[1::2], strict=False):
            if (DEPTH_WORD in name.lower()) == is_depth:
                yield stamp, name
                break


def _rows(path: Path) -> list[list[str]]:
    """Return the cells of lines that begin with a stamp, without comments and header.

    Raises:
        RecordingError: the file is too large, or a line lacks a stamp or name.
    """
    rows: list[list[str]] = []
    for number, line in _lines(path):
        cells = line.replace(",", " ").split()
        if not cells:
            continue
        if len(cells) < 2 or not STAMP.fullmatch(cells[0]):
            if not rows and not STAMP.fullmatch(cells[0]):  # a header
                continue
            raise RecordingError(
                "not an entry of an image list",
                where=f"{path} line {number}",
                found=f"'{line.strip()[:80]}'",
                expected="a stamp and a file name",
            )
        rows.append(cells)
    return rows


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the numbered lines of a list, without comments and empty lines."""
    for number, line in TextFile(path, RecordingError, EXPECTED).lines():
        if line.strip() and not line.startswith(COMMENT):
            yield number, line.strip()


def _images_below(folder: Path, entries: Sequence[tuple[str, str]]) -> dict[str, ImageFile]:
    """Return images by listed name: in the folder and in the subfolders that entries name."""
    wanted = {name.rpartition("/")[0] for name in map(_plain, (name for _, name in entries))}
    existing: dict[str, ImageFile] = {}
    try:
        in_folder = sorted(folder.iterdir())
    except OSError as error:
        raise RecordingError("cannot be read", where=folder, found=error.strerror or error) from error
    for entry in in_folder:
        if entry.name in wanted and entry.is_dir():
            existing |= {f"{entry.name}/{image.name}": image for image in list_images(entry, GREY_SUFFIXES)}
    if "" in wanted:
        existing |= {image.name: image for image in list_images(folder, GREY_SUFFIXES)}
    return existing


def _plain(name: str) -> str:
    return name.replace("\\", "/").removeprefix("./")


def _listed(
    path: Path, entries: Sequence[tuple[str, str]], existing: dict[str, ImageFile], unit: str
) -> ImageList:
    known = [
        (stamp, existing[name]) for stamp, name in ((s, _plain(n)) for s, n in entries) if name in existing
    ]
    if not known:
        found = f"{len(entries)} lines, the first for {entries[0][1]}" if entries else "no lines"
        raise RecordingError("no listed image exists", where=path, found=found)
    remarks = []
    if len(known) < len(entries):
        missing = next(name for _, name in entries if _plain(name) not in existing)
        count = len(entries) - len(known)
        remarks.append(f"{count} of {len(entries)} images in {path.name} are missing, first {missing}")
    if len({image.name for _, image in known}) < len(existing):
        count = len(existing) - len({image.name for _, image in known})
        remarks.append(f"skipped {count} images not listed in {path.name}")
    stamps = _stamps([stamp for stamp, _ in known], unit, path)
    if stamps is None:
        return ImageList(path, [image for _, image in known], None, tuple(remarks))
    order = sorted(range(len(known)), key=stamps.stamps_ns.__getitem__)
    ordered = NameStamps(stamps.unit, tuple(stamps.stamps_ns[i] for i in order))
    return ImageList(path, [known[i][1] for i in order], ordered, tuple(remarks))


def _stamps(texts: Sequence[str], unit: str, path: Path) -> NameStamps | None:
    """Return the stamps of a list in their recognised unit, else the default one.

    None if they are image numbers: integers in equal steps.
    """
    for text in texts:
        if not STAMP.fullmatch(text):
            raise RecordingError("stamp is not a number", where=path, found=f"'{text[:80]}'")
    recognised = stamps_in_names(texts)
    if recognised is not None:
        return recognised
    values = [Decimal(text) for text in texts]
    whole = len(values) > 1 and all(value == int(value) for value in values)
    if whole and (unit == "s" or max(b - a for a, b in pairwise(values)) < LEAST_STEP_NS):
        return None
    stamps = [round(value * (NS_PER_S if unit == "s" else 1)) for value in values]
    if max(stamps) > LATEST_NS:
        raise RecordingError("stamp is too late", where=path, found=str(max(values)))
    return NameStamps(unit, tuple(stamps))
