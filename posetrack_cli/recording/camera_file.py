"""camera.toml: intrinsics and depth format of a recording, written by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError

from posetrack_cli import limits
from posetrack_cli.configuration import Settings, expected_words
from posetrack_cli.errors import PosetrackError, RecordingError, nearest_name
from posetrack_cli.files import read_text
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.depth import Window
from posetrack_cli.toml_text import parse_toml

CAMERA_FILE_NAME = "camera.toml"
EXAMPLE = "fx = 365.0, fy = 365.0, cx = 255.5, cy = 211.5, depth_unit_mm = 1.0, each on its own line"

Finite = Annotated[float, Field(allow_inf_nan=False)]
Unit = Annotated[float, Field(ge=1e-6, le=1e6)]  # 16-bit codes of it are depths that float32 holds
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


File = TypeVar("File", bound="Intrinsics")


class Intrinsics(Settings):
    """What a camera file says about one camera's stored images, whatever they hold.

    Attributes:
        width, height: size of the stored images, pixels; checked against them when given.
        fx, fy, cx, cy: intrinsics, pixels.
        distortion, distortion_model: as in ``Camera``.
        crop: x, y, width, height of the part that is used; cut out before mirroring.
    """

    width: Annotated[int, Field(gt=0)] | None = None
    height: Annotated[int, Field(gt=0)] | None = None
    fx: Positive
    fy: Positive
    cx: Finite
    cy: Finite
    distortion: tuple[Finite, ...] = ()
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = "plumb_bob"
    crop: tuple[int, int, int, int] | None = None

    def stored_camera(self, width: int, height: int, name: str = "camera") -> Camera:
        """Return the camera of stored images of this size.

        Raises:
            RecordingError: if the file gives another size.
        """
        wanted = (self.width or width, self.height or height)
        if wanted != (width, height):
            raise RecordingError(
                "camera file and images differ in size",
                where=CAMERA_FILE_NAME,
                found=f"images of {width}x{height}",
                expected=f"{wanted[0]}x{wanted[1]}",
                hint="crop = [x, y, width, height] uses a part of the images",
            )
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


class CameraFile(Intrinsics):
    """What camera.toml says of one depth camera; all of it about the images before crop and mirror.

    Attributes:
        depth_unit_mm: millimetres per stored unit.
        missing: stored code that means no reading; 0 always means it, too.
        mirror: flip the images left to right.
    """

    depth_unit_mm: Unit = 1.0
    missing: Annotated[int, Field(ge=0, le=65535)] = 0
    mirror: bool = False

    @property
    def window(self) -> Window:
        """The part of the images that is used."""
        return Window(self.crop, self.mirror)


def load_camera_file(path: Path) -> CameraFile:
    """Read and check a camera.toml.

    Raises:
        RecordingError: if it is missing, not TOML, or a key is unknown, missing or of the wrong kind.
    """
    return checked_settings(CameraFile, read_toml(path), path)


def read_toml(path: Path) -> dict[str, Any]:
    """Return what a TOML file says.

    Raises:
        RecordingError: if it is missing or not TOML.
    """
    try:
        return parse_toml(read_text(path, limits.TEXT_BYTES))
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    except ValueError as error:
        raise RecordingError("is not TOML", where=path, found=error) from error


class NotCalibratedError(RecordingError):
    """Nothing tells a camera's intrinsics."""


def no_intrinsics(where: object) -> NotCalibratedError:
    """Return the error for a recording without any camera, with what to write."""
    return NotCalibratedError(
        "no intrinsics", where=where, hint=f"write them to a {CAMERA_FILE_NAME} and pass --camera: {EXAMPLE}"
    )


def checked_settings(kind: type[File], values: dict[str, Any], where: object) -> File:
    """Return the settings of one camera that a table of a camera file holds.

    Raises:
        RecordingError: if a key is unknown, missing or of the wrong kind.
    """
    try:
        settings = kind.model_validate(values)
        if settings.distortion:
            settings.stored_camera(settings.width or 1, settings.height or 1)
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
        return RecordingError(f"key '{key}' is missing", where=where, hint=f"for example {EXAMPLE}")
    return RecordingError(
        f"key '{key}' cannot be used", where=where, found=first["input"], expected=expected_words(first)
    )
