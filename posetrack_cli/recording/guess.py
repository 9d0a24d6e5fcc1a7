"""Intrinsics that are guessed, for images of one camera of which nothing tells them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.orientation import Picture

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
