"""A picture of one instant of a head: every camera's image with the estimates on it, and a caption."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.evaluation.viewing.camera_panel import CameraPanel, seen_from
from posetrack_cli.evaluation.viewing.captions import caption
from posetrack_cli.evaluation.viewing.colours import TEXT, TRUTH
from posetrack_cli.evaluation.viewing.drawing import SkeletonDrawer
from posetrack_cli.evaluation.viewing.layers import Layer
from posetrack_cli.evaluation.viewing.panels import marked
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.euler import head_roll_pitch_yaw
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.reader import Result
from posetrack_cli.units import NS_PER_S

ANGLES = ("roll", "pitch", "yaw")


class HeadPanels:
    """Draws frames: cameras beside each other, results one below the other.

    Args:
        cameras: of the images.
        layers: the results; captions count the time from the first one's first frame.
        truth: drawn over the results, None for none.
        around: (N, P, 3) mm, in the axes of the first camera, that pictures are cut out around; None for all
            of the image.
        scale: picture pixels per image pixel; None enlarges small pictures.
        still: whether all pictures show the same part.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        layers: Sequence[Layer],
        truth: Layer | None,
        *,
        around: FloatArray | None = None,
        scale: float | None = None,
        still: bool = True,
    ) -> None:
        self._panels = [CameraPanel(camera, around, scale, still=still) for camera in cameras]
        self._layers, self._truth = tuple(layers), truth
        self._start_ns = int(layers[0].track.stamp_ns[0])

    def picture(self, frame: Frame, stamp_ns: int, points: FloatArray | None) -> ImageArray:
        """Return the picture (height, width, 3) of a frame, with a caption below each result.

        Args:
            frame: the images.
            stamp_ns: of the estimates.
            points: (P, 3) mm that it is cut out around, where the part that is shown moves.
        """
        parts = []
        for layer in self._layers:
            body = self.body(frame, stamp_ns, points, layer)
            parts += [body, self._caption(frame, stamp_ns, layer, body.shape[1])]
        return np.vstack(parts)

    def body(self, frame: Frame, stamp_ns: int, points: FloatArray | None, layer: Layer) -> ImageArray:
        """Return what the cameras saw, with one result's estimate; no caption."""
        pictures = []
        for panel, image in zip(self._panels, frame.images, strict=True):
            picture, camera = panel.picture(image, points)
            panel.draw(picture, camera, stamp_ns, [layer])
            if self._truth is not None:
                shown = seen_from(camera, self._truth.shown(stamp_ns))
                self._truth.drawer.outline(picture, camera, shown, TRUTH)
            pictures.append(marked(picture, layer.mark(stamp_ns)))
        return np.hstack(_equally_high(pictures))

    def _caption(self, frame: Frame, stamp_ns: int, layer: Layer, width: int) -> ImageArray:
        seconds = (stamp_ns - self._start_ns) / NS_PER_S
        words = [
            f"frame {frame.index}",
            f"{seconds:.3f} s",
            *layer.words(stamp_ns),
            *_angles(layer, stamp_ns),
        ]
        return caption([(words, layer.mark(stamp_ns) or TEXT)], width)


def drawer_of_head(result: Result) -> SkeletonDrawer:
    """Return what draws the head of a result: points, lines between them, axes."""
    return SkeletonDrawer(result.subject.point_parents, lines=result.subject.lines)


def _equally_high(pictures: Sequence[ImageArray]) -> list[ImageArray]:
    """Pictures with black below those that are lower than others."""
    height = max(len(picture) for picture in pictures)
    return [np.pad(picture, ((0, height - len(picture)), (0, 0), (0, 0))) for picture in pictures]


def _angles(layer: Layer, stamp_ns: int) -> list[str]:
    """The words of a caption about where the head looks."""
    quaternion = layer.shown(stamp_ns).quaternion
    if quaternion is None or layer.status(stamp_ns) == "lost":
        return []
    angles = np.degrees(head_roll_pitch_yaw(quaternion))
    return [f"{name} {angle:+.1f}" for name, angle in zip(ANGLES, angles, strict=True)]
