"""Rendering of one or two results onto the frames of their recording."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.reading.recording_of import cameras_of, hand_of, pixels_of
from posetrack_cli.evaluation.reading.tracks import matched_frames
from posetrack_cli.evaluation.viewing.drawing import TRUTH, Drawer, SkeletonDrawer
from posetrack_cli.evaluation.viewing.frame_choice import fewer_said
from posetrack_cli.evaluation.viewing.hand_drawing import HandDrawer
from posetrack_cli.evaluation.viewing.head_drawing import HeadDrawer
from posetrack_cli.evaluation.viewing.layers import (
    Drawing,
    DrawnTrack,
    Instant,
    ViewOptions,
    drawn_tracks,
    is_together,
    not_lost,
    rate_of,
    rows_to_draw,
    truths_of,
)
from posetrack_cli.evaluation.viewing.outputs import fitting_sheet
from posetrack_cli.evaluation.viewing.panels import ImagePanels, depth_layout, depth_panels, image_layout
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.subject import HEAD
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.recording.pixels import PixelKind
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.reader import Result, read_result

OpenDevice: TypeAlias = Callable[[], RenderingDevice]
DrawerOf: TypeAlias = Callable[[Result, OpenDevice], Drawer]

DRAWERS: Mapping[str, DrawerOf] = {"hand": lambda result, device: HandDrawer(device(), hand_of(result))}
"""Drawers by subject name; for other subjects, points, lines and axes are drawn."""


class Panels(Protocol):
    """Draws frames as pictures of equal size.

    Attributes:
        drawing: content of the pictures.
    """

    drawing: Drawing

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of a picture without caption, px."""

    def picture(self, instant: Instant) -> ImageArray:
        """Return the picture (height, width, 3), BGR, of a frame, with its caption below."""

    def plain(self, instant: Instant) -> ImageArray:
        """Return the picture of a frame without caption, for reports."""


@dataclass(frozen=True)
class _Style:
    """Layout and panels for one kind of images."""

    layout: Callable[[ViewOptions, int], str]
    panels: Callable[[Sequence[Result], Sequence[Camera], Drawing, ViewOptions], Panels]


_STYLES: Mapping[PixelKind, _Style] = {
    "depth": _Style(depth_layout, depth_panels),
    "grey": _Style(image_layout, lambda results, cameras, drawing, options: ImagePanels(cameras, drawing)),
}


class ResultView:
    """Draws selected frames in recording order.

    Args:
        results: one result, two of the same recording and kind of subject, or parts of one file.
        recording: recording of the results.
        options: view options.
        device: opens the rendering device; called only if needed.

    Raises:
        UsageError: invalid options, or no frame to draw.
        ResultError: a result cannot be drawn, or has no ground truth although it is requested.

    Attributes:
        rows: rows of the first result that are drawn.
        remark: reason why fewer frames than requested are drawn; empty otherwise.
    """

    def __init__(
        self, results: Sequence[Result], recording: Recording, options: ViewOptions, device: OpenDevice
    ) -> None:
        self._recording, self._log = recording, LossLog()
        style, together = style_of(results), is_together(results)
        if together and len(options.tracks) > 1:
            raise UsageError(
                "both tracks of several subjects", where=results[0].path, hint="choose a subject with --of"
            )
        layout = style.layout(options, 1 if together else len(results) * len(options.tracks))
        labels = [result.subject.label for result in (results if together else results[:1])]
        truths = truths_of(read_result(results[0].path), labels, options)
        tracks = drawn_tracks(results, options.tracks, truths, lambda result: drawer_of(result, device))
        self._tracks = tracks if together else tracks[:1]
        self._track = tracks[0].track
        self.rows = rows_to_draw(options, tracks[0])
        self.remark = fewer_said(options.frames or "", len(self.rows))
        drawing = Drawing(
            tracks,
            tuple(
                DrawnTrack(truth, drawn.drawer, TRUTH)
                for truth, drawn in zip(truths, tracks, strict=False)
                if options.truth and truth is not None
            ),
            around=self._around(options, layout),
            scale=options.scale,
            still=not options.sheet,
            is_together=together,
        )
        cameras = _common_cameras(results, recording)
        self._panels = style.panels(results, cameras, drawing, options)
        # The size of the panels is only known once they exist, so they are created again if they must shrink.
        if options.sheet and options.scale is None:
            shrunk = fitting_sheet(len(self.rows), self._panels.size)
            if shrunk < 1.0:
                self._panels = style.panels(results, cameras, replace(drawing, shrunk=shrunk), options)

    @property
    def rate_hz(self) -> float:
        """Rate of the pictures for playback in real time, Hz."""
        return rate_of(self._track, self.rows)

    @property
    def recording_path(self) -> Path:
        """Path of the recording."""
        return self._recording.path

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Selected frames that could not be drawn; complete once ``pictures`` is exhausted."""
        return self._log.losses

    def pictures(self) -> Generator[tuple[int, ImageArray]]:
        """Yield (frame number, picture); all pictures have the same size."""
        track, self._log = self._track, LossLog()
        numbers = None if track.frame_index is None else track.frame_index[self.rows]
        stamps = track.stamp_ns[self.rows]
        for position, frame in matched_frames(self._recording, stamps, numbers, self._log):
            yield frame.index, self._panels.picture(self._panels.drawing.at(frame, int(stamps[position])))

    def _around(self, options: ViewOptions, layout: str) -> FloatArray | None:
        """Return the points that the pictures are cropped around; None for the whole image."""
        is_whole = options.crop == "full" or (options.crop is None and layout != "paper")
        if is_whole or any(drawn.track.points is None for drawn in self._tracks):
            return None
        of_each = [
            one.track.points[not_lost(one.track, self.rows)]
            for one in self._tracks
            if one.track.points is not None
        ]
        return (
            np.concatenate([points.reshape(-1, 1, 3) for points in of_each])
            if len(of_each) > 1
            else of_each[0]
        )


def style_of(results: Sequence[Result]) -> _Style:
    """Return the drawing style for the kind of images of the results.

    Raises:
        UsageError: the results have different kinds of images.
    """
    pixels = {pixels_of(result) for result in results}
    if len(pixels) > 1:
        found = ", ".join(f"a {result.subject.name} in {result.path}" for result in results)
        raise UsageError("results have different subjects", found=found)
    return _STYLES[pixels.pop()]


def report_panels(result: Result, recording: Recording, drawing: Drawing) -> Panels:
    """Return the panels that draw a result for a report.

    Raises:
        UsageError: the image size of the recording differs from the result.
    """
    return style_of([result]).panels([result], cameras_of(result, recording), drawing, ViewOptions())


def drawer_of(result: Result, device: OpenDevice) -> Drawer:
    """Return the drawer for the subject of a result."""
    if result.subject.name in DRAWERS:
        return DRAWERS[result.subject.name](result, device)
    subject = result.subject
    skeleton = SkeletonDrawer(subject.point_parents, lines=subject.lines)
    return HeadDrawer(skeleton, subject.number_names) if subject.name == HEAD else skeleton


def _common_cameras(results: Sequence[Result], recording: Recording) -> tuple[Camera, ...]:
    """Return the cameras that all results have in common."""
    cameras = cameras_of(results[0], recording)
    for other in results[1:]:
        # Camera names can differ, for example with another camera file.
        if _unnamed(other.cameras()) != _unnamed(cameras):
            raise UsageError("results have different cameras", found=f"{results[0].path} and {other.path}")
    return cameras


def _unnamed(cameras: Sequence[Camera]) -> list[Camera]:
    return [replace(camera, name="") for camera in cameras]
