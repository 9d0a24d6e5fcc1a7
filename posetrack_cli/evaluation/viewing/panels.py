"""Panels of a picture: depth or camera images with estimates and captions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.reading.recording_of import configuration_of, hand_of
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.evaluation.viewing.drawing import (
    LOST,
    TEXT,
    TRUTH,
    Canvas,
    CaptionLine,
    Captions,
    Colour,
    DepthRange,
    Framing,
    SkeletonDrawer,
    Viewport,
    false_colour,
    marked,
)
from posetrack_cli.evaluation.viewing.hand_drawing import HandSegments
from posetrack_cli.evaluation.viewing.layers import (
    MOST_RESULTS,
    Drawing,
    DrawnEstimate,
    DrawnTrack,
    Instant,
    ViewOptions,
    not_lost,
)
from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixel_map
from posetrack_cli.geometry.rotations import canonical, multiply, quaternions_from_matrices
from posetrack_cli.hand.observe.observation import PixelSampler
from posetrack_cli.rendering.port import Window
from posetrack_cli.results.estimate import kind_of
from posetrack_cli.results.reader import Result

# Depth images


DEPTH_LAYOUTS = ("beside", "over", "paper", "segments", "side-by-side")
_DIMMED, _OPACITY = 0.6, 0.8
_BONE: Colour = (255, 255, 255)


class DepthPanels:
    """Draws frames of a depth camera.

    Args:
        camera: camera of the estimates, with lens distortion.
        drawing: content of the pictures.
        depths: range of the false colours.
        layout: one of ``DEPTH_LAYOUTS``.
        skeleton: drawn over each estimate; None for none.
    """

    def __init__(
        self,
        camera: Camera,
        drawing: Drawing,
        depths: DepthRange,
        layout: str = "over",
        skeleton: SkeletonDrawer | None = None,
    ) -> None:
        self.drawing = drawing
        self._camera, self._depths, self._layout, self._skeleton = camera, depths, layout, skeleton
        self._sampler = PixelSampler(
            camera
        )  # undistorts the image, as estimates are drawn without distortion
        self._framing = Framing(
            camera, drawing.around, drawing.scale, still=drawing.still, shrunk=drawing.shrunk
        )
        width, _ = self.size
        tracks = drawing.tracks
        # Side by side, each panel has its own caption; otherwise one caption spans all panels.
        if layout == "side-by-side":
            each = width // len(tracks)
            self._captions = [Captions(self._longest((drawn,)), each) for drawn in tracks]
        else:
            self._captions = [Captions(self._longest(tracks), width)]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of a picture without caption, px."""
        (width, height), count = self._framing.size, len(self.drawing.tracks)
        if self._layout == "paper":
            return width, (1 + count) * height
        across = {"over": 1, "side-by-side": count, "segments": 1 + count}.get(self._layout, 1 + 2 * count)
        return across * width, height

    def picture(self, instant: Instant) -> ImageArray:
        """Return the picture (height, width, 3), BGR, of a frame, with its caption below."""
        scene, estimates = self.scene(instant), instant.estimates
        if self._layout == "side-by-side":
            parts = zip(self._captions, estimates, strict=True)
            return np.hstack(
                [captions.below(scene.over(drawn), scene.lines((drawn,))) for captions, drawn in parts]
            )
        if self._layout == "over":
            panels = [scene.over(*estimates)]
        elif self._layout == "segments":
            panels = [scene.observed, *map(scene.segments, estimates)]
        else:
            panels = [scene.observed]
            for drawn in estimates:
                panels += [scene.rendered(drawn), *([scene.over(drawn)] if self._layout == "beside" else [])]
        body = np.vstack(panels) if self._layout == "paper" else np.hstack(panels)
        return self._captions[0].below(body, scene.lines(estimates))

    def _longest(self, tracks: Sequence[DrawnTrack]) -> list[list[str]]:
        """Return the widest words that captions can have, line by line."""
        words = [drawn.longest_words for drawn in tracks]
        return _caption_lines(self.drawing.longest_when, words, named=bool(tracks[0].name))

    def plain(self, instant: Instant) -> ImageArray:
        """Return the observed depth next to the estimates over it, without caption."""
        scene = self.scene(instant)
        return np.hstack([scene.observed, scene.over(*instant.estimates)])

    def scene(self, instant: Instant) -> DepthScene:
        """Return the scene that the panels of an instant are drawn from."""
        camera, viewport = self._camera, self._framing.viewport(instant.points)
        straight = self._sampler.sample(instant.frame.depth, Window.whole(camera))
        return DepthScene(instant, viewport, camera, false_colour(straight, self._depths), self._skeleton)


@dataclass(frozen=True, eq=False)
class DepthScene:
    """One instant on a depth image; all panels show the same viewport.

    Attributes:
        instant: content of the picture.
        viewport: part of the image to show.
        camera: camera of the whole image.
        whole: undistorted depth image in false colour.
        skeleton: drawn over each estimate; None for none.
    """

    instant: Instant
    viewport: Viewport
    camera: Camera
    whole: ImageArray
    skeleton: SkeletonDrawer | None = None

    @property
    def observed(self) -> ImageArray:
        """Panel with the observed depth."""
        return self.viewport.cut(self.whole)

    def rendered(self, drawn: DrawnEstimate) -> ImageArray:
        """Return the panel with the estimate and the contour of the ground truth on black."""
        width, height = self.viewport.size
        picture = np.zeros((height, width, 3), dtype=np.uint8)
        self._draw(picture, drawn)
        self._outline_truth(picture)
        return marked(picture, drawn.mark)

    def segments(self, drawn: DrawnEstimate) -> ImageArray:
        """Return the panel with the segmentation around an estimate over the depth, and its contour."""
        ground = cv2.convertScaleAbs(self.whole, alpha=_DIMMED)
        if drawn.of.segments is not None:
            drawn.of.segments.paint(ground, self.instant.frame.depth, drawn.shown)
        picture = np.ascontiguousarray(self.viewport.cut(ground))
        drawn.outline(self._canvas(picture), _BONE)
        self._outline_truth(picture)
        return marked(picture, drawn.mark)

    def over(self, *estimates: DrawnEstimate) -> ImageArray:
        """Return the panel with semi-transparent estimates over the depth, and the true contour on top."""
        ground = cv2.convertScaleAbs(self.observed, alpha=_DIMMED)
        painted = ground.copy()
        # of several subjects in one place, the nearest hides the others
        for drawn in sorted(estimates, key=_nearness) if self.instant.is_together else estimates:
            self._draw(painted, drawn)
        picture: ImageArray = cv2.addWeighted(painted, _OPACITY, ground, 1.0 - _OPACITY, 0.0)
        self._outline_truth(picture)
        marks = [drawn.mark for drawn in estimates if drawn.mark is not None]
        return marked(picture, marks[0] if marks else None)

    def lines(self, estimates: Sequence[DrawnEstimate]) -> list[CaptionLine]:
        """Return the caption lines: frame and time, then each estimate."""
        named = bool(estimates[0].of.name)
        lines = _caption_lines(self.instant.when, [drawn.words for drawn in estimates], named=named)
        inks = [self._ink(drawn) for drawn in estimates]
        return list(zip(lines, inks if len(lines) == len(inks) else [TEXT, *inks], strict=True))

    def _canvas(self, picture: ImageArray) -> Canvas:
        return Canvas(picture, self.viewport.camera(self.camera))

    def _draw(self, picture: ImageArray, drawn: DrawnEstimate) -> None:
        canvas = self._canvas(picture)
        drawn.draw(canvas)
        if self.skeleton is not None:
            self.skeleton.draw(canvas, drawn.shown, _BONE)

    def _outline_truth(self, picture: ImageArray) -> None:
        for truth in self.instant.truths:
            truth.outline(self._canvas(picture), TRUTH)

    def _ink(self, drawn: DrawnEstimate) -> Colour:
        return drawn.mark or (drawn.of.colour if len(self.instant.estimates) > 1 else TEXT)


def _nearness(drawn: DrawnEstimate) -> float:
    """Return the sort key of an estimate: the farthest first, and those without points before all others."""
    points = drawn.shown.points
    return -np.inf if points is None else -float(np.mean(points[:, 2]))


def _caption_lines(when: list[str], said: Sequence[list[str]], *, named: bool) -> list[list[str]]:
    """Return the words of each caption line; a single line for one estimate without a name."""
    return [when, *said] if named or len(said) > 1 else [[*when, *said[0]]]


def depth_panels(
    results: Sequence[Result], cameras: Sequence[Camera], drawing: Drawing, options: ViewOptions
) -> DepthPanels:
    """Return the panels that draw results on depth images."""
    (camera,), layout = cameras, depth_layout(options, 1 if drawing.is_together else len(drawing.tracks))
    if drawing.is_together and options.layout is None:
        layout = "over"
    if layout == "segments":
        drawing = _with_segments(drawing, results, camera)
    skeleton = SkeletonDrawer(results[0].subject.point_parents) if options.skeleton else None
    return DepthPanels(camera, drawing, _depth_range(options, drawing.tracks[0].track), layout, skeleton)


def depth_layout(options: ViewOptions, count: int) -> str:
    """Return the layout for a number of tracks.

    Raises:
        UsageError: too many tracks, or too few for the requested layout.
    """
    if count > MOST_RESULTS:
        expected = f"at most {MOST_RESULTS}"
        raise UsageError("too many results", found=count, expected=expected)
    if options.layout == "side-by-side" and count == 1:
        raise UsageError("--layout side-by-side requires two results", found="one")
    return options.layout or ("beside" if count == 1 else "side-by-side")


def _with_segments(drawing: Drawing, results: Sequence[Result], camera: Camera) -> Drawing:
    """Add the segmentation of its run to each track.

    Raises:
        ResultError: a result is not of a hand.
    """
    sources = [result for result in results for _ in range(len(drawing.tracks) // len(results))]
    tracks = tuple(
        replace(drawn, segments=HandSegments(hand_of(result).anatomy, configuration_of(result.run), camera))
        for drawn, result in zip(drawing.tracks, sources, strict=True)
    )
    return replace(drawing, tracks=tracks)


def _depth_range(options: ViewOptions, track: Track) -> DepthRange:
    """Return the depth range, the same for all frames to avoid flicker; by default around the track."""
    if options.range_mm is not None:
        near, far = options.range_mm
        if not 0.0 <= near < far < np.inf:
            found = f"{near:g} {far:g}"
            raise UsageError("invalid --range-mm", found=found, expected="0 <= NEAR < FAR")
        return DepthRange(near, far)
    rows = not_lost(track, np.arange(len(track), dtype=np.int64))
    source = track.points if track.points is not None else track.position
    return DepthRange.of_points(np.empty(0) if source is None else source[rows][..., 2])


# Camera images


NO_IMAGE = 40
"""Grey value of a missing image."""


IMAGE_LAYOUTS = ("beside", "over", "side-by-side")
ANGLES = ("roll", "pitch", "yaw")


class CameraPanel:
    """Prepares the picture of one of several cameras.

    Args:
        camera: camera with extrinsics relative to that of the estimates.
        drawing: content of the pictures.
    """

    def __init__(self, camera: Camera, drawing: Drawing) -> None:
        self._camera = camera
        self._framing = Framing(
            camera, drawing.around, drawing.scale, still=drawing.still, shrunk=drawing.shrunk
        )

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the pictures, px."""
        return self._framing.size

    def canvas(self, image: ImageArray | None, points: FloatArray | None) -> Canvas:
        """Return the picture of an image, to draw on.

        Args:
            image: (h, w) or (h, w, 3) uint8 with lens distortion; None if the camera has no image.
            points: (P, 3) points to crop around if the viewport moves, mm, in the axes of the reference
                camera.
        """
        viewport = self._framing.viewport(points)
        straight = self._straight(image)
        cut = viewport.cut(straight)
        picture = cut.copy() if cut.ndim == 3 else cv2.cvtColor(np.ascontiguousarray(cut), cv2.COLOR_GRAY2BGR)
        return Canvas(picture, viewport.camera(self._camera))

    def _straight(self, image: ImageArray | None) -> ImageArray:
        """Return the undistorted image."""
        if image is None:
            return np.full((self._camera.height, self._camera.width), NO_IMAGE, dtype=np.uint8)
        if not self._camera.is_distorted:
            return image
        u, v = self._map
        return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR))

    @cached_property
    def _map(self) -> tuple[Float32Array, Float32Array]:
        """u and v (h, w) in the distorted image of each pixel of the undistorted image."""
        return pixel_map(replace(self._camera, distortion=()), self._camera)


def seen_from(camera: Camera, drawn: DrawnEstimate) -> DrawnEstimate:
    """Transform an estimate from the axes of the reference camera to those of another camera."""
    shown, turned = drawn.shown, None
    if shown.quaternion is not None:
        rotation = quaternions_from_matrices(np.array(camera.camera_T_reference)[:, :3])
        turned = canonical(multiply(rotation, shown.quaternion))
    position = None if shown.position is None else in_camera_axes(camera, shown.position)
    points = None if shown.points is None else in_camera_axes(camera, shown.points)
    return replace(drawn, shown=replace(shown, position=position, quaternion=turned, points=points))


class ImagePanels:
    """Draws frames of cameras: one column per camera, one row per track.

    Args:
        cameras: cameras of the images.
        drawing: content of the pictures.
    """

    def __init__(self, cameras: Sequence[Camera], drawing: Drawing) -> None:
        self.drawing = drawing
        self._panels = [CameraPanel(camera, drawing) for camera in cameras]
        width, when = self._body_size[0], drawing.longest_when
        longest = [[*drawn.longest_words, *_longest_angles(drawn)] for drawn in drawing.tracks]
        if drawing.is_together:
            self._captions = [Captions([when, *longest], width)]
        else:
            self._captions = [Captions([[*when, *words]], width) for words in longest]

    @property
    def _body_size(self) -> tuple[int, int]:
        """(width, height) of a row of pictures, px."""
        widths, heights = zip(*(panel.size for panel in self._panels), strict=True)
        return sum(widths), max(heights)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of a picture without captions, px."""
        width, height = self._body_size
        return width, height * len(self._captions)

    def picture(self, instant: Instant) -> ImageArray:
        """Return the picture (height, width, 3), BGR, of a frame, with a caption below each track."""
        if self.drawing.is_together:
            lines = [
                (instant.when, TEXT),
                *(([*one.words, *_angles(one)], one.of.colour) for one in instant.estimates),
            ]
            return self._captions[0].below(self._body(instant, instant.estimates), lines)
        parts = [
            captions.below(
                self._body(instant, [drawn]),
                [([*instant.when, *drawn.words, *_angles(drawn)], drawn.mark or TEXT)],
            )
            for captions, drawn in zip(self._captions, instant.estimates, strict=True)
        ]
        return np.vstack(_equally_wide(parts))

    def plain(self, instant: Instant) -> ImageArray:
        """Return the images with the estimate of the first track, without caption."""
        return self._body(instant, instant.estimates[:1])

    def _body(self, instant: Instant, drawn: Sequence[DrawnEstimate]) -> ImageArray:
        pictures = []
        for panel, image in zip(self._panels, instant.frame.images, strict=True):
            canvas = panel.canvas(image, instant.points)
            # Ground truth first: its wide lines remain visible around the estimate.
            for truth in instant.truths:
                seen_from(canvas.camera, truth).outline(canvas, TRUTH)
            for one in drawn:
                if len(drawn) == 1 or one.mark != LOST:  # a lost head would hide the others
                    seen_from(canvas.camera, one).draw(canvas)
            pictures.append(marked(canvas.picture, drawn[0].mark if len(drawn) == 1 else None))
        return np.hstack(_equally_high(pictures))


def image_layout(options: ViewOptions, count: int) -> str:
    """Return the layout for a number of tracks; all layouts for camera images are equivalent.

    Raises:
        UsageError: too many tracks, or an option for depth images.
    """
    if count > MOST_RESULTS:
        expected = f"at most {MOST_RESULTS}"
        raise UsageError("too many results", found=count, expected=expected)
    if options.layout is not None and options.layout not in IMAGE_LAYOUTS:
        raise UsageError(f"--layout {options.layout} requires depth images", hint="omit --layout")
    if options.range_mm is not None:
        raise UsageError("--range-mm requires depth images", hint="omit --range-mm")
    return options.layout or IMAGE_LAYOUTS[0]


def _equally_high(pictures: Sequence[ImageArray]) -> list[ImageArray]:
    """Pad pictures at the bottom to equal height."""
    height = max(len(picture) for picture in pictures)
    return [np.pad(picture, ((0, height - len(picture)), (0, 0), (0, 0))) for picture in pictures]


def _equally_wide(pictures: Sequence[ImageArray]) -> list[ImageArray]:
    """Pad pictures on the right to equal width."""
    width = max(picture.shape[1] for picture in pictures)
    return [np.pad(picture, ((0, 0), (0, width - picture.shape[1]), (0, 0))) for picture in pictures]


def _longest_angles(drawn: DrawnTrack) -> list[str]:
    return [] if drawn.track.quaternion is None else [f"{name} -180.0" for name in ANGLES]


def _angles(drawn: DrawnEstimate) -> list[str]:
    """Return the words of a caption about the rotation."""
    if drawn.shown.quaternion is None or drawn.status == "lost":
        return []
    angles = np.degrees(kind_of(drawn.of.track.subject).euler_angles(drawn.shown.quaternion))
    return [f"{name} {angle:+.1f}" for name, angle in zip(ANGLES, angles, strict=True)]
