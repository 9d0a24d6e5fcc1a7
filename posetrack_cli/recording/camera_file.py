"""Camera files (camera.toml): one camera, or a table ``[cameras.NAME]`` for each of several."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Field, ValidationError

from posetrack_cli import limits
from posetrack_cli.configuration import Settings, expected_words, shipped_files
from posetrack_cli.errors import PosetrackError, RecordingError, UsageError, nearest_name
from posetrack_cli.files import read_text
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import inverse, placed, relative_to, rotation_from_rows
from posetrack_cli.recording.base import (
    CAMERA_EXAMPLE,
    CAMERA_FILE_KEY,
    CAMERA_FILE_NAME,
    not_calibrated,
)
from posetrack_cli.recording.camera_of import (
    OUTSIDE,
    Guess,
    ImageCamera,
    at_size,
    is_off_centre,
    is_same,
    likely_size,
    off_centre,
    off_centre_remark,
    principal_point_fault,
)
from posetrack_cli.recording.orientation import UPRIGHT, Orientation, Picture
from posetrack_cli.recording.pixels import Window
from posetrack_cli.text import one_line, parse_toml, printable_json

# Values of a nominal camera in its remark.
NOMINAL_SHOWN = ("fx", "fy", "cx", "cy", "depth_unit_mm", "fps")
# Name of an unnamed single camera in frames and run records.
DEFAULT_CAMERA_NAME = "camera"
TABLE = "cameras"
RIG_KEYS = (TABLE, "reference", "mirror")
# For rotated pictures: a principal point offset up to this, over half the image size, fits the picture; an
# alternative must be worse by at least this.
CENTRAL = 0.1
# Shorter baselines mean that the extrinsics were not measured.
NEAREST_MM = 1.0
EXPECTED_EXTRINSICS = (
    "rotation = [9 numbers, row by row] and translation_mm = [3 numbers]: camera from reference"
)

Finite = Annotated[float, Field(allow_inf_nan=False)]
Unit = Annotated[float, Field(ge=1e-6, le=1e6)]  # depth of 16-bit codes stays within float32
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=-limits.LENGTH_MM, le=limits.LENGTH_MM)]
Rate = Annotated[float, Field(ge=1e-6, le=1e6)]
Bits = Annotated[int, Field(ge=8, le=16)]

AnyIntrinsics = TypeVar("AnyIntrinsics", bound="Intrinsics")


class Intrinsics(Settings):
    """Camera file settings of one camera's stored images, for any kind of pixels.

    Attributes:
        width, height: image size of the intrinsics, pixels; they are scaled to stored images of another
            resolution with the same aspect ratio. None for the size of the stored images.
        fx, fy, cx, cy: intrinsics, pixels.
        distortion, distortion_model: see ``Camera``.
        picture: picture that the intrinsics describe if EXIF or a video container rotates it; None decides
            by sizes and principal point.
        fps: frame rate, Hz, for images without stamps.
        crop: x, y, width, height of the used part of the shown picture; applied before mirroring.
    """

    width: Annotated[int, Field(gt=0)] | None = None
    height: Annotated[int, Field(gt=0)] | None = None
    fx: Positive
    fy: Positive
    cx: Finite
    cy: Finite
    distortion: tuple[Finite, ...] = ()
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant", "inverse_brown_conrady"] = (
        "plumb_bob"
    )
    picture: Literal["stored", "shown"] | None = None
    fps: Rate | None = None
    crop: tuple[int, int, int, int] | None = None

    def stored_camera(
        self, width: int, height: int, name: str = "camera", *, picture: Picture | None = None
    ) -> Camera:
        """Return the camera of images of this size.

        Args:
            width, height: size of the images.
            name: name of the camera.
            picture: how the images are shown if not as stored; of the same size.

        Raises:
            RecordingError: the intrinsics do not fit such images, or it is unclear whether they describe
                the stored or the shown picture.
        """
        orientation = UPRIGHT if picture is None else picture.orientation
        if orientation == UPRIGHT:
            return self._of_size(width, height, name)
        return self._described(width, height, name, orientation)[1]

    def _described(self, width: int, height: int, name: str, orientation: Orientation) -> tuple[str, Camera]:
        """Return which picture the intrinsics describe, and the camera of the shown one."""
        found: dict[str, Camera] = {}
        problem: PosetrackError | None = None
        for kind in ("shown", "stored") if self.picture is None else (self.picture,):
            try:
                if kind == "shown":
                    found[kind] = self._of_size(width, height, name)
                else:
                    stored = self._of_size(*orientation.stored_size(width, height), name)
                    found[kind] = orientation.camera(stored)
            except PosetrackError as error:
                problem = problem or error
        if not found:
            raise problem or RecordingError("intrinsics do not fit the images", where=CAMERA_FILE_NAME)
        if len(found) == 1 or not orientation.transposed or is_same(found["shown"], found["stored"]):
            return next(iter(found.items()))
        kinds = sorted(found, key=lambda kind: off_centre(found[kind]))
        near, far = (off_centre(found[kind]) for kind in kinds)
        if near <= CENTRAL and far - near >= CENTRAL:
            return kinds[0], found[kinds[0]]
        raise RecordingError(
            "intrinsics may describe the stored or the shown picture",
            where=CAMERA_FILE_NAME,
            found=f"pictures {orientation.words}",
            hint='add picture = "stored" or picture = "shown" next to the intrinsics',
        )

    def _of_size(self, width: int, height: int, name: str) -> Camera:
        stated = self._camera(self.width or width, self.height or height, name)
        camera = at_size(stated, width, height)
        if camera is None:
            raise RecordingError(
                "camera file and images differ in size",
                where=CAMERA_FILE_NAME,
                found=f"images of {width}x{height}",
                expected=f"{stated.width}x{stated.height}",
                hint="correct width and height, or use a part of the images: crop = [x, y, width, height]",
            )
        fault = principal_point_fault(camera)
        is_doubtful = fault is not None or is_off_centre(camera)
        if fault == OUTSIDE or (is_doubtful and self.width is None):
            raise self._of_other_images(camera, fault or "far from the image centre")
        return camera

    def remarks(self, width: int, height: int, *, picture: Picture | None = None) -> tuple[str, ...]:
        """Return conversions for images of this size and unusual values, one line each."""
        orientation = UPRIGHT if picture is None else picture.orientation
        of, said = "shown", []
        if orientation != UPRIGHT:
            of, _ = self._described(width, height, DEFAULT_CAMERA_NAME, orientation)
            said.append(f"pictures are {orientation.words}; camera file describes the {of} picture")
        size = orientation.stored_size(width, height) if of == "stored" else (width, height)
        stated = (self.width or size[0], self.height or size[1])
        if stated != size:
            stored = f"{size[0]}x{size[1]}"
            said.append(f"camera file is for {stated[0]}x{stated[1]}: intrinsics are scaled to {stored}")
        return (*said, *off_centre_remark(self.stored_camera(width, height, picture=picture)))

    def _of_other_images(self, camera: Camera, fault: str) -> RecordingError:
        """Return the error for intrinsics of another image size, with values that would fit."""
        width, height = likely_size(camera)
        size = f"{camera.width}x{camera.height}"
        hint = f"if they are right, add width = {camera.width} and height = {camera.height}"
        like = at_size(
            replace(camera, width=max(width, 1), height=max(height, 1)), camera.width, camera.height
        )
        if like is not None and (width, height) != (camera.width, camera.height):
            values = ", ".join(f"{key} = {getattr(like, key):.6g}" for key in ("fx", "fy", "cx", "cy"))
            hint = f"if so, add width = {width} and height = {height}, or use the scaled values {values}"
        return RecordingError(
            f"principal point is {fault}",
            where=CAMERA_FILE_NAME,
            found=f"cx {camera.cx:g} cy {camera.cy:g} for {size} images",
            expected=f"intrinsics of these images; do these belong to {width}x{height} images?",
            hint=hint,
        )

    def _camera(self, width: int, height: int, name: str = "camera") -> Camera:
        return Camera(
            width=width,
            height=height,
            fx=self.fx,
            fy=self.fy,
            cx=self.cx,
            cy=self.cy,
            distortion=self.distortion,
            distortion_model=self.distortion_model,
            name=name,
        )


class DepthStorage(Settings):
    """Storage of depth.

    Attributes:
        depth_unit_mm: millimetres per stored unit; None decides by the images.
        missing: stored code for no reading, in addition to 0.
    """

    depth_unit_mm: Unit | None = None
    missing: Annotated[int, Field(ge=0, le=65535)] = 0


class DepthCamera(Intrinsics, DepthStorage):
    """The camera of a depth recording's camera.toml; all values are before crop and mirror.

    Attributes:
        mirror: flip the images left to right.
    """

    mirror: bool = False

    @property
    def window(self) -> Window:
        """The used part of the images."""
        return Window(self.crop, self.mirror)


class SingleCamera(Intrinsics, DepthStorage):
    """The camera of a camera.toml without ``[cameras.NAME]``, for grey images; depth keys allowed.

    Attributes:
        mirror: flip the images left to right.
        bits: significant bits of stored grey values above 8; None decides by several images.
    """

    mirror: bool = False
    bits: Bits | None = None


class RigCamera(Intrinsics):
    """One of several cameras.

    Attributes:
        rotation, translation_mm: camera_T_reference, R row by row and t: p_camera = R p_reference + t. One
            camera, the reference, may omit them.
        bits: see ``SingleCamera``.
    """

    rotation: Annotated[tuple[Finite, ...], Field(min_length=9, max_length=9)] | None = None
    translation_mm: Annotated[tuple[Length, ...], Field(min_length=3, max_length=3)] | None = None
    bits: Bits | None = None


@dataclass(frozen=True)
class Rig:
    """All cameras of a camera file, or one guessed camera.

    Attributes:
        path: the file, or the recording if there is none.
        cameras: settings by name, reference first; the name is empty if the file gives none.
        mirror: flip all images left to right.
    """

    path: Path
    cameras: Mapping[str, RigCamera | SingleCamera | Guess]
    mirror: bool = False

    @property
    def is_guessed(self) -> bool:
        """True if there is no camera file."""
        return any(isinstance(camera, Guess) for camera in self.cameras.values())

    def subset(self, names: Sequence[str]) -> Rig:
        """Return the rig with only the named cameras; an unnamed one is ``DEFAULT_CAMERA_NAME``.

        Raises:
            RecordingError: it has no camera of a name.
        """
        if "" in self.cameras and list(names) == [DEFAULT_CAMERA_NAME]:
            return self
        for name in names:
            if name not in self.cameras:
                lone = "it has one unnamed camera: omit --cameras"
                hint = lone if "" in self.cameras else nearest_name(name, self.cameras)
                raise RecordingError(f"no camera '{name}'", where=self.path, hint=hint)
        return Rig(self.path, {k: v for k, v in self.cameras.items() if k in names}, self.mirror)

    def window(self, name: str, mirror: bool | None = None) -> Window:
        """Return the used part of a camera's images; ``mirror`` overrides the file's value."""
        return Window(self.cameras[name].crop, self.mirror if mirror is None else mirror)

    def stored_cameras(self, sizes: Mapping[str, Picture | tuple[int, int]]) -> tuple[Camera, ...]:
        """Return the cameras of the given pictures, relative to the first.

        Raises:
            RecordingError: sizes do not match, or extrinsics are missing or invalid.
        """
        missing = [name for name, camera in self.cameras.items() if _has_no_extrinsics(camera)]
        if len(missing) > 1:
            raise RecordingError(
                f"extrinsics of cameras {', '.join(missing)} are missing",
                where=self.path,
                hint=f"run posetrack calibrate stereo, or add {EXPECTED_EXTRINSICS}",
            )
        cameras = [self._stored_camera(name, Picture(*sizes[name])) for name in self.cameras]
        rebased = relative_to(cameras[0], cameras)
        check_baselines(rebased, self.path)
        return rebased

    def remarks(self, sizes: Mapping[str, Picture | tuple[int, int]]) -> tuple[str, ...]:
        """Return conversions for these pictures and unusual values, one line each."""
        said = []
        for name, camera in self.cameras.items():
            if not isinstance(camera, Guess):
                prefix = f"camera '{name}': " if name else ""
                picture = Picture(*sizes[name])
                said += [f"{prefix}{remark}" for remark in camera.remarks(*picture[:2], picture=picture)]
        return (*nominal_remark(self.path), *said)

    def _stored_camera(self, name: str, picture: Picture) -> Camera:
        settings = self.cameras[name]
        try:
            camera = settings.stored_camera(*picture[:2], name or DEFAULT_CAMERA_NAME, picture=picture)
        except RecordingError as error:
            raise _with_path(error, f"{self.path}, camera '{name}'" if name else self.path) from error
        if not isinstance(settings, RigCamera) or _has_no_extrinsics(settings):
            return camera
        where = f"{self.path}, rotation of camera '{name}'"
        if settings.rotation is None or settings.translation_mm is None:
            raise RecordingError(
                f"extrinsics of camera '{name}' are incomplete",
                where=self.path,
                expected=EXPECTED_EXTRINSICS,
            )
        try:
            rotation = rotation_from_rows(settings.rotation, where)
        except PosetrackError as error:
            raise RecordingError(str(error)) from error
        return placed(camera, np.column_stack([rotation, settings.translation_mm]))


def camera_path(given: Path) -> Path:
    """Return the camera file given by --camera: a file, or the name of a nominal camera.

    Raises:
        UsageError: it is neither.
    """
    if given.exists() or given.suffix or len(given.parts) != 1:
        return given
    known = shipped_files("cameras")
    if str(given) not in known:
        raise UsageError(
            "unknown camera",
            where="--camera",
            found=str(given),
            expected=f"a camera file or one of {', '.join(known)}",
            hint=nearest_name(str(given), known),
        )
    return known[str(given)]


def nominal_remark(path: Path) -> tuple[str, ...]:
    """Return a remark if a camera file is one of the nominal cameras."""
    if path not in shipped_files("cameras").values():
        return ()
    values = parse_toml(read_text(path, limits.TEXT_BYTES))
    shown = ", ".join(f"{key} {values[key]:g}" for key in NOMINAL_SHOWN if key in values)
    return (f"camera {path.stem} is nominal, not calibrated: {values['width']}x{values['height']}, {shown}",)


def nominal_names(width: int, height: int) -> list[str]:
    """Return the names of nominal cameras with this image size, or twice it (2x2 binning)."""
    every = {name: load_depth_camera(path) for name, path in shipped_files("cameras").items()}
    sizes = ((width, height), (2 * width, 2 * height))
    return [name for name, camera in every.items() if (camera.width, camera.height) in sizes]


def nominal_hint(width: int, height: int) -> str:
    """Return a hint listing the nominal cameras for this image size; empty if there are none."""
    names = nominal_names(width, height)
    return f"; or use a nominal camera for {width}x{height}: --camera {' | '.join(names)}" if names else ""


def image_camera(
    settings: DepthCamera,
    path: Path,
    size: tuple[int, int],
    name: str = DEFAULT_CAMERA_NAME,
    orientation: Orientation = UPRIGHT,
) -> ImageCamera:
    """Return the camera of images of a size from a camera file.

    Args:
        settings: content of the file.
        path: the file.
        size: width and height of the decoded images, pixels.
        name: name of the camera.
        orientation: orientation of the decoded images relative to the stored ones.

    Raises:
        RecordingError: the intrinsics do not fit such images.
    """
    try:
        picture = Picture(*size, orientation)
        camera = settings.stored_camera(*size, name, picture=picture)
    except RecordingError as error:
        raise _with_path(error, path) from error
    return ImageCamera(camera, path.name, nominal_remark(path) + settings.remarks(*size, picture=picture))


def load_depth_camera(path: Path) -> DepthCamera:
    """Read the camera file of one depth camera.

    Raises:
        RecordingError: the file is missing or not TOML, or a key is unknown, missing or invalid.
    """
    return _checked(DepthCamera, _read_toml(path), path)


def depth_storage(settings: DepthCamera | None, options: Mapping[str, Any]) -> tuple[float | None, int]:
    """Return the depth unit, mm, and the code for no reading from options or a camera file.

    Raises:
        UsageError: an option is invalid.
    """
    known = {} if settings is None else {"depth_unit_mm": settings.depth_unit_mm, "missing": settings.missing}
    given = {key: options[key] for key in DepthStorage.model_fields if options.get(key) is not None}
    try:
        stated = DepthStorage.model_validate(known | given)
    except ValueError as error:
        text = ", ".join(f"{key} {value}" for key, value in given.items())
        raise UsageError("invalid depth option", found=text) from error
    return stated.depth_unit_mm, stated.missing


def used_window(
    crop: tuple[int, int, int, int] | None, file: DepthCamera | Rig | None, options: Mapping[str, Any]
) -> Window:
    """Return the used part of a camera's images from options or a camera file."""
    mirror = options.get("mirror")
    return Window(crop, bool(file and file.mirror) if mirror is None else mirror)


def load_rig(path: Path) -> Rig:
    """Read the camera file of one or several grey cameras.

    Raises:
        RecordingError: the file is missing or not TOML, or a key is unknown, missing or invalid.
    """
    values = _read_toml(path)
    if TABLE not in values:
        lone = _checked(SingleCamera, values, path)
        return Rig(path, {"": lone}, lone.mirror)
    for key in values.keys() - set(RIG_KEYS):
        raise RecordingError(f"unknown key '{key}'", where=path, hint=nearest_name(key, RIG_KEYS))
    tables = values[TABLE]
    if not isinstance(tables, dict) or not tables or not all(isinstance(t, dict) for t in tables.values()):
        raise RecordingError(f"invalid '{TABLE}'", where=path, expected="tables [cameras.NAME]")
    if len(tables) > limits.CAMERAS:
        expected = f"at most {limits.CAMERAS}"
        raise RecordingError("too many cameras", where=path, found=len(tables), expected=expected)
    cameras = {
        name: _checked(RigCamera, table, f"{path}, [cameras.{name}]") for name, table in tables.items()
    }
    return Rig(path, _reference_first(cameras, values, path), _mirror(values, path))


def load_or_guess_rig(path: Path, file: Path | None, names: Iterable[str], guess: Guess | None) -> Rig:
    """Return the rig of a recording's camera file, or a guessed camera if there is none.

    Args:
        path: the recording.
        file: its camera file, None for none.
        names: names of its cameras.
        guess: intrinsics of one camera; None if cameras must be calibrated.

    Raises:
        NotCalibratedError: there is neither file nor guess.
        RecordingError: the file is invalid.
    """
    if file is not None:
        return load_rig(file)
    if guess is None:
        raise not_calibrated(path)
    return Rig(path, dict.fromkeys(names, guess))


def camera_file_text(cameras: Iterable[Camera], comments: Sequence[str] = ()) -> str:
    """Return the text of a camera file for several cameras, the first being the reference.

    Args:
        cameras: cameras with distinct names.
        comments: leading lines, written after "# ".
    """
    parts = ["".join(f"# {one_line(line)}".rstrip() + "\n" for line in comments)] if comments else []
    cameras = list(cameras)
    parts.append(f"reference = {_quoted(cameras[0].name)}\n")
    return "\n".join([*parts, *(_table(camera) for camera in cameras)])


def camera_record(file: Path | None) -> dict[str, str]:
    """Return the run record's entry for a camera file given by option: its text. Empty for None.

    The text lets a result reopen the input wherever the file is.
    """
    return {} if file is None else {CAMERA_FILE_KEY: read_text(file, limits.TEXT_BYTES)}


def check_baselines(cameras: Sequence[Camera], where: object) -> None:
    """Raise RecordingError if two cameras share one position, so that they see no depth."""
    centres = [inverse(np.array(camera.camera_T_reference))[:, 3] for camera in cameras]
    for i, j in combinations(range(len(cameras)), 2):
        distance = float(np.linalg.norm(centres[i] - centres[j]))
        if distance < NEAREST_MM:
            raise RecordingError(
                f"cameras '{cameras[i].name}' and '{cameras[j].name}' have no baseline",
                where=where,
                found=f"{distance:.3g} mm",
                expected=f"at least {NEAREST_MM:g} mm",
                hint="write translations in mm, or run posetrack calibrate stereo",
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
    """Return a TOML key, bare if possible."""
    bare = name.replace("_", "").replace("-", "")
    if bare.isascii() and bare.isalnum():
        return name
    return _quoted(name)


def _quoted(text: str) -> str:
    """Return a TOML string; JSON's escapes are valid in it."""
    return printable_json(json.dumps(text, ensure_ascii=False))


def _with_path(error: RecordingError, where: object) -> RecordingError:
    """Return an error of settings, which do not know their file, with the file's path."""
    return RecordingError(str(error).removeprefix(f"{CAMERA_FILE_NAME}: "), where=where)


def _has_no_extrinsics(camera: RigCamera | SingleCamera | Guess) -> bool:
    return not isinstance(camera, RigCamera) or (camera.rotation is None and camera.translation_mm is None)


def _reference_first(
    cameras: dict[str, RigCamera], values: Mapping[str, Any], path: Path
) -> dict[str, RigCamera]:
    reference = values.get("reference", next(iter(cameras)))
    if not isinstance(reference, str) or reference not in cameras:
        raise RecordingError(
            f"reference '{reference}' is not a camera", where=path, hint=nearest_name(str(reference), cameras)
        )
    return {reference: cameras[reference]} | cameras


def _mirror(values: Mapping[str, Any], path: Path) -> bool:
    mirror = values.get("mirror", False)
    if not isinstance(mirror, bool):
        raise RecordingError("invalid value for 'mirror'", where=path, found=mirror, expected="true or false")
    return mirror


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_text(path, limits.TEXT_BYTES))
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    except ValueError as error:
        raise RecordingError("not valid TOML", where=path, found=error) from error


def _checked(kind: type[AnyIntrinsics], values: dict[str, Any], where: object) -> AnyIntrinsics:
    try:
        settings = kind.model_validate(values)
        if settings.distortion:
            settings._camera(settings.width or 1, settings.height or 1)
    except ValidationError as error:
        raise _first_problem(error, kind, where) from error
    except PosetrackError as error:
        raise RecordingError(str(error), where=where) from error
    return settings


def _first_problem(error: ValidationError, kind: type[Intrinsics], where: object) -> RecordingError:
    first = error.errors(include_url=False)[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return RecordingError(f"unknown key '{key}'", where=where, hint=nearest_name(key, kind.model_fields))
    if first["type"] == "missing":
        return RecordingError(f"key '{key}' is missing", where=where, hint=f"for example {CAMERA_EXAMPLE}")
    return RecordingError(
        f"invalid value for '{key}'", where=where, found=first["input"], expected=expected_words(first)
    )
