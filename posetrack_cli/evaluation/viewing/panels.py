"""The panels of a picture (observed, rendered, over) and how they are put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.evaluation.viewing.captions import caption
from posetrack_cli.evaluation.viewing.colours import TEXT, TRUTH, Colour, DepthRange, false_colour
from posetrack_cli.evaluation.viewing.drawing import SkeletonDrawer
from posetrack_cli.evaluation.viewing.layers import Layer
from posetrack_cli.evaluation.viewing.viewport import Viewport
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.observation import PixelSampler
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.window import Window
from posetrack_cli.units import NS_PER_S

LAYOUTS = ("beside", "over", "paper", "segments", "side-by-side")
_DIMMED, _OPACITY = 0.6, 0.8
_BONE: Colour = (255, 255, 255)
_BORDER_PX = 4
_ROOM_PX = 420
"""From this width on, one result's caption is one line."""


@dataclass(frozen=True, eq=False)
class Panels:
    """Draws frames.

    Attributes:
        camera: that the estimates are relative to, lens distortion included.
        sampler: takes the distortion out of images: what is drawn comes from a pinhole camera.
        depths: that get colours.
        layers: the results.
        truth: drawn as a contour over the results, None for none.
        skeleton: drawn over every estimate, None for none.
        start_ns: stamp from which captions count the time.
    """

    camera: Camera
    sampler: PixelSampler
    depths: DepthRange
    layers: tuple[Layer, ...]
    truth: Layer | None
    skeleton: SkeletonDrawer | None
    start_ns: int

    def picture(self, frame: Frame, layout: str, viewport: Viewport) -> ImageArray:
        """A frame in one of ``LAYOUTS``, (height, width, 3) blue green red, with its caption below."""
        if layout == "side-by-side":
            return np.hstack([self._alone(frame, viewport, layer) for layer in self.layers])
        panels = self._panels(frame, layout, viewport)
        body = np.vstack(panels) if layout == "paper" else np.hstack(panels)
        return np.vstack([body, self._caption(frame, self.layers, body.shape[1])])

    def pair(self, frame: Frame, viewport: Viewport) -> ImageArray:
        """Observed depth and, right of it, the estimates over it; no caption."""
        observed = self.observed(frame, viewport)
        return np.hstack([observed, self.over(observed, frame.stamp_ns, viewport, self.layers)])

    def _panels(self, frame: Frame, layout: str, viewport: Viewport) -> list[ImageArray]:
        observed = self.observed(frame, viewport)
        if layout == "over":
            return [self.over(observed, frame.stamp_ns, viewport, self.layers)]
        panels = [observed]
        if layout == "segments":
            return [observed, *(self.segments(frame, viewport, layer) for layer in self.layers)]
        for layer in self.layers:
            panels.append(self.rendered(frame.stamp_ns, viewport, layer))
            if layout == "beside":
                panels.append(self.over(observed, frame.stamp_ns, viewport, (layer,)))
        return panels

    def _alone(self, frame: Frame, viewport: Viewport, layer: Layer) -> ImageArray:
        """One of several results, with a caption of its own."""
        panel = self.over(self.observed(frame, viewport), frame.stamp_ns, viewport, (layer,))
        return np.vstack([panel, self._caption(frame, (layer,), panel.shape[1])])

    def observed(self, frame: Frame, viewport: Viewport) -> ImageArray:
        """The frame's depth in false colour, without lens distortion."""
        straight = self.sampler.sample(frame.depth, Window.whole(self.camera))
        return false_colour(viewport.cut(straight), self.depths)

    def rendered(self, stamp_ns: int, viewport: Viewport, layer: Layer) -> ImageArray:
        """The estimate alone."""
        width, height = viewport.size
        picture = np.zeros((height, width, 3), dtype=np.uint8)
        self._draw(picture, stamp_ns, viewport, layer)
        return marked(picture, layer.mark(stamp_ns))

    def segments(self, frame: Frame, viewport: Viewport, layer: Layer) -> ImageArray:
        """What segmentation around an estimate tells apart, over the observed depth, with the contour."""
        whole = self.observed(frame, Viewport.whole(self.camera))
        ground = cv2.convertScaleAbs(whole, alpha=_DIMMED)
        shown = layer.shown(frame.stamp_ns)
        if layer.segments is not None:
            layer.segments.paint(ground, frame.depth, shown)
        picture = np.ascontiguousarray(viewport.cut(ground))
        layer.drawer.outline(picture, viewport.camera(self.camera), shown, _BONE)
        return marked(picture, layer.mark(frame.stamp_ns))

    def over(
        self, observed: ImageArray, stamp_ns: int, viewport: Viewport, layers: Sequence[Layer]
    ) -> ImageArray:
        """Estimates over the observed depth, which shines through; the truth's contour on top."""
        ground = cv2.convertScaleAbs(observed, alpha=_DIMMED)
        painted = ground.copy()
        for layer in layers:
            self._draw(painted, stamp_ns, viewport, layer)
        picture: ImageArray = cv2.addWeighted(painted, _OPACITY, ground, 1.0 - _OPACITY, 0.0)
        if self.truth is not None:
            camera, shown = viewport.camera(self.camera), self.truth.shown(stamp_ns)
            self.truth.drawer.outline(picture, camera, shown, TRUTH)
        marks = [mark for mark in (layer.mark(stamp_ns) for layer in layers) if mark is not None]
        return marked(picture, marks[0] if marks else None)

    def _draw(self, picture: ImageArray, stamp_ns: int, viewport: Viewport, layer: Layer) -> None:
        camera, shown = viewport.camera(self.camera), layer.shown(stamp_ns)
        layer.drawer.draw(picture, camera, shown, layer.colour)
        if self.skeleton is not None:
            self.skeleton.draw(picture, camera, shown, _BONE)

    def _caption(self, frame: Frame, layers: Sequence[Layer], width: int) -> ImageArray:
        """Frame and time, then what is said of each result; on lines of their own where there is no room."""
        when = [f"frame {frame.index}", f"{(frame.stamp_ns - self.start_ns) / NS_PER_S:.3f} s"]
        said = [(layer.words(frame.stamp_ns), self._ink(layer, frame.stamp_ns)) for layer in layers]
        words, ink = said[0]
        if len(said) == 1 and width >= _ROOM_PX and not layers[0].name:
            return caption([([*when, *words], ink)], width)
        return caption([(when, TEXT), *said], width)

    def _ink(self, layer: Layer, stamp_ns: int) -> Colour:
        mark = layer.mark(stamp_ns)
        if mark is not None:
            return mark
        return layer.colour if len(self.layers) > 1 else TEXT


def marked(picture: ImageArray, mark: Colour | None) -> ImageArray:
    """The picture in a frame of this colour, for frames that are lost or found anew."""
    if mark is not None:
        height, width = picture.shape[:2]
        cv2.rectangle(picture, (0, 0), (width - 1, height - 1), mark, 2 * _BORDER_PX - 1)
    return picture
