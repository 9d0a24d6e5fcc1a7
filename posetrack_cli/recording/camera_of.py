"""Which camera model an image has."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.errors import PosetrackError, RecordingError, UsageError
from posetrack_cli.geometry.camera import (
    DISTORTION_LENGTHS,
    IN_PLACE,
    Camera,
    pixel_map,
    pixels_from_normalised,
)
from posetrack_cli.recording.base import NotCalibratedError
from posetrack_cli.recording.orientation import Picture

# Intrinsics that are guessed, for images of one camera of which nothing tells them


GUESSED = "guessed"
"""Where the model of such a camera comes from, in run records and descriptions."""
LIKELY_FOCAL = 1.0
"""Focal length over the image's longer side: a field of view of 53 degrees.

Webcams and telephones have 50 to 70 degrees as they film, videos of one face are often cut to less.
"""
NARROWEST_DEG, WIDEST_DEG = 1.0, 170.0
"""Of lenses whose images are those of a pinhole."""


@dataclass(frozen=True)
class Guess:
    """A camera that was not calibrated: square pixels, its axis through the middle, no distortion.

    Attributes:
        focal: focal length over the image's longer side.
    """

    focal: float = LIKELY_FOCAL

    # as of cameras in a camera file
    fps: ClassVar[None] = None
    picture: ClassVar[None] = None
    crop: ClassVar[None] = None
    bits: ClassVar[None] = None

    def stored_camera(
        self, width: int, height: int, name: str = "camera", *, picture: Picture | None = None
    ) -> Camera:
        """Return the camera of images of this size; how they are shown does not matter to their middle."""
        focal_px = self.focal * max(width, height)
        return Camera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, name=name)


def guess_of_field(fov_deg: float) -> Guess:
    """Return the guess for a field of view along the image's longer side, degrees.

    Raises:
        UsageError: it is that of no lens.
    """
    if not NARROWEST_DEG <= fov_deg <= WIDEST_DEG:
        expected = f"degrees from {NARROWEST_DEG:g} to {WIDEST_DEG:g}"
        raise UsageError("--fov cannot be used", found=f"{fov_deg:g}", expected=expected)
    return Guess(0.5 / math.tan(math.radians(fov_deg) / 2))


def guess_of_camera(camera: Camera) -> Guess:
    """Return the guess that a guessed camera was made by."""
    return Guess(camera.fx / max(camera.width, camera.height))


def check_one_camera(where: object, names: Iterable[str]) -> None:
    """Refuse several cameras where one is to be used.

    Raises:
        UsageError: listing them.
    """
    known = list(names)
    if len(known) > 1:
        raise UsageError(
            "several cameras, one can be used",
            where=where,
            found=", ".join(known),
            hint="choose one with --cameras",
        )


# Apply a calibration that changes during a recording, frame by frame.
#
# A recording has one camera model per camera. Images taken under another calibration of the same camera are
# resampled to the pixels of the first, which is exact up to a pixel: both see the same rays from one place.


Dated = tuple[int, Any]
"""Stamp, ns, and decoded message."""


class CurrentCamera:
    """The calibration that holds for an image.

    Args:
        first: camera of the recording's images as they are stored.
        camera_of: makes a camera of a decoded calibration.
    """

    def __init__(self, first: Camera, camera_of: Callable[[Any], Camera]) -> None:
        self._first = replace(first, camera_T_reference=IN_PLACE)
        self._camera_of = camera_of
        self._latest: Any = None
        self._known: Camera | None = None
        self._map: Resampling | None = None

    def resampling(self, calibration: Any) -> Resampling | None:
        """Return how images under a calibration become those of the first; None if they are.

        Raises:
            PosetrackError: the calibration is of another image size or cannot be used.
        """
        if calibration is None or calibration is self._latest:
            return self._map
        try:
            camera = self._camera_of(calibration)
        except NotCalibratedError:  # an empty calibration says nothing new
            return self._map
        self._latest = calibration
        if camera != self._known:
            self._known = camera
            self._map = None if is_same(self._first, camera) else Resampling(self._first, camera)
        return self._map


class Resampling:
    """Resamples images of one camera to the pixels of another in the same place."""

    def __init__(self, target: Camera, source: Camera) -> None:
        self._u, self._v = pixel_map(target, source)
        self._nearest: tuple[Float32Array, Float32Array] = (np.rint(self._u), np.rint(self._v))

    def apply(self, image: ImageArray) -> ImageArray:
        """Return the image at the target's pixels, 0 where the source has none.

        Depth is never interpolated: a value between hand and wall exists nowhere.
        """
        is_depth = image.dtype == np.float32
        u, v = self._nearest if is_depth else (self._u, self._v)
        how = cv2.INTER_NEAREST if is_depth else cv2.INTER_LINEAR
        return np.asarray(cv2.remap(image, u, v, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


def with_calibration(items: Iterable[tuple[bool, int, Any]]) -> Iterator[tuple[Any, Any]]:
    """Yield each image with the calibration that holds for it, None before the first.

    That is the one of the same stamp, which drivers write before or after the image, else the latest before.

    Args:
        items: in order of the file, whether it is a calibration, its stamp in ns, and what it is.
    """
    current: Any = None
    waiting: Dated | None = None
    for is_calibration, stamp, item in items:
        if not is_calibration:
            if waiting is not None:
                yield waiting[1], current
            waiting = (stamp, item)
            continue
        if waiting is not None and stamp != waiting[0]:
            yield waiting[1], current
            waiting = None
        current = item
    if waiting is not None:
        yield waiting[1], current


# Decide which camera model the pixels of an image follow.
#
# A calibration is about one grid of pixels: the raw or the rectified image of a sensor, at one resolution, of
# all of it or a part. The images of a recording may be on another. Every source of images comes here:
# messages with ``camera_of_message``, camera files with ``at_size`` and ``check_principal_point``.


MODEL_NAMES = {
    "Brown Conrady": "plumb_bob",  # as RealSense names it
    "Inverse Brown Conrady": "inverse_brown_conrady",
    "Kannala Brandt4": "equidistant",
    "kannala_brandt": "equidistant",
    "fisheye": "equidistant",
    "": "plumb_bob",
    "none": "plumb_bob",
    "None": "plumb_bob",
}
RECTIFIED = re.compile(r"(^|_)rect(ified)?(_|$)")
"""A part of a topic's name or of a frame id that ROS's drivers give to rectified images."""
REPROJECTED = re.compile(r"(?:aligned_)?depth_to_(\w+)|(registered)")
"""A part of a topic's name where depth was reprojected to the pixels of the camera that it names."""
COLOUR_WORDS = ("color", "colour", "rgb")
TRANSPORTS = ("compressed", "compressedDepth", "data", "theora", "ffmpeg")
"""What a topic's name has behind that of its images."""

SAME_PX = 0.05
"""Calibrations whose pixels differ by less are one: online calibration refines the last digits."""
GRID = 9
"""Rays across and down an image at which cameras are compared."""
OUTSIDE = "outside the image"
OFF_CENTRE = 0.25
"""A principal point farther from the middle than this share of the image is unusual; lenses reach 0.05."""
OTHER_SCALE, SAME_SCALE = 0.2, 0.04
"""A principal point that lies in both directions at one multiple of the middle, and off 1 by the first
number, is that of another resolution: multiples differ by at most the second number, twice what lenses do."""

USUAL_WIDTHS = (256, 320, 384, 424, 480, 512, 640, 720, 848, 960, 1024, 1080, 1280, 1440, 1600, 1920, 2560)
"""Of images of cameras, pixels."""


@dataclass(frozen=True)
class ImageCamera:
    """The camera model of a topic's or a folder's stored images.

    Attributes:
        camera: of the images as they are stored.
        why: where it comes from, for people.
        remarks: what was converted or is unusual, one line each.
        calibration, frame: topic and frame id of the messages that state it; empty for none.
    """

    camera: Camera
    why: str
    remarks: tuple[str, ...] = ()
    calibration: str = ""
    frame: str = ""


@dataclass(frozen=True)
class Calibration:
    """What a CameraInfo or CameraCalibration message states.

    Attributes:
        width, height: of the whole sensor's image, pixels.
        raw: intrinsics and distortion of the raw image; None where K is zero.
        rectified: intrinsics of the rectified image, from P; None where P is zero.
        binning: sensor pixels per image pixel, across and down.
        roi: x, y, width, height of the part of the sensor that images have, before binning.
    """

    width: int
    height: int
    raw: Camera | None
    rectified: Camera | None
    binning: tuple[int, int] = (1, 1)
    roi: tuple[int, int, int, int] | None = None


def calibration_of(decoded: Any, where: str) -> Calibration:
    """Return what a calibration message states.

    Raises:
        RecordingError: its values cannot be used.
    """
    width, height = int(decoded.width), int(decoded.height)
    k, p = matrix_of(decoded, "K", (3, 3)), matrix_of(decoded, "P", (3, 4))
    d = tuple(float(value) for value in _field(decoded, "D"))
    model, d = _lens(str(decoded.distortion_model), d)
    try:
        raw = None if k is None or k[0, 0] == 0.0 else _camera(width, height, k, d, model)
        rectified = None if p is None or 0.0 in (p[0, 0], p[1, 1]) else _camera(width, height, p)
    except PosetrackError as error:
        found = str(error).partition(", found ")[2] or str(error)
        what = "distortion cannot be used" if "distortion" in str(error) else "intrinsics cannot be used"
        raise RecordingError(f"{what}, found {found}", where=where, hint="pass --camera") from error
    binning = tuple(max(int(getattr(decoded, f"binning_{axis}", 0)), 1) for axis in "xy")
    return Calibration(width, height, raw, rectified, (binning[0], binning[1]), _roi(decoded))


def is_empty(decoded: Any) -> bool:
    """Return whether a calibration message states nothing, as some drivers' first ones do: K is zero."""
    k = matrix_of(decoded, "K", (3, 3))
    return k is None or k[0, 0] == 0.0


def camera_of_message(
    calibration: Calibration, size: tuple[int, int], *, rectified: bool, name: str, topic: str, images: str
) -> ImageCamera:
    """Return the camera of a topic's images.

    Rectified images have P and no distortion, raw ones K and D. A part of the sensor (roi) and binning apply
    where the images have that size; images of another resolution of the same shape get scaled intrinsics.

    Args:
        calibration: that belongs to the images.
        size: their width and height, pixels.
        rectified: whether they are rectified.
        name: of the camera.
        topic, images: of the calibration and of the images, for messages.

    Raises:
        NotCalibratedError: the calibration is empty, which its K of zeros marks.
        RecordingError: calibration and images do not fit together.
    """
    choice = (calibration.rectified or calibration.raw) if rectified else calibration.raw
    if choice is None:
        raise NotCalibratedError("camera is not calibrated", where=topic, found="K of zeros")
    is_p = choice is calibration.rectified
    whole = replace(choice, distortion=(), distortion_model="plumb_bob") if rectified else choice
    fitting = list(_of_size(replace(whole, name=name), calibration, size))
    if not fitting:
        raise _other_size(whole, size, topic, images)
    central = [found for found in fitting if principal_point_fault(found[0]) is None]
    camera, how = (central or fitting)[0]
    kind = "rectified" if rectified else "raw"
    why = f"{'P' if is_p else 'K'} of {topic}, {kind} images" + (f", {how}" if how else "")
    fault = principal_point_fault(camera)
    if fault is not None:
        raise _off_centre(camera, fault, topic)
    remarks = [f"images of {size[0]}x{size[1]}: camera is {why}"] if how else []
    return ImageCamera(camera, why, tuple(remarks) + off_centre_remark(camera), topic)


def is_rectified(topic: str, frame_id: str = "") -> bool:
    """Return whether a topic's images are rectified, by the names that drivers give."""
    return any(RECTIFIED.search(part) for part in (*topic.lower().split("/"), frame_id.lower()))


def reprojected_to(topic: str) -> tuple[str, ...]:
    """Return words for the camera that depth was reprojected to; none where it is in its own pixels."""
    for part in topic.lower().split("/"):
        found = REPROJECTED.search(part)
        if found:
            target = found.group(1) or ""
            is_colour = not target or target.startswith(COLOUR_WORDS)
            return COLOUR_WORDS if is_colour else (target,)
    return ()


def is_same_frame(frame: str, other: str) -> bool:
    """Return whether two frame ids are one; ROS 1 had a leading slash for a while."""
    return frame.lstrip("/") == other.lstrip("/")


def namespace_of(topic: str) -> str:
    """Return the namespace that a camera's driver publishes a topic of images in."""
    parts = topic.split("/")
    while len(parts) > 2 and parts[-1] in TRANSPORTS:
        parts = parts[:-1]
    return "/".join(parts[:-1])


def at_size(camera: Camera, width: int, height: int) -> Camera | None:
    """Return the camera at another resolution of the same picture; None where the aspect ratios differ."""
    if (camera.width, camera.height) == (width, height):
        return camera
    across = width / camera.width
    down = height / camera.height
    # the shorter side is rounded to whole pixels
    if abs(camera.height * across - height) > 1.0 and abs(camera.width * down - width) > 1.0:
        return None
    if max(width, height, camera.width, camera.height) < 8:  # rounding is all there is
        return None
    return camera.scaled(width, height)


def principal_point_fault(camera: Camera) -> str | None:
    """Return why a camera's principal point cannot be that of its images; None where it can.

    It lies outside, or at one multiple of the middle in both directions, as that of another resolution does.
    """
    across, down = _relative(camera)
    if not (0.0 <= across <= 2.0 and 0.0 <= down <= 2.0):
        return OUTSIDE
    scale = 0.5 * (across + down)
    if abs(scale - 1.0) > OTHER_SCALE and abs(across - down) < SAME_SCALE * scale:
        return f"at {scale:.3g} times the middle"
    return None


def off_centre_remark(camera: Camera) -> tuple[str, ...]:
    """Return a remark about a principal point far from the middle, if it is."""
    if not is_off_centre(camera):
        return ()
    where = f"cx {camera.cx:g} cy {camera.cy:g} in {camera.width}x{camera.height}"
    return (f"the principal point of the camera is far from the middle: {where}; is the image cropped?",)


def is_off_centre(camera: Camera) -> bool:
    """Return whether the principal point is farther from the middle than a quarter of the image."""
    return off_centre(camera) > 2.0 * OFF_CENTRE


def off_centre(camera: Camera) -> float:
    """Return how far the principal point is from the middle, as a share of half the image."""
    return max(abs(share - 1.0) for share in _relative(camera))


def is_same(first: Camera, other: Camera) -> bool:
    """Return whether two cameras see the same rays at the same pixels, to ``SAME_PX``."""
    if (first.width, first.height) != (other.width, other.height):
        return False
    if replace(other, name=first.name) == first:
        return True
    x = (np.linspace(0, first.width - 1, GRID) - first.cx) / first.fx
    y = (np.linspace(0, first.height - 1, GRID) - first.cy) / first.fy
    rays = np.stack(np.meshgrid(x, y), axis=-1)
    apart = pixels_from_normalised(first, rays) - pixels_from_normalised(other, rays)
    return bool(np.abs(apart).max() < SAME_PX)


def likely_size(camera: Camera) -> tuple[int, int]:
    """Return the width and height of the images in whose middle the principal point lies.

    A usual size of the same aspect ratio is preferred where one is near.
    """
    width, height = 2.0 * camera.cx + 1.0, 2.0 * camera.cy + 1.0
    for usual in sorted(USUAL_WIDTHS, key=lambda usual: abs(usual - width)):
        like = usual * camera.height / camera.width
        if max(abs(usual - width) / usual, abs(like - height) / like) < SAME_SCALE and like == round(like):
            return usual, round(like)
    return round(width), round(height)


def matrix_of(decoded: Any, name: str, shape: tuple[int, int]) -> FloatArray | None:
    """Return a matrix of a calibration message; None where it is absent, zero or not finite.

    ROS 1 and Foxglove write K, R and P, ROS 2 k, r and p.
    """
    values: Any = getattr(decoded, name, None)
    matrix = np.array([float(v) for v in (getattr(decoded, name.lower(), ()) if values is None else values)])
    if matrix.size != shape[0] * shape[1] or not matrix.any() or not np.isfinite(matrix).all():
        return None
    return matrix.reshape(shape)


def _of_size(whole: Camera, calibration: Calibration, size: tuple[int, int]) -> Iterator[tuple[Camera, str]]:
    """Yield the cameras of images of a size that a calibration may mean, and how; the likeliest first."""
    if (whole.width, whole.height) == size:
        yield whole, ""
    part, of_part = whole, ""
    if calibration.roi is not None:
        x, y, width, height = calibration.roi
        part = replace(whole, width=width, height=height, cx=whole.cx - x, cy=whole.cy - y)
        of_part = f"the part of {width}x{height} at {x}, {y}"
        if (width, height) == size:
            yield part, of_part
    across, down = calibration.binning
    if (across, down) != (1, 1):
        if (whole.width, whole.height) == size:  # a driver that states the size of what it delivers
            sensor = replace(whole, width=size[0] * across, height=size[1] * down)
            yield sensor.scaled(*size), f"binned {across}x{down}"
        binned = (part.width // across, part.height // down)
        if max(abs(a - b) for a, b in zip(binned, size, strict=True)) <= 1:
            how = f"binned {across}x{down}"
            scaled = replace(part, width=size[0] * across, height=size[1] * down).scaled(*size)
            yield scaled, f"{of_part}, {how}" if of_part else how
    for source, how in ((part, of_part), (whole, "")):
        camera = None if (source.width, source.height) == size else at_size(source, *size)
        if camera is not None:
            scaled_by = f"scaled from {source.width}x{source.height}"
            yield camera, f"{how}, {scaled_by}" if how else scaled_by


def _other_size(camera: Camera, size: tuple[int, int], topic: str, images: str) -> RecordingError:
    is_turned = at_size(camera, size[1], size[0]) is not None
    return RecordingError(
        "images are rotated against their calibration"
        if is_turned
        else "calibration and images differ in size",
        where=topic,
        found=f"{camera.width}x{camera.height}",
        expected=f"{size[0]}x{size[1]} as on {images}",
        hint="pass --camera with the camera of the images"
        + (" as they are stored" if is_turned else ", or choose another calibration with --camera-topic"),
    )


def _off_centre(camera: Camera, fault: str, where: str) -> RecordingError:
    width, height = likely_size(camera)
    return RecordingError(
        f"principal point is {fault}",
        where=where,
        found=f"cx {camera.cx:g} cy {camera.cy:g} in images of {camera.width}x{camera.height}",
        expected=f"a calibration of these images; is this one of {width}x{height}?",
        hint="pass --camera with the camera of these images",
    )


def _relative(camera: Camera) -> tuple[float, float]:
    """The principal point as a multiple of the middle, across and down; edges are at 0 and 2."""
    return 2.0 * (camera.cx + 0.5) / camera.width, 2.0 * (camera.cy + 0.5) / camera.height


def _camera(
    width: int, height: int, k: FloatArray, d: tuple[float, ...] = (), model: str = "plumb_bob"
) -> Camera:
    fx, fy, cx, cy = (float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(width, height, fx, fy, cx, cy, d, model)


def _lens(model: str, d: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """Return model and coefficients; drivers state models by many names, and pad coefficients with zeros."""
    if not any(d):
        return "plumb_bob", ()
    known = MODEL_NAMES.get(model, model)
    if known == "plumb_bob" and len(d) in DISTORTION_LENGTHS["rational_polynomial"]:
        known = "rational_polynomial"
    elif known == "rational_polynomial" and len(d) in DISTORTION_LENGTHS["plumb_bob"]:
        known = "plumb_bob"
    elif known == "equidistant" and len(d) > 4 and not any(d[4:]):
        d = d[:4]
    return known, d


def _roi(decoded: Any) -> tuple[int, int, int, int] | None:
    roi = getattr(decoded, "roi", None)
    if roi is None or not (roi.width and roi.height):
        return None
    return int(roi.x_offset), int(roi.y_offset), int(roi.width), int(roi.height)


def _field(decoded: Any, name: str) -> Any:
    """ROS 1 and Foxglove write D, ROS 2 d."""
    value = getattr(decoded, name, None)
    return getattr(decoded, name.lower()) if value is None else value
