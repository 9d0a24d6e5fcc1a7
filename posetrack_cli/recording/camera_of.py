"""Camera models of images: guessed intrinsics, changing calibrations, and calibration messages."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

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

# Guessed intrinsics of a single uncalibrated camera


# Source of a guessed model, in run records and descriptions.
GUESSED = "guessed"
# Focal length over the longer image side: a field of view of 53 degrees. Head trackers estimate it.
LIKELY_FOCAL = 1.0
NARROWEST_DEG, WIDEST_DEG = 1.0, 170.0  # range in which a pinhole model holds


@dataclass(frozen=True)
class Guess:
    """An uncalibrated camera: square pixels, principal point at the centre, no distortion.

    Attributes:
        focal: focal length over the longer image side.
    """

    focal: float = LIKELY_FOCAL

    @property
    def fov_deg(self) -> float:
        """Field of view along the longer image side, degrees; inverse of ``guess_of_field``."""
        return math.degrees(2.0 * math.atan(0.5 / self.focal))

    # the attributes of cameras in a camera file
    fps: ClassVar[None] = None
    picture: ClassVar[None] = None
    crop: ClassVar[None] = None
    bits: ClassVar[None] = None

    def stored_camera(
        self, width: int, height: int, name: str = "camera", *, picture: Picture | None = None
    ) -> Camera:
        """Return the camera of images of this size; ``picture`` does not matter to a centred model."""
        focal_px = self.focal * max(width, height)
        return Camera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, name=name)


def guess_of_field(fov_deg: float) -> Guess:
    """Return the guess for a field of view along the longer image side, degrees.

    Raises:
        UsageError: the angle is out of range.
    """
    if not NARROWEST_DEG <= fov_deg <= WIDEST_DEG:
        expected = f"degrees from {NARROWEST_DEG:g} to {WIDEST_DEG:g}"
        raise UsageError("--fov out of range", found=f"{fov_deg:g}", expected=expected)
    return Guess(0.5 / math.tan(math.radians(fov_deg) / 2))


def guess_of_camera(camera: Camera) -> Guess:
    """Return the guess from which a guessed camera was made."""
    return Guess(camera.fx / max(camera.width, camera.height))


def require_single_camera(where: object, names: Iterable[str]) -> None:
    """Raise UsageError, listing the cameras, if there are several."""
    known = list(names)
    if len(known) > 1:
        raise UsageError(
            "several cameras",
            where=where,
            found=", ".join(known),
            expected="one",
            hint="choose one with --cameras",
        )


# Calibrations that change during a recording
#
# Frames of one camera share one model. Images taken under a later calibration are resampled to the pixels of
# the first: same optical centre, so the mapping is exact up to pixel sampling.

StampedMessage = tuple[int, Any]  # stamp, ns, and decoded message


class CurrentCamera:
    """The calibration in effect for an image.

    Args:
        first: camera of the recording's stored images.
        camera_of: returns the camera of a decoded calibration.
    """

    def __init__(self, first: Camera, camera_of: Callable[[Any], Camera]) -> None:
        self._first = replace(first, camera_T_reference=IN_PLACE)
        self._camera_of = camera_of
        self._latest: Any = None
        self._known: Camera | None = None
        self._map: Resampling | None = None

    def resampling(self, calibration: Any) -> Resampling | None:
        """Return the resampling from a calibration's pixels to the first one's; None if they agree.

        Raises:
            PosetrackError: the calibration has another image size or is invalid.
        """
        if calibration is None or calibration is self._latest:
            return self._map
        try:
            camera = self._camera_of(calibration)
        except NotCalibratedError:  # some drivers publish empty calibrations now and then
            return self._map
        self._latest = calibration
        if camera != self._known:
            self._known = camera
            self._map = None if is_same(self._first, camera) else Resampling(self._first, camera)
        return self._map


class Resampling:
    """Resamples images of one camera to the pixels of another with the same optical centre."""

    def __init__(self, target: Camera, source: Camera) -> None:
        self._u, self._v = pixel_map(target, source)
        self._nearest: tuple[Float32Array, Float32Array] = (np.rint(self._u), np.rint(self._v))

    def apply(self, image: ImageArray) -> ImageArray:
        """Return the image at the target's pixels, 0 where the source has none.

        Depth uses the nearest neighbour: interpolation would invent depths between hand and wall.
        """
        import cv2  # evaluation also works without it

        is_depth = image.dtype == np.float32
        u, v = self._nearest if is_depth else (self._u, self._v)
        how = cv2.INTER_NEAREST if is_depth else cv2.INTER_LINEAR
        return np.asarray(cv2.remap(image, u, v, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


def pair_with_calibration(items: Iterable[tuple[bool, int, Any]]) -> Iterator[tuple[Any, Any]]:
    """Yield each image with the calibration in effect, None before the first.

    That is the one with the image's stamp, which drivers write before or after the image, else the latest
    before it.

    Args:
        items: in file order, (is calibration, stamp in ns, item).
    """
    current: Any = None
    waiting: StampedMessage | None = None
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


# Camera model of an image
#
# A calibration describes one pixel grid: raw or rectified, at one resolution, of the whole sensor or a
# region. Stored images may use another. Messages go through ``camera_of_message``, camera files through
# ``at_size`` and ``principal_point_fault``.


MODEL_NAMES = {
    "Brown Conrady": "plumb_bob",  # RealSense
    "Inverse Brown Conrady": "inverse_brown_conrady",
    "Kannala Brandt4": "equidistant",
    "kannala_brandt": "equidistant",
    "fisheye": "equidistant",
    "": "plumb_bob",
    "none": "plumb_bob",
    "None": "plumb_bob",
}
# Part of a topic name or frame id that ROS drivers give to rectified images.
RECTIFIED = re.compile(r"(^|_)rect(ified)?(_|$)")
# Part of a topic name of depth that was reprojected to the pixels of another camera.
REPROJECTED = re.compile(r"(?:aligned_)?depth_to_(\w+)|(registered)")
COLOUR_WORDS = ("color", "colour", "rgb")
# Suffixes of an image topic's name.
TRANSPORTS = ("compressed", "compressedDepth", "data", "theora", "ffmpeg")

# Calibrations closer than this are equal: online calibration refines the last digits.
SAME_PX = 0.05
GRID = 9  # rays across and down an image at which cameras are compared
OUTSIDE = "outside the image"
# Offset of the principal point from the centre, over the image size, above which it is unusual; lenses
# reach 0.05.
OFF_CENTRE = 0.25
# A principal point at the same multiple of the centre in x and y belongs to another resolution if the
# multiple differs from 1 by the first value; x and y may differ by the second, twice what lenses do.
OTHER_SCALE, SAME_SCALE = 0.2, 0.04

# Image widths of common cameras, pixels.
USUAL_WIDTHS = (256, 320, 384, 424, 480, 512, 640, 720, 848, 960, 1024, 1080, 1280, 1440, 1600, 1920, 2560)


@dataclass(frozen=True)
class ImageCamera:
    """The camera model of the stored images of a topic or folder.

    Attributes:
        camera: model of the images as stored.
        why: its source, as text.
        remarks: conversions and unusual values, one line each.
        calibration, frame: topic and frame id of the calibration messages; empty for none.
    """

    camera: Camera
    why: str
    remarks: tuple[str, ...] = ()
    calibration: str = ""
    frame: str = ""


@dataclass(frozen=True)
class Calibration:
    """The content of a CameraInfo or CameraCalibration message.

    Attributes:
        width, height: size of the full sensor image, pixels.
        raw: intrinsics and distortion of the raw image; None if K is zero.
        rectified: intrinsics of the rectified image, from P; None if P is zero.
        binning: sensor pixels per image pixel, across and down.
        roi: x, y, width, height of the sensor region in the images, before binning.
    """

    width: int
    height: int
    raw: Camera | None
    rectified: Camera | None
    binning: tuple[int, int] = (1, 1)
    roi: tuple[int, int, int, int] | None = None


def calibration_of(decoded: Any, where: str) -> Calibration:
    """Return the content of a calibration message.

    Raises:
        RecordingError: its values are invalid.
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
        what = "unsupported distortion" if "distortion" in str(error) else "invalid intrinsics"
        raise RecordingError(f"{what}, found {found}", where=where, hint="pass --camera") from error
    binning = tuple(max(int(getattr(decoded, f"binning_{axis}", 0)), 1) for axis in "xy")
    return Calibration(width, height, raw, rectified, (binning[0], binning[1]), _roi(decoded))


def is_empty(decoded: Any) -> bool:
    """Return whether a calibration message is empty (K is zero), as some drivers' first ones are."""
    k = matrix_of(decoded, "K", (3, 3))
    return k is None or k[0, 0] == 0.0


def camera_of_message(
    calibration: Calibration, size: tuple[int, int], *, rectified: bool, name: str, topic: str, images: str
) -> ImageCamera:
    """Return the camera of a topic's images.

    Rectified images use P without distortion, raw ones K and D. Region of interest and binning apply if the
    images have that size; images of another resolution with the same aspect ratio get scaled intrinsics.

    Args:
        calibration: calibration of the images.
        size: width and height of the images, pixels.
        rectified: True if the images are rectified.
        name: name of the camera.
        topic, images: topics of the calibration and of the images, for messages.

    Raises:
        NotCalibratedError: the calibration is empty (K is zero).
        RecordingError: calibration and images do not match.
    """
    choice = (calibration.rectified or calibration.raw) if rectified else calibration.raw
    if choice is None:
        raise NotCalibratedError("camera is not calibrated", where=topic, found="K = 0")
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
    remarks = [f"camera of {size[0]}x{size[1]} images: {why}"] if how else []
    return ImageCamera(camera, why, tuple(remarks) + off_centre_remark(camera), topic)


def is_rectified(topic: str, frame_id: str = "") -> bool:
    """Return whether a topic's images are rectified, judged by driver naming conventions."""
    return any(RECTIFIED.search(part) for part in (*topic.lower().split("/"), frame_id.lower()))


def reprojected_to(topic: str) -> tuple[str, ...]:
    """Return names of the camera that depth was reprojected to; empty for depth in its own pixels."""
    for part in topic.lower().split("/"):
        found = REPROJECTED.search(part)
        if found:
            target = found.group(1) or ""
            is_colour = not target or target.startswith(COLOUR_WORDS)
            return COLOUR_WORDS if is_colour else (target,)
    return ()


def is_same_frame(frame: str, other: str) -> bool:
    """Return whether two frame ids are equal up to the leading slash of early ROS 1."""
    return frame.lstrip("/") == other.lstrip("/")


def namespace_of(topic: str) -> str:
    """Return the namespace in which a driver publishes an image topic."""
    parts = topic.split("/")
    while len(parts) > 2 and parts[-1] in TRANSPORTS:
        parts = parts[:-1]
    return "/".join(parts[:-1])


def at_size(camera: Camera, width: int, height: int) -> Camera | None:
    """Return the camera at another resolution; None if the aspect ratios differ."""
    if (camera.width, camera.height) == (width, height):
        return camera
    across = width / camera.width
    down = height / camera.height
    # one side is rounded to whole pixels
    if abs(camera.height * across - height) > 1.0 and abs(camera.width * down - width) > 1.0:
        return None
    if max(width, height, camera.width, camera.height) < 8:  # rounding hides any aspect ratio
        return None
    return camera.scaled(width, height)


def principal_point_fault(camera: Camera) -> str | None:
    """Return why a principal point cannot belong to the images; None if it can.

    It lies outside, or at one multiple of the centre in both directions, as for another resolution.
    """
    across, down = _relative(camera)
    if not (0.0 <= across <= 2.0 and 0.0 <= down <= 2.0):
        return OUTSIDE
    scale = 0.5 * (across + down)
    if abs(scale - 1.0) > OTHER_SCALE and abs(across - down) < SAME_SCALE * scale:
        return f"at {scale:.3g} times the image centre"
    return None


def off_centre_remark(camera: Camera) -> tuple[str, ...]:
    """Return a remark if the principal point is far from the image centre."""
    if not is_off_centre(camera):
        return ()
    where = f"cx {camera.cx:g} cy {camera.cy:g} in {camera.width}x{camera.height}"
    return (f"principal point is far from the image centre: {where}; are the images cropped?",)


def is_off_centre(camera: Camera) -> bool:
    """Return whether the principal point is off the centre by more than a quarter of the image."""
    return off_centre(camera) > 2.0 * OFF_CENTRE


def off_centre(camera: Camera) -> float:
    """Return the offset of the principal point from the centre, over half the image size."""
    return max(abs(share - 1.0) for share in _relative(camera))


def is_same(first: Camera, other: Camera) -> bool:
    """Return whether two cameras map the same rays to the same pixels, within ``SAME_PX``."""
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
    """Return the width and height of images that have the principal point at their centre.

    Prefers a common size of the same aspect ratio if one is close.
    """
    width, height = 2.0 * camera.cx + 1.0, 2.0 * camera.cy + 1.0
    for usual in sorted(USUAL_WIDTHS, key=lambda usual: abs(usual - width)):
        like = usual * camera.height / camera.width
        if max(abs(usual - width) / usual, abs(like - height) / like) < SAME_SCALE and like == round(like):
            return usual, round(like)
    return round(width), round(height)


def matrix_of(decoded: Any, name: str, shape: tuple[int, int]) -> FloatArray | None:
    """Return a matrix of a calibration message; None if absent, zero or not finite.

    ROS 1 and Foxglove name them K, R and P, ROS 2 k, r and p.
    """
    values: Any = getattr(decoded, name, None)
    matrix = np.array([float(v) for v in (getattr(decoded, name.lower(), ()) if values is None else values)])
    if matrix.size != shape[0] * shape[1] or not matrix.any() or not np.isfinite(matrix).all():
        return None
    return matrix.reshape(shape)


def _of_size(whole: Camera, calibration: Calibration, size: tuple[int, int]) -> Iterator[tuple[Camera, str]]:
    """Yield possible cameras of images of a size, with the conversion; the likeliest first."""
    if (whole.width, whole.height) == size:
        yield whole, ""
    part, of_part = whole, ""
    if calibration.roi is not None:
        x, y, width, height = calibration.roi
        part = replace(whole, width=width, height=height, cx=whole.cx - x, cy=whole.cy - y)
        of_part = f"region {width}x{height} at {x}, {y}"
        if (width, height) == size:
            yield part, of_part
    across, down = calibration.binning
    if (across, down) != (1, 1):
        if (whole.width, whole.height) == size:  # some drivers give the binned size as full size
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
        "images are rotated relative to their calibration"
        if is_turned
        else "calibration and images differ in size",
        where=topic,
        found=f"{camera.width}x{camera.height}",
        expected=f"{size[0]}x{size[1]} as on {images}",
        hint="pass --camera with the intrinsics of the stored images"
        + ("" if is_turned else ", or choose another calibration with --camera-topic"),
    )


def _off_centre(camera: Camera, fault: str, where: str) -> RecordingError:
    width, height = likely_size(camera)
    return RecordingError(
        f"principal point is {fault}",
        where=where,
        found=f"cx {camera.cx:g} cy {camera.cy:g} in {camera.width}x{camera.height} images",
        expected=f"a calibration of these images (this one fits {width}x{height})",
        hint="pass --camera with the intrinsics of these images",
    )


def _relative(camera: Camera) -> tuple[float, float]:
    """Return the principal point over the centre, across and down; image edges are at 0 and 2."""
    return 2.0 * (camera.cx + 0.5) / camera.width, 2.0 * (camera.cy + 0.5) / camera.height


def _camera(
    width: int, height: int, k: FloatArray, d: tuple[float, ...] = (), model: str = "plumb_bob"
) -> Camera:
    fx, fy, cx, cy = (float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(width, height, fx, fy, cx, cy, d, model)


def _lens(model: str, d: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """Return model and coefficients; drivers use many model names and pad coefficients with zeros."""
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
    """Return a field named D in ROS 1 and Foxglove, d in ROS 2."""
    value = getattr(decoded, name, None)
    return getattr(decoded, name.lower()) if value is None else value
