"""Picture orientation: the eight rotations and reflections of EXIF and video containers."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.exif import NOTHING, SHORT, TIFF_BEGIN, exif_numbers

EXIF_TAG = 274
# Order of polynomial distortion coefficients after exchanging x and y: swaps p1 and p2, s1 s2 and s3 s4.
TRANSPOSED_COEFFICIENTS = (0, 1, 3, 2, 4, 5, 6, 7, 10, 11, 8, 9)
# Coefficients that change sign in a reflection of x or of y; the last ones are the sensor tilt.
SIGNED_IN_X, SIGNED_IN_Y = (3, 8, 9, 13), (2, 10, 11, 12)
TILT = slice(12, 14)


class Orientation(NamedTuple):
    """How a stored picture is shown: transpose, then flip left to right, then upside down.

    Attributes:
        transposed, flipped_x, flipped_y: True for each operation that applies.
    """

    transposed: bool = False
    flipped_x: bool = False
    flipped_y: bool = False

    @property
    def words(self) -> str:
        """The orientation as text: ``turned 90 degrees clockwise``, ``mirrored``..."""
        return WORDS[self]

    def apply(self, image: ImageArray) -> ImageArray:
        """Return a stored picture (height, width, ...) as it is shown, contiguous."""
        if self == UPRIGHT:
            return image
        shown = image.swapaxes(0, 1) if self.transposed else image
        shown = shown[:, ::-1] if self.flipped_x else shown
        return np.ascontiguousarray(shown[::-1] if self.flipped_y else shown)

    def stored_size(self, width: int, height: int) -> tuple[int, int]:
        """Return width and height of the stored picture given the shown one, or vice versa."""
        return (height, width) if self.transposed else (width, height)

    def camera(self, stored: Camera) -> Camera:
        """Return the camera of the shown picture.

        A rotation also rotates the camera axes. A reflection does not: the shown picture is taken as the
        scene.

        Raises:
            PosetrackError: the lens model has a tilted sensor.
        """
        if self == UPRIGHT:
            return stored
        if any(stored.distortion[TILT]):
            raise PosetrackError(
                "cannot rotate pictures of a lens model with tilt",
                where=stored.name,
                hint="store the pictures upright, or calibrate without tilt",
            )
        camera = _transposed(stored) if self.transposed else stored
        if self.flipped_x:
            camera = replace(camera, cx=camera.width - 1 - camera.cx, distortion=_signed(camera, SIGNED_IN_X))
        if self.flipped_y:
            camera = replace(
                camera, cy=camera.height - 1 - camera.cy, distortion=_signed(camera, SIGNED_IN_Y)
            )
        rows = np.array(camera.camera_T_reference)
        if not self._is_reflection:
            rows = self._turn @ rows
        return replace(camera, camera_T_reference=tuple(tuple(float(v) + 0.0 for v in row) for row in rows))

    @property
    def _is_reflection(self) -> bool:
        return (self.transposed + self.flipped_x + self.flipped_y) % 2 == 1

    @property
    def _turn(self) -> ImageArray:
        """The (3, 3) rotation from the stored picture's camera axes to the shown one's."""
        turn = np.eye(3)
        if self.transposed:
            turn = turn[[1, 0, 2]]
        return np.diag([-1.0 if self.flipped_x else 1.0, -1.0 if self.flipped_y else 1.0, 1.0]) @ turn


UPRIGHT = Orientation()


class Picture(NamedTuple):
    """Size and orientation of a camera's shown pictures.

    Attributes:
        width, height: size of the shown picture, pixels.
        orientation: how it is made from the stored picture.
    """

    width: int
    height: int
    orientation: Orientation = UPRIGHT


WORDS = {
    UPRIGHT: "as it is stored",
    Orientation(False, True, False): "mirrored",
    Orientation(False, True, True): "turned by 180 degrees",
    Orientation(False, False, True): "mirrored and turned by 180 degrees",
    Orientation(True, False, False): "mirrored and turned 90 degrees counterclockwise",
    Orientation(True, True, False): "turned 90 degrees clockwise",
    Orientation(True, True, True): "mirrored and turned 90 degrees clockwise",
    Orientation(True, False, True): "turned 90 degrees counterclockwise",
}
OF_EXIF = dict(enumerate(WORDS, 1))  # WORDS is in the order of EXIF's numbers


def orientation_of_file(data: bytes) -> Orientation:
    """Return the orientation stated in a TIFF, or in the EXIF of a JPEG, PNG or WebP file."""
    kind, number = exif_numbers(data).get(EXIF_TAG, NOTHING)
    return OF_EXIF.get(int(number), UPRIGHT) if kind == SHORT else UPRIGHT


def orientation_of_decoding(data: bytes) -> Orientation:
    """Return the orientation that OpenCV applies on decoding: that of TIFF, whatever the flags."""
    return orientation_of_file(data) if data.startswith(TIFF_BEGIN) else UPRIGHT


def orientation_after_decoding(data: bytes) -> Orientation:
    """Return the orientation that remains to be applied to a decoded image."""
    return UPRIGHT if data.startswith(TIFF_BEGIN) else orientation_of_file(data)


def orientation_of_matrix(data: bytes) -> Orientation:
    """Return the orientation of a display matrix: nine 32-bit numbers, row by row, of [x y 1] M.

    Rotations other than by quarter turns count as upright.
    """
    if len(data) < 36:
        return UPRIGHT
    a, b, _, c, d, *_ = struct.unpack("<9i", data[:36])
    if not (a or d) and b and c:
        return Orientation(True, c < 0, b < 0)
    return Orientation(False, a < 0, d < 0) if not (b or c) else UPRIGHT


def _transposed(camera: Camera) -> Camera:
    d = camera.distortion
    is_polynomial = camera.distortion_model != "equidistant"
    order = [k for k in TRANSPOSED_COEFFICIENTS if k < len(d)]
    return replace(
        camera,
        width=camera.height,
        height=camera.width,
        fx=camera.fy,
        fy=camera.fx,
        cx=camera.cy,
        cy=camera.cx,
        distortion=(*(d[k] for k in order), *d[TILT]) if is_polynomial else d,
    )


def _signed(camera: Camera, places: tuple[int, ...]) -> tuple[float, ...]:
    if camera.distortion_model == "equidistant":
        return camera.distortion
    return tuple(-value if k in places else value for k, value in enumerate(camera.distortion))
