"""Annotated joints of public hand datasets as ground truth: joint order, unit, axes, file layout.

NYU and ICVL annotate other points: of NYU's 36, ``_A`` is the far end and ``_B`` the near end of a bone;
ICVL's ``root`` lies at the PIP joint (root to tip of an index finger is 49 mm).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import PosetrackError, TruthError
from posetrack_cli.evaluation.reading.image_points import stamps_of_frames
from posetrack_cli.evaluation.reading.pickled import array_of, read_pickled
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.files import open_input, read_input, read_text
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import FINGERS, JOINT_NAMES
from posetrack_cli.npz import read_npz
from posetrack_cli.recording.datasets.layout import numbered
from posetrack_cli.recording.stamps import DIGITS
from posetrack_cli.results.reader import Result
from posetrack_cli.tables import TextFile

Value = TypeVar("Value")
Points = dict[int, FloatArray]
"""Annotated points (C, 3) by frame number."""
Order = Mapping[str, tuple[int, ...]]
"""Numbers of the points whose mean is a joint, by name; joints without points are omitted."""


def _order(wrist: tuple[int, ...], fingers: tuple[tuple[int, ...], ...]) -> Order:
    """Return an order from the numbers of each finger's last joints, the tip last."""
    order = {JOINT_NAMES[0]: wrist} if wrist else {}
    for finger, numbers in zip(FINGERS, fingers, strict=True):
        names = [name for name in JOINT_NAMES if name.startswith(f"{finger}_")][-len(numbers) :]
        order |= {name: (number,) for name, number in zip(names, numbers, strict=True)}
    return order


_OURS = _order((0,), tuple(tuple(range(first, first + 4)) for first in (1, 5, 9, 13, 17)))
_KNUCKLES_FIRST = _order((0,), ((1, 6, 7, 8), *((2 + k, *range(9 + 3 * k, 12 + 3 * k)) for k in range(4))))
_THUMB_LAST = _order((0,), tuple(tuple(range(first, first + 4)) for first in (17, 1, 5, 9, 13)))
_TIPS_LAST = _order((0,), ((13, 14, 15, 16), (1, 2, 3, 17), (4, 5, 6, 18), (10, 11, 12, 19), (7, 8, 9, 20)))
_NYU = _order((30, 31), ((29, 27, 25, 24), *((k + 5, k + 3, k + 1, k) for k in (18, 12, 6, 0))))
_ICVL = _order((), tuple(tuple(range(first, first + 3)) for first in (1, 4, 7, 10, 13)))


@dataclass(frozen=True)
class Labels:
    """The annotations of a recording.

    Attributes:
        name: dataset, and the side of the hand if stated.
        points: (C, 3) by frame number of the recording, mm, camera axes.
        order: joints among the points.
    """

    name: str
    points: Points
    order: Order

    @property
    def frames(self) -> IntArray:
        """(N,) numbers of the annotated frames, increasing."""
        return np.array(sorted(self.points), dtype=np.int64)

    def track(self, path: Path, stamp_ns: IntArray, frames: IntArray, *, mirrored: bool = False) -> Track:
        """Return the joints of some frames with their stamps, (N,) both."""
        of = [list(numbers) for numbers in self.order.values()]
        rows = [[self.points[frame][numbers].mean(axis=0) for numbers in of] for frame in frames.tolist()]
        points = np.array(rows).reshape(len(frames), len(of), 3)
        points[..., 0] *= -1.0 if mirrored else 1.0
        if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > limits.LENGTH_MM:
            raise TruthError("joint out of range", where=path, expected="finite coordinates")
        return Track(
            f"{path.name} ({self.name})",
            "hand",
            shape_names=(),
            point_names=tuple(self.order),
            point_parents=(),
            stamp_ns=stamp_ns,
            points=points,
            frame_index=frames,
        )


@dataclass(frozen=True)
class _Dataset:
    """Layout of a dataset.

    Attributes:
        name: its name.
        count: points per frame.
        order: joints among them.
        scale: factors to mm in camera axes.
        first: number of the first frame.
        camera: for x and y in pixels, the published intrinsics.
    """

    name: str
    count: int
    order: Order
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    first: int = 0
    camera: Camera | None = None

    def labels(self, points: Points, side: str = "") -> Labels:
        """Return points of the files as labels in mm and camera axes."""
        placed = {k - self.first: self._placed(values) * self.scale for k, values in points.items()}
        return Labels(f"{self.name}, {side} hand" if side else self.name, placed, self.order)

    def _placed(self, values: FloatArray) -> FloatArray:
        if self.camera is None:
            return values
        u, v, depth = values.T
        camera = self.camera
        across, down = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
        return np.stack([across * depth, down * depth, depth], axis=1)


NYU = _Dataset("NYU", 36, _NYU, (1.0, -1.0, 1.0), first=1)
MSRA = _Dataset("MSRA", 21, _THUMB_LAST, (1.0, -1.0, -1.0))
ICVL = _Dataset("ICVL", 16, _ICVL, camera=Camera(320, 240, 241.42, 241.42, 160.0, 120.0))
HANDS_2017 = _Dataset("HANDS 2017", 21, _KNUCKLES_FIRST, first=1)
FHAD = _Dataset("FHAD", 21, _KNUCKLES_FIRST)
DEXYCB = _Dataset("DexYCB", 21, _OURS, (1e3, 1e3, 1e3))
HO3D = _Dataset("HO-3D", 21, _TIPS_LAST, (1e3, -1e3, -1e3))

_IMAGE = ".png"
# Text files by whether a row begins with the name of an image, and by its numbers: FHAD's first is the frame.
_ROWS = {(True, 63): HANDS_2017, (True, 48): ICVL, (False, 64): FHAD, (False, 63): MSRA}
_TEXT_NAMES = ("joint.txt", "skeleton.txt", "Training_Annotation.txt")
_EXPECTED = "rows of joints as in MSRA, FHAD, HANDS 2017 or ICVL"
_MATRIX = "joint_data.mat"
_DEXYCB_FILE, _HO3D_FILE = re.compile(r"labels_([0-9]{6})\.npz"), re.compile(r"([0-9]{4,6})\.pkl")
_SIDE = re.compile(r"^mano_sides:\s*(?:\[|-)?\s*['\"]?(right|left)\b", re.MULTILINE)
_PICKLE_BYTES = limits.MIB
"""A pickle of HO-3D has some 10 kB."""
_LOOKED_AT = 3


def is_labels(path: Path) -> bool:
    """Whether a path has annotations in one of the layouts; unreadable paths have not."""
    try:
        return _reader_of(path) is not None
    except (OSError, PosetrackError):
        return False


def load_labels(path: Path, result: Result) -> Track:
    """Read the annotations of a result's recording.

    Args:
        path: file or folder.
        result: result of a hand; the frames of its recording have the numbers of the annotations.

    Raises:
        TruthError: a file is invalid, or has labels of several recordings.
    """
    labels = read_labels(path, result.run.get("input.name", ""))
    frames = labels.frames
    stamps = stamps_of_frames(path, frames, result)
    return labels.track(path, stamps, frames, mirrored=result.run.get("input.mirror") == "true")


def read_labels(path: Path, recording: str) -> Labels:
    """Read annotations.

    Args:
        path: a path for which ``is_labels`` holds.
        recording: name of the recording, which selects rows of a list of several.

    Raises:
        TruthError: a file is invalid, or has no labels of the recording.
    """
    reader = _reader_of(path)
    if reader is None:
        raise TruthError("no annotated joints", where=path, expected=_EXPECTED)
    labels = reader(recording)
    if not labels.points:
        raise TruthError("no annotated frames", where=path)
    return labels


def _reader_of(path: Path) -> Callable[[str], Labels] | None:
    """Return the reader of a file or folder, which takes the name of the recording."""
    if path.is_dir():
        for name in (_MATRIX, *_TEXT_NAMES):
            if (path / name).is_file():
                return _reader_of(path / name)
        folder = path / "meta" if (path / "meta").is_dir() else path
        for pattern, read in ((_DEXYCB_FILE, _dexycb), (_HO3D_FILE, _ho3d)):
            if any(pattern.fullmatch(file.name) for file in folder.iterdir()):
                return lambda _: read(folder)
        return None
    if path.name == _MATRIX:
        return lambda _: _nyu(path)
    if path.suffix == ".txt" and path.is_file():
        kinds = (_kind(line) for _, line in islice(TextFile(path, TruthError, _EXPECTED).lines(), _LOOKED_AT))
        dataset = next((kind for kind in kinds if kind is not None), None)
        return None if dataset is None else lambda recording: _rows(path, dataset, recording)
    return None


def _kind(line: str) -> _Dataset | None:
    cells = line.split()
    named = bool(cells) and cells[0].endswith(_IMAGE)
    return _ROWS.get((named, len(cells) - named))


def _rows(path: Path, dataset: _Dataset, recording: str) -> Labels:
    """Read a text file with a row per frame."""
    points: dict[str, Points] = {}
    for number, line in TextFile(path, TruthError, _EXPECTED, most=None).lines():
        cells = line.split()
        if not cells or (dataset is MSRA and number == 1):  # which is the number of rows
            continue
        where = f"{path} line {number}"
        if _kind(line) is not dataset:
            expected = f"a row of {dataset.name}"
            raise TruthError(
                "not annotated joints", where=where, found=f"{len(cells)} cells", expected=expected
            )
        try:
            values = np.array(cells[-3 * dataset.count :], dtype=np.float64).reshape(-1, 3)
            frame = _frame(dataset, cells[0], number)
        except (ValueError, IndexError, OverflowError) as error:
            raise TruthError("not annotated joints", where=where, expected="numbers") from error
        of = points.setdefault(cells[0].rpartition("/")[0] if dataset is ICVL else "", {})
        if frame in of or len(of) >= limits.SEARCH_ENTRIES:
            raise TruthError("two rows of one frame, or too many", where=where)
        of[frame] = values
    return dataset.labels(_of_recording(path, points, recording))


def _frame(dataset: _Dataset, first: str, line: int) -> int:
    """Return the frame number of a row: MSRA's first row follows the number of rows."""
    if dataset is MSRA:
        return line - 2
    return int(float(first)) if dataset is FHAD else int(DIGITS.findall(first)[-1])


def _of_recording(path: Path, points: Mapping[str, Points], recording: str) -> Points:
    """Return the labels of the recording's folder, the only one or that of its name."""
    chosen = [own for folder, own in points.items() if len(points) == 1 or folder.split("/")[-1] == recording]
    if len(chosen) != 1 and points:
        found = ", ".join(islice(points, 5))
        raise TruthError("labels of several folders", where=path, found=found, expected=f"one {recording}")
    return chosen[0] if chosen else {}


def _nyu(path: Path) -> Labels:
    """Read the first camera's points of NYU's MATLAB file."""
    from scipy.io import loadmat, whosmat  # slow to import

    name = "joint_xyz"
    try:
        with open_input(path) as stream:
            shapes = {entry: (shape, kind) for entry, shape, kind in whosmat(stream)}
            shape, kind = shapes.get(name, ((), ""))
            if kind != "double" or len(shape) != 4 or shape[2:] != (NYU.count, 3) or not shape[0]:
                found, expected = f"{kind} {shape}", f"{name}: cameras x frames x {NYU.count} x 3"
                raise TruthError("no joints of NYU", where=path, found=found, expected=expected)
            if shape[1] > limits.KEYPOINT_SETS or shape[0] > limits.CAMERAS:
                raise TruthError("too many frames", where=path, found=shape[1], expected=limits.KEYPOINT_SETS)
            stream.seek(0)
            values = loadmat(stream, variable_names=[name])[name][0]
    except TruthError:
        raise
    except Exception as error:  # scipy raises many kinds on damaged files
        raise TruthError("damaged MATLAB file", where=path, found=str(error)[:200]) from error
    return NYU.labels(dict(enumerate(np.asarray(values, dtype=np.float64), NYU.first)))


def _dexycb(folder: Path) -> Labels:
    """Read the label files of one camera; frames without a hand have -1 in all coordinates."""

    def joints_of(file: Path) -> FloatArray | None:
        joints = read_npz(read_input(file, limits.IMAGE_BYTES)).get("joint_3d")
        return None if joints is not None and (joints == -1.0).all() else _checked(joints, DEXYCB)

    meta = folder.parent / "meta.yml"
    found = _each(meta.parent, {0: meta}, _side_of).get(0, "") if meta.is_file() else ""
    return DEXYCB.labels(_each(folder, numbered(folder, _DEXYCB_FILE), joints_of), found)


def _side_of(meta: Path) -> str | None:
    found = _SIDE.search(read_text(meta, limits.TEXT_BYTES))
    return None if found is None else found[1]


def _ho3d(folder: Path) -> Labels:
    """Read the pickled annotations of a sequence; unannotated frames have None."""

    def joints_of(file: Path) -> FloatArray | None:
        value = read_pickled(read_input(file, _PICKLE_BYTES))
        stored = value.get("handJoints3D", value) if isinstance(value, dict) else value
        return None if stored is None else _checked(array_of(stored), HO3D)

    return HO3D.labels(_each(folder, numbered(folder, _HO3D_FILE), joints_of), "right")


def _each(folder: Path, files: Mapping[int, Path], read: Callable[[Path], Value | None]) -> dict[int, Value]:
    """Read numbered files; those without annotations are omitted."""
    if len(files) > limits.KEYPOINT_SETS:
        raise TruthError("too many files", where=folder, found=len(files), expected=limits.KEYPOINT_SETS)
    values = {}
    for number, file in files.items():
        try:
            value = read(file)
        except (OSError, ValueError, TypeError, IndexError, OverflowError) as error:
            raise TruthError("no annotated joints", where=file, found=str(error)[:200]) from error
        if value is not None:
            values[number] = value
    return values


def _checked(joints: FloatArray | None, dataset: _Dataset) -> FloatArray:
    """Return the joints (C, 3) of a file; raise ValueError for another array."""
    if joints is None or joints.dtype.kind != "f" or joints.size != 3 * dataset.count:
        found = "no array" if joints is None else f"{joints.dtype} {joints.shape}"
        raise ValueError(f"{found} in place of {dataset.count} joints of {dataset.name}")
    return joints.reshape(dataset.count, 3).astype(np.float64)
