"""Pictures of one instant on the images of cameras: estimates drawn on each, and a caption."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.viewing.captions import Captions
from posetrack_cli.evaluation.viewing.colours import TEXT, TRUTH
from posetrack_cli.evaluation.viewing.drawing import Canvas, marked
from posetrack_cli.evaluation.viewing.layers import (
    MOST_RESULTS,
    Drawing,
    DrawnEstimate,
    DrawnTrack,
    Instant,
    ViewOptions,
)
from posetrack_cli.evaluation.viewing.viewport import Framing
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import in_camera_axes, pixel_map
from posetrack_cli.geometry.rotations import canonical, multiply, quaternions_from_matrices
from posetrack_cli.results.subject_kind import kind_of

NO_IMAGE = 40
"""Grey of a picture that the camera did not take."""


LAYOUTS = ("beside", "over", "side-by-side")
ANGLES = ("roll", "pitch", "yaw")


class CameraPanel:
    """Draws what one of several cameras saw.

    Args:
        camera: placed relative to that of the estimates.
        drawing: says which part is shown.
    """

    def __init__(self, camera: Camera, drawing: Drawing) -> None:
        self._camera = camera
        self._framing = Framing(
            camera, drawing.around, drawing.scale, still=drawing.still, shrunk=drawing.shrunk
        )

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of its pictures, pixels."""
        return self._framing.size

    def canvas(self, image: ImageArray | None, points: FloatArray | None) -> Canvas:
        """Return the picture of an image, to paint on.

        Args:
            image: (h, w) or (h, w, 3) uint8 as it was taken, None where the camera gave none.
            points: (P, 3) mm, in the axes of the reference camera, that it is cut out around if the part that
                is shown moves.
        """
        viewport = self._framing.viewport(points)
        straight = self._straight(image)
        cut = viewport.cut(straight)
        picture = cut.copy() if cut.ndim == 3 else cv2.cvtColor(np.ascontiguousarray(cut), cv2.COLOR_GRAY2BGR)
        return Canvas(picture, viewport.camera(self._camera))

    def _straight(self, image: ImageArray | None) -> ImageArray:
        """The image without lens distortion."""
        if image is None:
            return np.full((self._camera.height, self._camera.width), NO_IMAGE, dtype=np.uint8)
        if not self._camera.is_distorted:
            return image
        u, v = self._map
        return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR))

    @cached_property
    def _map(self) -> tuple[Float32Array, Float32Array]:
        """u and v (h, w) in the image as it was taken, for every pixel of one without distortion."""
        return pixel_map(replace(self._camera, distortion=()), self._camera)


def seen_from(camera: Camera, drawn: DrawnEstimate) -> DrawnEstimate:
    """The estimate, from the reference camera's axes to another's."""
    shown, turned = drawn.shown, None
    if shown.quaternion is not None:
        rotation = quaternions_from_matrices(np.array(camera.camera_T_reference)[:, :3])
        turned = canonical(multiply(rotation, shown.quaternion))
    position = None if shown.position is None else in_camera_axes(camera, shown.position)
    points = None if shown.points is None else in_camera_axes(camera, shown.points)
    return replace(drawn, shown=replace(shown, position=position, quaternion=turned, points=points))


class ImagePanels:
    """Draws frames: cameras beside each other, results one below the other.

    Args:
        cameras: of the images.
        drawing: what is shown.
    """

    def __init__(self, cameras: Sequence[Camera], drawing: Drawing) -> None:
        self.drawing = drawing
        self._panels = [CameraPanel(camera, drawing) for camera in cameras]
        width, when = self._body_size[0], drawing.longest_when
        longest = [[*when, *drawn.longest_words, *_longest_angles(drawn)] for drawn in drawing.tracks]
        self._captions = [Captions([words], width) for words in longest]

    @property
    def _body_size(self) -> tuple[int, int]:
        """(width, height) of the cameras' pictures beside each other."""
        widths, heights = zip(*(panel.size for panel in self._panels), strict=True)
        return sum(widths), max(heights)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of a picture without its captions, pixels."""
        width, height = self._body_size
        return width, height * len(self.drawing.tracks)

    def picture(self, instant: Instant) -> ImageArray:
        """Return the picture (height, width, 3) of a frame, with a caption below each result."""
        parts = [
            captions.below(
                self._body(instant, drawn),
                [([*instant.when, *drawn.words, *_angles(drawn)], drawn.mark or TEXT)],
            )
            for captions, drawn in zip(self._captions, instant.estimates, strict=True)
        ]
        return np.vstack(_equally_wide(parts))

    def plain(self, instant: Instant) -> ImageArray:
        """Return what the cameras saw, with the first result's estimate; no caption."""
        return self._body(instant, instant.estimates[0])

    def _body(self, instant: Instant, drawn: DrawnEstimate) -> ImageArray:
        pictures = []
        for panel, image in zip(self._panels, instant.frame.images, strict=True):
            canvas = panel.canvas(image, instant.points)
            if instant.truth is not None:
                seen_from(canvas.camera, instant.truth).outline(canvas, TRUTH)
            seen_from(canvas.camera, drawn).draw(canvas)
            pictures.append(marked(canvas.picture, drawn.mark))
        return np.hstack(_equally_high(pictures))


def image_layout(options: ViewOptions, count: int) -> str:
    """Return how so many tracks are arranged: all layouts are the same.

    Raises:
        UsageError: there are too many, or an option is for depth.
    """
    if count > MOST_RESULTS:
        expected = f"at most {MOST_RESULTS} one below the other"
        raise UsageError("too many results", found=count, expected=expected)
    if options.layout is not None and options.layout not in LAYOUTS:
        found, hint = f"--layout {options.layout}", "it is drawn on the images of its cameras"
        raise UsageError("layout cannot be used", found=found, expected="none", hint=hint)
    if options.range_mm is not None:
        raise UsageError("--range-mm does not apply to images", hint="leave it out")
    return options.layout or LAYOUTS[0]


def _equally_high(pictures: Sequence[ImageArray]) -> list[ImageArray]:
    """Pictures with black below those that are lower than others."""
    height = max(len(picture) for picture in pictures)
    return [np.pad(picture, ((0, height - len(picture)), (0, 0), (0, 0))) for picture in pictures]


def _equally_wide(pictures: Sequence[ImageArray]) -> list[ImageArray]:
    """Pictures with black beside those that are narrower than others."""
    width = max(picture.shape[1] for picture in pictures)
    return [np.pad(picture, ((0, 0), (0, width - picture.shape[1]), (0, 0))) for picture in pictures]


def _longest_angles(drawn: DrawnTrack) -> list[str]:
    return [] if drawn.track.quaternion is None else [f"{name} -180.0" for name in ANGLES]


def _angles(drawn: DrawnEstimate) -> list[str]:
    """The words of a caption about where the subject is turned."""
    if drawn.shown.quaternion is None or drawn.status == "lost":
        return []
    angles = np.degrees(kind_of(drawn.of.track.subject).euler_angles(drawn.shown.quaternion))
    return [f"{name} {angle:+.1f}" for name, angle in zip(ANGLES, angles, strict=True)]
