"""Pictures of one result, or of two beside each other, on the recording they were made from."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.matched_frames import matched_frames
from posetrack_cli.evaluation.recorded_hand import hand_of
from posetrack_cli.evaluation.recording_of import cameras_of
from posetrack_cli.evaluation.track import Track
from posetrack_cli.evaluation.viewing.colours import TRUTH, DepthRange
from posetrack_cli.evaluation.viewing.drawing import Drawer, SkeletonDrawer
from posetrack_cli.evaluation.viewing.hand_drawing import HandDrawer
from posetrack_cli.evaluation.viewing.layering import (
    MOST_RESULTS,
    ViewOptions,
    layers_of,
    not_lost,
    rate_of,
    rows_to_draw,
    truth_of,
)
from posetrack_cli.evaluation.viewing.layers import Layer
from posetrack_cli.evaluation.viewing.panels import Panels
from posetrack_cli.evaluation.viewing.segments import HandSegments, configuration_of
from posetrack_cli.evaluation.viewing.viewport import Viewport, around_points, largest_viewport, moved_to
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.observation import PixelSampler
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.reader import Result


class View:
    """Draws the chosen frames, one after the other, in the recording's order.

    Args:
        results: one, or two of the same recording.
        recording: what they were made from.
        options: how.
        device: draws the hands.

    Raises:
        UsageError: options that cannot be meant, or no frame to draw.
        ResultError: a result that cannot be drawn, or without truth where truth is asked for.
    """

    def __init__(
        self,
        results: Sequence[Result],
        recording: Recording,
        options: ViewOptions,
        device: RenderingDevice,
    ) -> None:
        self._recording, self._options, self._log = recording, options, LossLog()
        self.layout = _layout(options, len(results) * len(options.tracks))
        truth = truth_of(results[0], options)
        layers = layers_of(results, options.tracks, truth, lambda result: drawer_of(result, device))
        self._track = layers[0].track
        self.rows = rows_to_draw(options, layers[0])
        self._camera = _common_camera(results, recording)
        if self.layout == "segments":
            layers = _with_segments(layers, results, options.tracks, self._camera)
        self._panels = Panels(
            camera=self._camera,
            sampler=PixelSampler(self._camera),
            depths=_depth_range(options, self._track),
            layers=layers,
            truth=Layer(truth, layers[0].drawer, TRUTH) if options.truth and truth is not None else None,
            skeleton=SkeletonDrawer(results[0].subject.point_parents) if options.skeleton else None,
            start_ns=int(self._track.stamp_ns[0]),
        )

    @property
    def rate_hz(self) -> float:
        """Pictures per second that show the chosen frames as fast as they were recorded."""
        return rate_of(self._track, self.rows)

    @property
    def recording_path(self) -> Path:
        """Where the frames come from."""
        return self._recording.path

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Chosen frames that could not be drawn, once all were asked for."""
        return self._log.losses

    def pictures(self) -> Generator[tuple[int, ImageArray]]:
        """Yield (frame number, picture), all pictures of one size."""
        track, self._log = self._track, LossLog()
        numbers = None if track.frame_index is None else track.frame_index[self.rows]
        stamps = track.stamp_ns[self.rows]
        for position, frame in matched_frames(self._recording, stamps, numbers, self._log):
            viewport = self._viewport(int(self.rows[position]))
            yield frame.index, self._panels.picture(frame, self.layout, viewport)

    def _viewport(self, row: int) -> Viewport:
        """All frames of a video show the same part of the image, those of a sheet the same size of it."""
        points = self._track.points
        if not self._options.sheet or points is None or self._is_whole:
            return self._common_viewport
        return moved_to(self._common_viewport, points[row], self._camera)

    @property
    def _is_whole(self) -> bool:
        crop = self._options.crop or ("hand" if self.layout == "paper" else "full")
        return crop == "full" or self._track.points is None

    @cached_property
    def _common_viewport(self) -> Viewport:
        points, scale = self._track.points, self._options.scale
        if self._is_whole or points is None:
            return Viewport.enlarged(self._camera, scale)
        shown = not_lost(self._track, self.rows)
        if self._options.sheet:
            return largest_viewport(points[shown], self._camera, scale)
        return around_points(points[shown], self._camera, scale)


def drawer_of(result: Result, device: RenderingDevice) -> Drawer:
    """What draws the subject of a result: a hand's skin; of any other its points, bones and axes."""
    if result.subject.name == "hand":
        return HandDrawer(device, hand_of(result))
    return SkeletonDrawer(result.subject.point_parents, lines=result.subject.lines)


def _common_camera(results: Sequence[Result], recording: Recording) -> Camera:
    """The camera that all estimates are relative to."""
    camera = cameras_of(results[0], recording)[0]
    for other in results[1:]:
        if replace(other.camera(), name=camera.name) != camera:
            raise UsageError("results have different cameras", found=f"{results[0].path} and {other.path}")
    return camera


def _layout(options: ViewOptions, results: int) -> str:
    if results > MOST_RESULTS:
        expected = f"at most {MOST_RESULTS} beside each other"
        raise UsageError("too many results", found=results, expected=expected)
    if options.layout == "side-by-side" and results == 1:
        raise UsageError("--layout side-by-side needs two results", found="one")
    return options.layout or ("beside" if results == 1 else "side-by-side")


def _with_segments(
    layers: Sequence[Layer], results: Sequence[Result], tracks: Sequence[str], camera: Camera
) -> tuple[Layer, ...]:
    """The layers, each with what tells the hand's pixels as its own run does.

    Raises:
        ResultError: a result of another subject than a hand.
    """
    sources = [result for result in results for _ in tracks]
    return tuple(
        replace(layer, segments=HandSegments(hand_of(result).anatomy, configuration_of(result.run), camera))
        for layer, result in zip(layers, sources, strict=True)
    )


def _depth_range(options: ViewOptions, track: Track) -> DepthRange:
    """The same colours for all frames, so that they do not flicker."""
    if options.range_mm is not None:
        near, far = options.range_mm
        if not 0.0 <= near < far < np.inf:
            found = f"{near:g} {far:g}"
            raise UsageError("--range-mm cannot be used", found=found, expected="0 <= NEAR < FAR")
        return DepthRange(near, far)
    return usual_range(track)


def usual_range(track: Track) -> DepthRange:
    """The depths around where a track goes while it is not lost."""
    rows = not_lost(track, np.arange(len(track), dtype=np.int64))
    source = track.points if track.points is not None else track.position
    return DepthRange.of_points(np.empty(0) if source is None else source[rows][..., 2])
