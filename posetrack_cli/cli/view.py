"""``posetrack view``: render results over their recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    BOTH,
    FILE,
    FILTERED,
    READ,
    TRACKS,
    FiniteRange,
    chosen_tracks,
    device_option,
    of_option,
    option_group,
    output_option,
    overwrite_option,
    reading_options,
    recording_option,
    recording_options,
    track_option,
)
from posetrack_cli.cli.process import stop_signals
from posetrack_cli.cli.terminal import bar, print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_INTERRUPTED, UsageError

if TYPE_CHECKING:
    from posetrack_cli.evaluation.viewing.outputs import Output
    from posetrack_cli.evaluation.viewing.view import ResultView
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.results.reader import Result

LAYOUTS = ("beside", "over", "paper", "segments", "side-by-side")
# Fields of ``ViewOptions``, and the names of their options
DRAWN = {
    "frames": "select",
    "layout": "layout",
    "crop": "crop",
    "scale": "zoom",
    "range_mm": "range_mm",
    "truth": "show_truth",
    "skeleton": "skeleton",
}


@click.command(
    cls=Command,
    examples=(
        "posetrack view result.mcap -o result.mp4",
        "posetrack view result.mcap -o worst.png --select worst:8 --show-truth",
        "posetrack view result.mcap -o pictures/ --recording /data/recording.mcap",
        "posetrack view result.mcap -o with-images.mcap",
    ),
    former={"--frames": "--select", "--scale": "--zoom", "--truth": "--show-truth"},
    short_help="Render a result over its recording, or join both in one MCAP file.",
)
@click.argument("paths", metavar="RESULT [RESULT2]", nargs=-1, required=True, type=FILE)
@output_option(
    "Output: video (FILE.mp4), folder of images (frame_000123.png, ...), contact sheet (FILE.png), or the "
    "result and its images for Foxglove and rerun (FILE.mcap).",
    "FILE.mp4|FILE.png|FILE.mcap|FOLDER",
)
@overwrite_option("existing output")
@option_group(
    option(
        "--select",
        metavar="CHOICE",
        help="Frames to draw: all, 0:300:5, 7,12,100:120, spread:6, or worst:8 (at least one second apart).  "
        "[default: all; spread:6 for a contact sheet]",
    ),
    track_option(*TRACKS, BOTH, default=FILTERED, text="Track to draw; both draws the two side by side."),
    of_option("draw"),
    option(
        "--layout",
        type=click.Choice(LAYOUTS),
        help="beside: observed, rendered and overlaid, side by side; over: overlaid only; paper: observed "
        "above rendered, as in the paper; segments: observed, and labels near the estimate: hand (green), "
        "forearm (orange), other surfaces (blue), missing readings (purple); side-by-side: two results.  "
        "[default: beside; side-by-side for two results]",
    ),
    option(
        "--crop",
        type=click.Choice(["full", "hand", "head"]),
        help="Image region: the full image, or the region of the hand or head.  [default: full; hand for "
        "layout paper]",
    ),
    option(
        "--zoom",
        metavar="FACTOR",
        type=FiniteRange(0.05, 16.0),
        help="Output pixels per image pixel.  [default: 1, more for small images; contact sheets are fitted]",
    ),
    option(
        "--rate",
        metavar="HZ",
        type=FiniteRange(0.1, 240.0),
        help="Frame rate of the video.  [default: that of the recording]",
    ),
    option(
        "--range-mm",
        type=(float, float),
        metavar="NEAR FAR",
        help="Depths drawn in red and in blue.  [default: range of the hand]",
    ),
    option(
        "--show-truth", is_flag=True, help="Also draw ground truth in green: contour, or points and axes."
    ),
    option("--skeleton", is_flag=True, help="Draw joints, bones and the axes of the pose."),
    title="Drawing",
)
@recording_option("Recording of the result.  [default: searched at its original path and near the result]")
@option(
    "--any-recording", is_flag=True, help="Accept a --recording other than that of the result.", group=READ
)
@recording_options
@device_option("EGL device to render with, or cpu.  [default: a GPU if available, else cpu]")
@volume_options
def view(paths: tuple[Path, ...], output: Path, **options: Any) -> None:
    """Render RESULT over its recording: depth in false colour (red near, blue far) and the tracked hand.

    A head is drawn on the camera images: ten face points, lines between them, and the axes of the pose (x
    red, to the subject's left; y green, up; z blue, out of the face).

    Two results of the same recording are drawn side by side. Lost frames have a red border, reinitialised
    ones an orange border. Captions show frame, time, status, confidence and, with ground truth in the result,
    the mean point error. Lens distortion is removed from the images.

    FILE.mcap is a copy of RESULT with the images of its frames: depth as 16UC1, other images as stored if
    possible, else as JPEG. Its estimates are protobuf. Options for drawing do not apply to it.

    Videos are H.264. After Ctrl-C, the part drawn so far is a valid output, except for FILE.mcap. Exit code
    3: the result is truncated, or some of its frames are not in the recording.
    """
    from posetrack_cli.evaluation.viewing.outputs import check_view_output, is_messages, open_output
    from posetrack_cli.results.reader import read_result

    check_view_output(output, overwrite=options["overwrite"])
    wholes = [read_result(path) for path in paths]
    if is_messages(output):
        _join(wholes, output, options)
        return
    results = _parts(wholes, options["of"])
    drawn = _prepare(results, output, options)
    with stop_signals() as stopped, _finished(open_output(output, options["rate"] or drawn.rate_hz)) as out:
        count = _draw(drawn, out, stopped)
    _close(output, count, drawn, results, interrupted=stopped())


def _join(results: Sequence[Result], output: Path, options: dict[str, Any]) -> None:
    """Write a result and its images to one file, print the closing lines and set the exit code."""
    from posetrack_cli.evaluation.viewing.with_images import write_with_images
    from posetrack_cli.losses import loss_line

    context = click.get_current_context()
    own = (*DRAWN.values(), "track", "of", "rate", "device")
    given = [name for name in own if _is_given(context, name)]
    if len(results) > 1 or given:
        found = f"--{given[0].replace('_', '-')}" if given else f"{len(results)} results"
        raise UsageError("an MCAP file holds one result with all its tracks", found=found)
    (result,) = results
    recording = _recording_of(result, options)
    with bar("view", "frame", recording.frame_count) as shown:
        count, losses = write_with_images(
            result, recording, output, overwrite=options["overwrite"], advance=shown.advance
        )
    print_line(f"{count} {'frame' if count == 1 else 'frames'}: {output}")
    for where, lost in ((result.path, result.losses), (recording.path, losses)):
        if lost:
            print_note(f"{where}: {loss_line(lost)}")
    if result.losses or losses:
        context.exit(EXIT_DATA_LOST)


def _is_given(context: click.Context, name: str) -> bool:
    return context.get_parameter_source(name) is ParameterSource.COMMANDLINE


def _recording_of(result: Result, options: dict[str, Any]) -> Recording:
    from posetrack_cli.evaluation.reading.recording_of import required_recording

    chosen = {"any_recording": options["any_recording"], "in_colour": True, **reading_options(options)}
    return required_recording(result, options["recording"], **chosen)


def _parts(wholes: Sequence[Result], label: str | None) -> list[Result]:
    """Return the results of one subject each that are drawn."""
    if label is not None:
        return [whole.of(label) for whole in wholes]
    several = [whole for whole in wholes if len(whole.subjects) > 1]
    if several and len(wholes) > 1:
        hint = "choose one of its tracks with --of"
        raise UsageError("several tracks next to another result", where=several[0].path, hint=hint)
    return [part for whole in wholes for part in whole.parts]


def _prepare(results: Sequence[Result], output: Path, options: dict[str, Any]) -> ResultView:
    """Return the view, checked before the first frame is drawn."""
    from posetrack_cli.evaluation.viewing.layers import ViewOptions
    from posetrack_cli.evaluation.viewing.outputs import is_sheet
    from posetrack_cli.evaluation.viewing.view import ResultView, style_of
    from posetrack_cli.rendering.devices import open_fastest_device

    tracks = chosen_tracks(options["track"])
    drawn = {name: options[called] for name, called in DRAWN.items()}
    view_options = ViewOptions(**drawn, sheet=is_sheet(output), tracks=tracks)
    _check_one_recording(results, options)
    style_of(results)
    recording = _recording_of(results[0], options)
    # The device is opened on first use: heads are drawn without one.
    device = cache(lambda: open_fastest_device(options["device"]))
    return ResultView(results, recording, view_options, device)


def _check_one_recording(results: Sequence[Result], options: dict[str, Any]) -> None:
    """Raise UsageError for results of different recordings, unless --any-recording is given."""
    from posetrack_cli.recording.base import RECORDING_KEY

    given, any_recording = options["recording"], options["any_recording"]
    if any_recording and given is None:
        raise UsageError("--any-recording requires --recording")
    inputs = {result.run.get(RECORDING_KEY) for result in results}
    if len(inputs) > 1 and not any_recording:
        found = ", ".join(str(result.path) for result in results)
        raise UsageError("results belong to different recordings", found=found)


@contextmanager
def _finished(out: Output) -> Iterator[Output]:
    """Yield an output; close it at the end, or discard it after an exception."""
    try:
        yield out
        out.close()
    except BaseException:
        out.discard()
        raise


def _draw(drawn: ResultView, out: Output, stopped: Any) -> int:
    """Draw frames until stopped; return the number of drawn frames."""
    from contextlib import closing

    count = 0
    # closing(): a stopped generator must release the recording before the output is finished.
    with bar("view", "frame", len(drawn.rows)) as shown, closing(drawn.pictures()) as pictures:
        for frame_index, picture in pictures:
            out.add(frame_index, picture)
            count += 1
            shown.advance()
            if stopped():
                break
    return count


def _close(
    output: Path, count: int, drawn: ResultView, results: Sequence[Result], *, interrupted: bool
) -> None:
    """Print the closing lines and set the exit code."""
    from posetrack_cli.losses import loss_line

    context, total = click.get_current_context(), len(drawn.rows)
    if interrupted:
        what = f"after {count} of {total} frames: {output}" if count else "before the first frame"
        print_note(f"interrupted {what}")
        context.exit(EXIT_INTERRUPTED)
    if not count:
        raise _nothing(drawn)
    print_line(f"{count} {'frame' if count == 1 else 'frames'}: {output}")
    if drawn.remark:
        print_note(drawn.remark)
    losses = [(str(result.path), loss_line(result.losses)) for result in results if result.losses]
    losses += [(f"{drawn.recording_path}", loss_line(drawn.losses))] if drawn.losses else []
    for where, line in losses:
        print_note(f"{where}: {line}")
    if losses:
        context.exit(EXIT_DATA_LOST)


def _nothing(drawn: ResultView) -> Exception:
    from posetrack_cli.errors import RecordingError
    from posetrack_cli.losses import loss_line

    return RecordingError("no frame can be drawn", where=drawn.recording_path, found=loss_line(drawn.losses))
