"""Pictures of one instant on a depth image: observed, rendered, over, and how they are put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.track import Track
from posetrack_cli.evaluation.viewing.captions import caption
from posetrack_cli.evaluation.viewing.colours import TEXT, TRUTH, Colour, DepthRange, false_colour
from posetrack_cli.evaluation.viewing.drawing import SkeletonDrawer
from posetrack_cli.evaluation.viewing.hand_drawing import hand_segments
from posetrack_cli.evaluation.viewing.layers import MOST_RESULTS, Drawing, DrawnTrack, ViewOptions, not_lost
from posetrack_cli.evaluation.viewing.viewport import Framing, Viewport
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.observation import PixelSampler
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.window import Window
from posetrack_cli.results.reader import Result

LAYOUTS = ("beside", "over", "paper", "segments", "side-by-side")
_DIMMED, _OPACITY = 0.6, 0.8
_BONE: Colour = (255, 255, 255)
_BORDER_PX = 4
_ROOM_PX = 420
"""From this width on, one result's caption is one line."""


class DepthPanels:
    """Draws frames.

    Args:
        camera: that the estimates are relative to, lens distortion included.
        drawing: what is shown.
        depths: that get colours.
        layout: one of ``LAYOUTS``.
        skeleton: drawn over every estimate, None for none.
    """

    def __init__(
        self,
        camera: Camera,
        drawing: Drawing,
        depths: DepthRange,
        layout: str = "over",
        skeleton: SkeletonDrawer | None = None,
    ) -> None:
        self.camera, self.drawing, self._depths = camera, drawing, depths
        self._layout, self._skeleton = layout, skeleton
        self._sampler = PixelSampler(camera)  # what is drawn comes from a pinhole camera
        self._framing = Framing(camera, drawing.around, drawing.scale, still=drawing.still)

    def picture(self, frame: Frame, stamp_ns: int, points: FloatArray | None) -> ImageArray:
        """Return the picture (height, width, 3), blue green red, of a frame, with its caption below.

        Args:
            frame: the depth image.
            stamp_ns: of the estimates.
            points: (P, 3) mm that it is cut out around, where the part that is shown moves.
        """
        viewport, tracks = self._framing.viewport(points), self.drawing.tracks
        if self._layout == "side-by-side":
            return np.hstack([self._alone(frame, stamp_ns, viewport, drawn) for drawn in tracks])
        panels = self._panels(frame, stamp_ns, viewport)
        body = np.vstack(panels) if self._layout == "paper" else np.hstack(panels)
        return np.vstack([body, self._caption(frame, stamp_ns, tracks, body.shape[1])])

    def plain(self, frame: Frame, stamp_ns: int, points: FloatArray | None) -> ImageArray:
        """Return observed depth and, right of it, the estimates over it; no caption."""
        viewport = self._framing.viewport(points)
        observed = self.observed(frame, viewport)
        return np.hstack([observed, self.over(observed, stamp_ns, viewport, self.drawing.tracks)])

    def _panels(self, frame: Frame, stamp_ns: int, viewport: Viewport) -> list[ImageArray]:
        observed, tracks = self.observed(frame, viewport), self.drawing.tracks
        if self._layout == "over":
            return [self.over(observed, stamp_ns, viewport, tracks)]
        if self._layout == "segments":
            return [observed, *(self.segments(frame, stamp_ns, viewport, drawn) for drawn in tracks)]
        panels = [observed]
        for drawn in tracks:
            panels.append(self.rendered(stamp_ns, viewport, drawn))
            if self._layout == "beside":
                panels.append(self.over(observed, stamp_ns, viewport, (drawn,)))
        return panels

    def _alone(self, frame: Frame, stamp_ns: int, viewport: Viewport, drawn: DrawnTrack) -> ImageArray:
        """One of several results, with a caption of its own."""
        panel = self.over(self.observed(frame, viewport), stamp_ns, viewport, (drawn,))
        return np.vstack([panel, self._caption(frame, stamp_ns, (drawn,), panel.shape[1])])

    def observed(self, frame: Frame, viewport: Viewport) -> ImageArray:
        """The frame's depth in false colour, without lens distortion."""
        straight = self._sampler.sample(frame.depth, Window.whole(self.camera))
        return false_colour(viewport.cut(straight), self._depths)

    def rendered(self, stamp_ns: int, viewport: Viewport, drawn: DrawnTrack) -> ImageArray:
        """The estimate alone."""
        width, height = viewport.size
        picture = np.zeros((height, width, 3), dtype=np.uint8)
        self._draw(picture, stamp_ns, viewport, drawn)
        return marked(picture, drawn.mark(stamp_ns))

    def segments(self, frame: Frame, stamp_ns: int, viewport: Viewport, drawn: DrawnTrack) -> ImageArray:
        """What segmentation around an estimate tells apart, over the observed depth, with the contour."""
        whole = self.observed(frame, Viewport.whole(self.camera))
        ground = cv2.convertScaleAbs(whole, alpha=_DIMMED)
        shown = drawn.shown(stamp_ns)
        if drawn.segments is not None:
            drawn.segments.paint(ground, frame.depth, shown)
        picture = np.ascontiguousarray(viewport.cut(ground))
        drawn.drawer.outline(picture, viewport.camera(self.camera), shown, _BONE)
        return marked(picture, drawn.mark(stamp_ns))

    def over(
        self, observed: ImageArray, stamp_ns: int, viewport: Viewport, tracks: Sequence[DrawnTrack]
    ) -> ImageArray:
        """Estimates over the observed depth, which shines through; the truth's contour on top."""
        ground = cv2.convertScaleAbs(observed, alpha=_DIMMED)
        painted = ground.copy()
        for drawn in tracks:
            self._draw(painted, stamp_ns, viewport, drawn)
        picture: ImageArray = cv2.addWeighted(painted, _OPACITY, ground, 1.0 - _OPACITY, 0.0)
        if self.drawing.truth is not None:
            camera, shown = viewport.camera(self.camera), self.drawing.truth.shown(stamp_ns)
            self.drawing.truth.drawer.outline(picture, camera, shown, TRUTH)
        marks = [mark for mark in (drawn.mark(stamp_ns) for drawn in tracks) if mark is not None]
        return marked(picture, marks[0] if marks else None)

    def _draw(self, picture: ImageArray, stamp_ns: int, viewport: Viewport, drawn: DrawnTrack) -> None:
        camera, shown = viewport.camera(self.camera), drawn.shown(stamp_ns)
        drawn.drawer.draw(picture, camera, shown, drawn.colour)
        if self._skeleton is not None:
            self._skeleton.draw(picture, camera, shown, _BONE)

    def _caption(self, frame: Frame, stamp_ns: int, tracks: Sequence[DrawnTrack], width: int) -> ImageArray:
        """Frame and time, then what is said of each result; on lines of their own where there is no room."""
        when = self.drawing.when(frame.index, stamp_ns)
        said = [(drawn.words(stamp_ns), self._ink(drawn, stamp_ns)) for drawn in tracks]
        words, ink = said[0]
        if len(said) == 1 and width >= _ROOM_PX and not tracks[0].name:
            return caption([([*when, *words], ink)], width)
        return caption([(when, TEXT), *said], width)

    def _ink(self, drawn: DrawnTrack, stamp_ns: int) -> Colour:
        mark = drawn.mark(stamp_ns)
        if mark is not None:
            return mark
        return drawn.colour if len(self.drawing.tracks) > 1 else TEXT


def depth_panels(
    results: Sequence[Result], cameras: Sequence[Camera], drawing: Drawing, options: ViewOptions
) -> DepthPanels:
    """Return what draws results on the depth images of a camera."""
    (camera,), layout = cameras, depth_layout(options, len(drawing.tracks))
    if layout == "segments":
        drawing = _with_segments(drawing, results, camera)
    skeleton = SkeletonDrawer(results[0].subject.point_parents) if options.skeleton else None
    return DepthPanels(camera, drawing, _depth_range(options, drawing.tracks[0].track), layout, skeleton)


def depth_layout(options: ViewOptions, count: int) -> str:
    """Return how so many tracks are arranged.

    Raises:
        UsageError: there are too many, or too few for the layout that is asked for.
    """
    if count > MOST_RESULTS:
        expected = f"at most {MOST_RESULTS} beside each other"
        raise UsageError("too many results", found=count, expected=expected)
    if options.layout == "side-by-side" and count == 1:
        raise UsageError("--layout side-by-side needs two results", found="one")
    return options.layout or ("beside" if count == 1 else "side-by-side")


def _with_segments(drawing: Drawing, results: Sequence[Result], camera: Camera) -> Drawing:
    """The tracks, each with what tells the subject's pixels as its own run does."""
    sources = [result for result in results for _ in range(len(drawing.tracks) // len(results))]
    tracks = tuple(
        replace(drawn, segments=hand_segments(result, camera))
        for drawn, result in zip(drawing.tracks, sources, strict=True)
    )
    return replace(drawing, tracks=tracks)


def _depth_range(options: ViewOptions, track: Track) -> DepthRange:
    """The same colours for all frames, so that they do not flicker: by default around where a track goes."""
    if options.range_mm is not None:
        near, far = options.range_mm
        if not 0.0 <= near < far < np.inf:
            found = f"{near:g} {far:g}"
            raise UsageError("--range-mm cannot be used", found=found, expected="0 <= NEAR < FAR")
        return DepthRange(near, far)
    rows = not_lost(track, np.arange(len(track), dtype=np.int64))
    source = track.points if track.points is not None else track.position
    return DepthRange.of_points(np.empty(0) if source is None else source[rows][..., 2])


def marked(picture: ImageArray, mark: Colour | None) -> ImageArray:
    """The picture in a frame of this colour, for frames that are lost or found anew."""
    if mark is not None:
        height, width = picture.shape[:2]
        cv2.rectangle(picture, (0, 0), (width - 1, height - 1), mark, 2 * _BORDER_PX - 1)
    return picture
