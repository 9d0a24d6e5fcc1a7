"""Pictures of heads: axes, points and lines of the face on the images of every camera, beside each other."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.matched_images import matched_images
from posetrack_cli.evaluation.recording_of import cameras_of
from posetrack_cli.evaluation.viewing.colours import TRUTH
from posetrack_cli.evaluation.viewing.head_panels import HeadPanels, drawer_of_head
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
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.recording.recording import Recording
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
        layers = layers_of(results, options.tracks, truth, drawer_of_head)
        self._track = layers[0].track
        self.rows = rows_to_draw(options, layers[0])
        self._panels = HeadPanels(
            _common_cameras(results, recording),
            layers,
            Layer(truth, layers[0].drawer, TRUTH) if options.truth and truth is not None else None,
            around=self._around(),
            scale=options.scale,
            still=not options.sheet,
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
        for position, frame in matched_images(self._recording, stamps, numbers, self._log):
            row = int(self.rows[position])
            around = None if track.points is None else track.points[row]
            yield frame.index, self._panels.picture(frame, int(track.stamp_ns[row]), around)

    def _around(self) -> FloatArray | None:
        """The points that pictures are cut out around; None for all of the image."""
        if (self._options.crop or "full") == "full" or self._track.points is None:
            return None
        return self._track.points[not_lost(self._track, self.rows)]


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
    """The cameras of all results."""
    cameras = cameras_of(results[0], recording)
    for other in results[1:]:
        if other.cameras() != cameras:
            raise UsageError("results have different cameras", found=f"{results[0].path} and {other.path}")
    return cameras
