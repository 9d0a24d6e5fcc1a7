"""Pinhole cameras with lens distortion.

Pixel coordinates follow OpenCV: the centre of the first pixel is (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import PosetrackError

DISTORTION_LENGTHS = {
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
    "inverse_brown_conrady": (4, 5),
}
# Beyond those of any camera; within them no arithmetic on pixels overflows.
SMALLEST_FOCAL_PX, LARGEST_PX, LARGEST_COEFFICIENT = 0.1, 1e6, 1e6
# p2, the thin prism's s1 and s2, the sensor's tilt about y: with them x' keeps terms even in x
_CHANGE_SIGN_IN_A_MIRROR = (3, 8, 9, 13)
IN_PLACE = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
"""Transform of the reference camera."""


@dataclass(frozen=True)
class Camera:
    """A calibrated camera: u = fx x/z + cx, v = fy y/z + cy, after lens distortion.

    Attributes:
        width, height: image size, pixels.
        fx, fy, cx, cy: intrinsics, pixels.
        distortion: coefficients in OpenCV's order; empty for none.
        distortion_model: ``plumb_bob`` (k1 k2 p1 p2 k3), ``rational_polynomial``, ``equidistant`` or
            ``inverse_brown_conrady`` (plumb_bob's polynomial, from distorted to undistorted coordinates).
        name: frame id or folder name; topics of results carry it.
        camera_T_reference: (3, 4) transform from the recording's reference camera, mm.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    distortion_model: str = "plumb_bob"
    name: str = "camera"
    camera_T_reference: tuple[tuple[float, ...], ...] = IN_PLACE

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        focal_lengths = min(self.fx, self.fy) >= SMALLEST_FOCAL_PX
        if not all(np.isfinite(values)) or max(np.abs(values[:4])) > LARGEST_PX or not focal_lengths:
            raise PosetrackError(
                "intrinsics cannot be used",
                where=self.name,
                found=f"fx {self.fx} fy {self.fy} cx {self.cx} cy {self.cy}",
                expected=f"finite values up to {LARGEST_PX:g}, and fx, fy from {SMALLEST_FOCAL_PX:g} pixels",
            )
        if self.width <= 0 or self.height <= 0:
            raise PosetrackError(
                "image size cannot be used", where=self.name, found=f"{self.width}x{self.height}"
            )
        if max(np.abs(self.distortion), default=0.0) > LARGEST_COEFFICIENT:
            raise PosetrackError(
                "distortion cannot be used",
                where=self.name,
                found=f"coefficients {' '.join(f'{value:g}' for value in self.distortion)}",
                expected=f"up to {LARGEST_COEFFICIENT:g}",
            )
        lengths = DISTORTION_LENGTHS.get(self.distortion_model)
        if self.distortion and (lengths is None or len(self.distortion) not in lengths):
            raise PosetrackError(
                "distortion cannot be used",
                where=self.name,
                found=f"{self.distortion_model} with {len(self.distortion)} coefficients",
                expected="; ".join(f"{k} with {v}" for k, v in DISTORTION_LENGTHS.items()),
            )

    @property
    def matrix(self) -> FloatArray:
        """The (3, 3) intrinsic matrix K, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def values(self) -> dict[str, Any]:
        """Name, size, intrinsics and distortion as plain values, for records and JSON."""
        keys = ("name", "width", "height", "fx", "fy", "cx", "cy", "distortion", "distortion_model")
        return {key: getattr(self, key) for key in keys} | {"distortion": list(self.distortion)}

    @property
    def is_distorted(self) -> bool:
        """Whether any distortion coefficient differs from zero."""
        return any(self.distortion)

    def scaled(self, width: int, height: int) -> Camera:
        """Return the camera of the same picture at another resolution: cx' = (cx + 1/2) s - 1/2."""
        across, down = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * across,
            fy=self.fy * down,
            cx=(self.cx + 0.5) * across - 0.5,
            cy=(self.cy + 0.5) * down - 0.5,
        )

    def mirrored(self) -> Camera:
        """Return the camera of the image flipped left to right: cx' = width - 1 - cx.

        With other cameras mirrored too it sees the mirrored scene, x to -x in the reference's axes as well.
        """
        signs = [-1.0 if k in _CHANGE_SIGN_IN_A_MIRROR else 1.0 for k in range(len(self.distortion))]
        if self.distortion_model == "equidistant":
            signs = [1.0] * len(signs)
        distortion = tuple(sign * value for sign, value in zip(signs, self.distortion, strict=True))
        flip = (-1.0, 1.0, 1.0)
        rows = tuple(
            tuple(s * v * r + 0.0 for v, r in zip(row, (*flip, 1.0), strict=True))  # + 0.0: no -0.0
            for s, row in zip(flip, self.camera_T_reference, strict=True)
        )
        return replace(self, cx=self.width - 1 - self.cx, distortion=distortion, camera_T_reference=rows)

    def pixels_from_points(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Project without distortion.

        Args:
            points: (..., 3) in camera coordinates, mm.

        Returns:
            (..., 2) pixels, and (...) whether the point lies in front of the camera.
        """
        z = points[..., 2]
        valid = z > 0.0
        safe = np.where(valid, z, 1.0)
        u = self.fx * points[..., 0] / safe + self.cx
        v = self.fy * points[..., 1] / safe + self.cy
        return np.stack([u, v], axis=-1), valid

    def points_from_pixels(self, pixels: FloatArray, depth: FloatArray) -> FloatArray:
        """Back-project undistorted pixels (..., 2) with depth z (...) mm to (..., 3) points, mm."""
        x = (pixels[..., 0] - self.cx) / self.fx * depth
        y = (pixels[..., 1] - self.cy) / self.fy * depth
        return np.stack([x, y, np.broadcast_to(depth, x.shape)], axis=-1)
