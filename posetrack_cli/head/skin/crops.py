"""Faces cut out upright and at one size, and which of them a first pass keeps.

Lighting stays where it is while skin turns through it: a cheek that is brighter on one side looks as if it
moved less than it did. So crops keep only what is finer than ``FINE_PX``; with all of it rendered heads were
said to nod by .75 to .9 of what they did.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import pixels_wherever
from posetrack_cli.geometry.rotations import angle_between
from posetrack_cli.head.adjustment.views import PointView
from posetrack_cli.head.face.pose import HeadPose

WIDTH, HEIGHT = 176, 208
"""Of a crop, from the forehead to the chin."""
PX_PER_MM = 1.25
"""Eyes come 80 pixels apart. With 1 or 1.6 rendered and real heads came out alike."""
MIDDLE = np.array([0.0, -20.0, 15.0])
"""(3,) of a crop, in the head's frame, mm: the bridge of the nose."""
FINE_PX, GREY, CONTRAST = 4.0, 128.0, 2.0
"""Deviation of the blur that is taken away, and how the rest is kept in eight bits."""

EVERY_NS = 250_000_000
"""Between two frames kept, at first ..."""
SOONEST, TURNED_DEG = 0.25, 10.0
"""... and this share of it where the head turned by so much."""
MOST_VIEWS = 120
"""Of more frames kept every second goes."""


@dataclass(frozen=True, eq=False)
class SkinView:
    """A frame as it shows the skin.

    Attributes:
        view: its feature points, and the pose that they tell.
        crop: (HEIGHT, WIDTH) fine detail.
        placement: (2, 3) from pixels of the crop to those of the image.
    """

    view: PointView
    crop: ImageArray
    placement: FloatArray

    def seen_larger(self, ratio: float) -> SkinView:
        """Return the frame as an image shows it that is so many times as large."""
        placement = ratio * self.placement
        placement[:, 2] += 0.5 * (ratio - 1.0)
        return replace(self, view=self.view.seen_larger(ratio), placement=placement)


@dataclass(frozen=True, eq=False)
class SkinAlbum:
    """Frames kept, evenly in time, and more of them while the head turns.

    Attributes:
        views: in the order of their time.
        every_ns: between two of them, at least; ``SOONEST`` of it where the head turned.
    """

    views: tuple[SkinView, ...] = ()
    every_ns: int = 0

    def wants(self, stamp_ns: int, pose: HeadPose, turned_deg: float = TURNED_DEG) -> bool:
        """Whether a frame is late enough after the last one kept: sooner if the head turned by so much."""
        if not self.views:
            return True
        last = self.views[-1].view
        turned = np.degrees(angle_between(last.pose.quaternion, pose.quaternion)) >= turned_deg
        return stamp_ns - last.stamp_ns >= (SOONEST if turned else 1.0) * self.every_ns

    def with_view(self, view: SkinView, most: int) -> SkinAlbum:
        """Return the album with a frame; of more than ``most`` every second goes, and stays away."""
        views = (*self.views, view)
        if len(views) <= most:
            return replace(self, views=views)
        return SkinAlbum(views[::2], 2 * self.every_ns)

    def seen_larger(self, ratio: float) -> SkinAlbum:
        """Return the same frames as images show them that are so many times as large."""
        return replace(self, views=tuple(one.seen_larger(ratio) for one in self.views))


def place_crop(camera: Camera, pose: HeadPose) -> FloatArray:
    """Return (2, 3), from pixels of a crop to pixels of an image: turned, scaled and moved, not sheared.

    A head that looks along the camera's x axis, which has no upright in the image, is taken as it is.
    """
    middle = pose.points(MIDDLE)
    centre, beside = pixels_wherever(camera, np.stack([middle, middle + pose.rotation[:, 0]]))
    across = beside - centre
    angle = float(np.arctan2(across[1], across[0]))
    scale = 0.5 * (camera.fx + camera.fy) / max(float(middle[2]), 1.0) / PX_PER_MM
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([turn, centre - turn @ [WIDTH / 2, HEIGHT / 2]])


def cut(image: ImageArray, placement: FloatArray) -> ImageArray:
    """Return the crop (HEIGHT, WIDTH) of a grey image; beyond its border as at the border."""
    warp = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    raw = cv2.warpAffine(image, placement, (WIDTH, HEIGHT), flags=warp, borderMode=cv2.BORDER_REPLICATE)
    fine = raw.astype(np.float32)
    fine -= cv2.GaussianBlur(fine, (0, 0), FINE_PX)
    kept: ImageArray = np.clip(GREY + CONTRAST * fine, 0.0, 255.0).astype(np.uint8)
    return kept


def to_image(placement: FloatArray, places: FloatArray) -> FloatArray:
    """Return the pixels (..., 2) of an image at places (..., 2) of its crop."""
    pixels: FloatArray = places @ placement[:, :2].T + placement[:, 2]
    return pixels


def to_crop(placement: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return the places (..., 2) in a crop of pixels (..., 2) of its image."""
    places: FloatArray = (pixels - placement[:, 2]) @ np.linalg.inv(placement[:, :2]).T
    return places
