"""Pictures of heads: axes, points and lines of the face on the images of every camera, beside each other."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.matched_images import matched_images
from posetrack_cli.evaluation.viewing.camera_panel import CameraPanel, seen_from
from posetrack_cli.evaluation.viewing.captions import caption
from posetrack_cli.evaluation.viewing.colours import TEXT, TRUTH
from posetrack_cli.evaluation.viewing.drawing import SkeletonDrawer
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
from posetrack_cli.evaluation.viewing.panels import marked
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.euler import head_roll_pitch_yaw
from posetrack_cli.recording.base import Frame, Loss, Recording
from posetrack_cli.recording.losses import LossLog
from posetrack_cli.recording.stamps import NS_PER_S
from posetrack_cli.results.reader import Result

LAYOUTS = ("beside", "over", "side-by-side")
"""All the same for a head: its cameras beside each other, its results one below the other."""


class HeadView:
    """Draws the chosen frames, one after the other, in the recording's order.

    Args:
        results: one, or two of the same recording.
        recording: the images they were made from.
        options: how.

    Raises:
        UsageError: options that cannot be meant of a head, or no frame to draw.
        ResultError: a result that cannot be drawn, or without truth where truth is asked for.
    """

    def __init__(self, results: Sequence[Result], recording: Recording, options: ViewOptions) -> None:
        self._recording, self._options, self._log = recording, options, LossLog()
        _check_options(options, len(results))
        truth = truth_of(results[0], options)
        self._layers = layers_of(results, options.tracks, truth, _drawer_of)
        self._track = self._layers[0].track
        self.rows = rows_to_draw(options, self._layers[0])
        drawn = options.truth and truth is not None
        self._truth = Layer(truth, _drawer_of(results[0]), TRUTH) if drawn and truth is not None else None
        panel = partial(CameraPanel, points=self._around(), scale=options.scale, still=not options.sheet)
        self._panels = [panel(camera) for camera in _common_cameras(results, recording)]

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
        for position, frame in matched_images(self._recording, stamps, numbers, self._log):
            yield frame.index, self._picture(frame, int(self.rows[position]))

    def _picture(self, frame: Frame, row: int) -> ImageArray:
        """Of each result a row of what the cameras saw, with its caption below."""
        stamp_ns = int(self._track.stamp_ns[row])
        around = None if self._track.points is None else self._track.points[row]
        rows = [self._row(frame, stamp_ns, around, layer) for layer in self._layers]
        return np.vstack(rows)

    def _row(self, frame: Frame, stamp_ns: int, around: FloatArray | None, layer: Layer) -> ImageArray:
        pictures = []
        for panel, image in zip(self._panels, frame.images, strict=True):
            picture, camera = panel.picture(image, around)
            panel.draw(picture, camera, stamp_ns, [layer])
            if self._truth is not None:
                shown = seen_from(camera, self._truth.shown(stamp_ns))
                self._truth.drawer.outline(picture, camera, shown, TRUTH)
            pictures.append(marked(picture, layer.mark(stamp_ns)))
        body = np.hstack(_equally_high(pictures))
        return np.vstack([body, self._caption(frame, stamp_ns, layer, body.shape[1])])

    def _caption(self, frame: Frame, stamp_ns: int, layer: Layer, width: int) -> ImageArray:
        seconds = (stamp_ns - int(self._track.stamp_ns[0])) / NS_PER_S
        words = [
            f"frame {frame.index}",
            f"{seconds:.3f} s",
            *layer.words(stamp_ns),
            *_angles(layer, stamp_ns),
        ]
        return caption([(words, layer.mark(stamp_ns) or TEXT)], width)

    def _around(self) -> FloatArray | None:
        """The points that pictures are cut out around; None for all of the image."""
        if (self._options.crop or "full") == "full" or self._track.points is None:
            return None
        return self._track.points[not_lost(self._track, self.rows)]


def _drawer_of(result: Result) -> SkeletonDrawer:
    return SkeletonDrawer(result.subject.point_parents, lines=result.subject.lines)


def _check_options(options: ViewOptions, results: int) -> None:
    if results > MOST_RESULTS:
        expected = f"at most {MOST_RESULTS} one below the other"
        raise UsageError("too many results", found=results, expected=expected)
    if options.layout is not None and options.layout not in LAYOUTS:
        found, hint = f"--layout {options.layout}", "a head is drawn on the images of its cameras"
        raise UsageError("layout cannot be used", found=found, expected="none", hint=hint)
    if options.range_mm is not None:
        raise UsageError("--range-mm does not apply to images", hint="leave it out")


def _common_cameras(results: Sequence[Result], recording: Recording) -> tuple[Camera, ...]:
    """The cameras of the first result, which the others' must be and which must have taken the images."""
    cameras = results[0].cameras()
    for other in results[1:]:
        if other.cameras() != cameras:
            raise UsageError("results have different cameras", found=f"{results[0].path} and {other.path}")
    sizes = [[(camera.width, camera.height) for camera in of] for of in (recording.cameras, cameras)]
    if sizes[0] != sizes[1]:
        found, expected = (", ".join(f"{w}x{h}" for w, h in of) for of in sizes)
        raise UsageError(
            "images are not of the cameras that were tracked",
            where=recording.path,
            found=found,
            expected=expected,
        )
    return cameras


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
    return [f"{name} {angle:+.1f}" for name, angle in zip(("roll", "pitch", "yaw"), angles, strict=True)]
