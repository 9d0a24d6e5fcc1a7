"""camera.toml of several cameras: a table ``[cameras.NAME]`` for each, by hand or from a calibration."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError, RecordingError, nearest_name
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.extrinsics import inverse, placed, relative_to, rotation_from_rows
from posetrack_cli.recording.camera_file import (
    CAMERA_FILE_NAME,
    Finite,
    Intrinsics,
    NotCalibratedError,
    checked_settings,
    read_toml,
)
from posetrack_cli.recording.depth import Window
from posetrack_cli.recording.guess import Guess
from posetrack_cli.text import one_line, printable_json

TABLE = "cameras"
NEAREST_MM = 1.0
"""Cameras that are closer see no depth: their place was not measured."""
NO_PLACE = "rotation = [9 numbers, row after row] and translation_mm = [3 numbers]: camera from reference"

Length = Annotated[float, Field(ge=-limits.LENGTH_MM, le=limits.LENGTH_MM)]


class RigCamera(Intrinsics):
    """One camera among several.

    Attributes:
        rotation, translation_mm: camera_T_reference, R row after row and t: p_camera = R p_reference + t.
            Only one camera may go without, which is then the one that they are relative to.
        bits: significant bits of stored grey values above 8; None finds out from the first image.
    """

    rotation: Annotated[tuple[Finite, ...], Field(min_length=9, max_length=9)] | None = None
    translation_mm: Annotated[tuple[Length, ...], Field(min_length=3, max_length=3)] | None = None
    bits: Annotated[int, Field(ge=8, le=16)] | None = None


class LoneCamera(Intrinsics):
    """The one camera of a camera.toml without ``[cameras.NAME]``, of grey images.

    Attributes:
        mirror: flip the images left to right.
        bits: as of ``RigCamera``.
    """

    mirror: bool = False
    bits: Annotated[int, Field(ge=8, le=16)] | None = None


@dataclass(frozen=True)
class Rig:
    """What a camera file says of all cameras, or what is guessed of one.

    Attributes:
        path: the file; the recording where there is none.
        cameras: settings by name, the reference first; the name is empty where the file gives none.
        mirror: flip all images left to right.
    """

    path: Path
    cameras: Mapping[str, RigCamera | LoneCamera | Guess]
    mirror: bool = False

    @property
    def is_guessed(self) -> bool:
        """Whether there is no camera file."""
        return any(isinstance(camera, Guess) for camera in self.cameras.values())

    def chosen(self, names: Sequence[str]) -> Rig:
        """Return the rig of some of its cameras, in its own order.

        Raises:
            RecordingError: if it has no camera of such a name.
        """
        for name in names:
            if name not in self.cameras:
                lone = "it is of one camera, which has no name: leave --cameras out"
                hint = lone if "" in self.cameras else nearest_name(name, self.cameras)
                raise RecordingError(f"no camera '{name}'", where=self.path, hint=hint)
        return Rig(self.path, {k: v for k, v in self.cameras.items() if k in names}, self.mirror)

    def window(self, name: str, mirror: bool) -> Window:
        """Return the part of a camera's images that is used."""
        return Window(self.cameras[name].crop, mirror)

    def stored_cameras(self, sizes: Mapping[str, tuple[int, int]]) -> tuple[Camera, ...]:
        """Return the cameras of stored images of given widths and heights, relative to the first.

        Raises:
            RecordingError: if the file gives other sizes, or no or an impossible place of a camera.
        """
        placeless = [name for name, camera in self.cameras.items() if _is_placeless(camera)]
        if len(placeless) > 1:
            raise RecordingError(
                f"places of cameras {', '.join(placeless)} are missing",
                where=self.path,
                hint=f"posetrack calibrate stereo measures them; or write {NO_PLACE}",
            )
        cameras = [self._stored_camera(name, sizes[name]) for name in self.cameras]
        rebased = relative_to(cameras[0], cameras)
        check_apart(rebased, self.path)
        return rebased

    def _stored_camera(self, name: str, size: tuple[int, int]) -> Camera:
        settings = self.cameras[name]
        try:
            camera = settings.stored_camera(*size, name or "camera")
        except RecordingError as error:
            where = f"{self.path}, camera '{name}'" if name else str(self.path)
            raise RecordingError(str(error).removeprefix(f"{CAMERA_FILE_NAME}: "), where=where) from error
        if not isinstance(settings, RigCamera) or _is_placeless(settings):
            return camera
        where = f"{self.path}, rotation of camera '{name}'"
        if settings.rotation is None or settings.translation_mm is None:
            raise RecordingError(
                f"place of camera '{name}' is half there", where=self.path, expected=NO_PLACE
            )
        try:
            rotation = rotation_from_rows(settings.rotation, where)
        except PosetrackError as error:
            raise RecordingError(str(error)) from error
        return placed(camera, np.column_stack([rotation, settings.translation_mm]))


def load_rig(path: Path) -> Rig:
    """Read a camera file of one or several cameras of grey images.

    Raises:
        RecordingError: if it is missing, not TOML, or a key is unknown, missing or of the wrong kind.
    """
    values = read_toml(path)
    if TABLE not in values:
        lone = checked_settings(LoneCamera, values, path)
        return Rig(path, {"": lone}, lone.mirror)
    for key in values.keys() - {TABLE, "reference", "mirror"}:
        raise RecordingError(
            f"unknown key '{key}'", where=path, hint=nearest_name(key, [TABLE, "reference", "mirror"])
        )
    tables = values[TABLE]
    if not isinstance(tables, dict) or not tables or not all(isinstance(t, dict) for t in tables.values()):
        raise RecordingError(f"'{TABLE}' cannot be used", where=path, expected="tables [cameras.NAME]")
    if len(tables) > limits.CAMERAS:
        raise RecordingError("too many cameras", where=path, found=len(tables), expected=limits.CAMERAS)
    cameras = {
        name: checked_settings(RigCamera, table, f"{path}, [cameras.{name}]")
        for name, table in tables.items()
    }
    return Rig(path, _reference_first(cameras, values, path), _mirror(values, path))


def found_rig(path: Path, file: Path | None, names: Iterable[str], guess: Guess | None) -> Rig:
    """Return what a recording's camera file says, or what is guessed where it has none.

    Args:
        path: the recording.
        file: None for none.
        names: of its cameras.
        guess: of one camera; None if cameras must be calibrated.

    Raises:
        NotCalibratedError: there is neither file nor guess.
        RecordingError: the file cannot be used.
    """
    if file is not None:
        return load_rig(file)
    if guess is None:
        raise not_calibrated(path)
    return Rig(path, dict.fromkeys(names, guess))


def not_calibrated(where: object) -> NotCalibratedError:
    """Return the error for images without any camera file, with what to do."""
    return NotCalibratedError(
        "cameras are not calibrated",
        where=where,
        expected=f"a {CAMERA_FILE_NAME} beside the images, or --camera",
        hint="posetrack calibrate stereo measures cameras and writes it; for one fx, fy, cx, cy will do",
    )


def camera_file_text(cameras: Iterable[Camera], comments: Sequence[str] = ()) -> str:
    """Return a camera file of several cameras, the first of them the reference.

    Args:
        cameras: with distinct names.
        comments: lines to begin with, written after "# ".
    """
    parts = ["".join(f"# {one_line(line)}".rstrip() + "\n" for line in comments)] if comments else []
    cameras = list(cameras)
    parts.append(f"reference = {_quoted(cameras[0].name)}\n")
    return "\n".join([*parts, *(_table(camera) for camera in cameras)])


def check_apart(cameras: Sequence[Camera], where: object) -> None:
    """Raise RecordingError if two cameras are in one place, so that they see no depth."""
    centres = [inverse(np.array(camera.camera_T_reference))[:, 3] for camera in cameras]
    for i, j in combinations(range(len(cameras)), 2):
        distance = float(np.linalg.norm(centres[i] - centres[j]))
        if distance < NEAREST_MM:
            raise RecordingError(
                f"cameras '{cameras[i].name}' and '{cameras[j].name}' are in one place",
                where=where,
                found=f"{distance:.3g} mm apart",
                hint="translations are in mm; posetrack calibrate stereo measures them",
            )


def _table(camera: Camera) -> str:
    transform = np.array(camera.camera_T_reference)
    values: dict[str, Any] = {"width": camera.width, "height": camera.height}
    values |= {key: float(getattr(camera, key)) for key in ("fx", "fy", "cx", "cy")}
    lines = [f"[{TABLE}.{_key(camera.name)}]", *(f"{key} = {value!r}" for key, value in values.items())]
    if camera.distortion:
        lines += [f'distortion_model = "{camera.distortion_model}"']
        lines += [f"distortion = {_numbers(camera.distortion)}"]
    lines += [f"rotation = {_numbers(transform[:, :3].ravel())}"]
    lines += [f"translation_mm = {_numbers(transform[:, 3])}"]
    return "\n".join(lines) + "\n"


def _numbers(values: Iterable[float]) -> str:
    return f"[{', '.join(repr(float(value)) for value in values)}]"


def _key(name: str) -> str:
    """A TOML key: bare where it can be."""
    bare = name.replace("_", "").replace("-", "")
    if bare.isascii() and bare.isalnum():
        return name
    return _quoted(name)


def _quoted(text: str) -> str:
    """A TOML string, which JSON's escapes suit."""
    return printable_json(json.dumps(text, ensure_ascii=False))


def _is_placeless(camera: RigCamera | LoneCamera | Guess) -> bool:
    return not isinstance(camera, RigCamera) or (camera.rotation is None and camera.translation_mm is None)


def _reference_first(
    cameras: dict[str, RigCamera], values: Mapping[str, Any], path: Path
) -> dict[str, RigCamera]:
    reference = values.get("reference", next(iter(cameras)))
    if not isinstance(reference, str) or reference not in cameras:
        raise RecordingError(
            f"reference '{reference}' is no camera", where=path, hint=nearest_name(str(reference), cameras)
        )
    return {reference: cameras[reference]} | cameras


def _mirror(values: Mapping[str, Any], path: Path) -> bool:
    mirror = values.get("mirror", False)
    if not isinstance(mirror, bool):
        raise RecordingError(
            "key 'mirror' cannot be used", where=path, found=mirror, expected="true or false"
        )
    return mirror
