"""``posetrack view``: draw results on the recording they were made from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

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
    from posetrack_cli.results.reader import Result

LAYOUTS = ("beside", "over", "paper", "segments", "side-by-side")
DRAWN = {
    "frames": "select",
    "layout": "layout",
    "crop": "crop",
    "scale": "zoom",
    "range_mm": "range_mm",
    "truth": "show_truth",
    "skeleton": "skeleton",
}
"""What ``ViewOptions`` calls them, and what the options are called."""


@click.command(
    cls=Command,
    examples=(
        "posetrack view result.mcap -o result.mp4",
        "posetrack view result.mcap -o worst.png --select worst:8 --show-truth",
        "posetrack view result.mcap -o pictures/ --recording /data/recording.mcap",
    ),
    former={"--frames": "--select", "--scale": "--zoom", "--truth": "--show-truth"},
    short_help="Draw a result on its recording: a video, pictures, or one sheet.",
)
@click.argument("paths", metavar="RESULT [RESULT2]", nargs=-1, required=True, type=FILE)
@output_option(
    "FILE.mp4, a folder (frame_000123.png, ...), or FILE.png: the chosen frames on one sheet.",
    "FILE.mp4|FILE.png|FOLDER",
)
@overwrite_option("A video, a sheet or earlier pictures")
@option_group(
    option(
        "--select",
        metavar="CHOICE",
        help="Which frames: all, 0:300:5, 7,12,100:120, spread:6, or worst:8, a second or more apart.  "
        "[default: all; of a sheet spread:6]",
    ),
    track_option(*TRACKS, BOTH, default=FILTERED, details="Both are drawn beside each other."),
    option(
        "--layout",
        type=click.Choice(LAYOUTS),
        help="beside: observed, rendered and both beside each other; over: only both; paper: observed above "
        "and rendered below, as in the paper; segments: observed and, around the estimate, hand (green), "
        "forearm (orange), other surfaces (blue) and missing readings (purple); side-by-side: two results.  "
        "[default: beside; of two results side-by-side]",
    ),
    option(
        "--crop",
        type=click.Choice(["full", "hand", "head"]),
        help="All of the image, or where hand or head go.  [default: full; of layout paper hand]",
    ),
    option(
        "--zoom",
        metavar="FACTOR",
        type=FiniteRange(0.05, 16.0),
        help="Picture pixels per image pixel.  [default: 1, more for small images; of a sheet what fits]",
    ),
    option(
        "--rate",
        metavar="HZ",
        type=FiniteRange(0.1, 240.0),
        help="Pictures per second of a video.  [default: as fast as recorded]",
    ),
    option(
        "--range-mm",
        type=(float, float),
        metavar="NEAR FAR",
        help="Depths drawn red and blue.  [default: the hand's]",
    ),
    option("--show-truth", is_flag=True, help="Also draw the truth, green: contour, or points and axes."),
    option("--skeleton", is_flag=True, help="Draw joints, bones and the axes of the pose."),
    title="What is drawn",
)
@recording_option("Found by itself where it was, or beside the result or above it.")
@option(
    "--any-recording", is_flag=True, help="Draw on --recording even if it is not that of the run.", group=READ
)
@recording_options
@device_option("[default: the driver's, else cpu]")
@volume_options
def view(paths: tuple[Path, ...], output: Path, **options: Any) -> None:
    """Draw RESULT on its recording: depth in false colour (near red, far blue), with the rendered hand.

    A head is drawn on the images of its cameras: ten points, lines between them, and the axes of the pose, x
    to the subject's left red, y up green, z out of the face blue.

    Two results of one recording are drawn beside each other. Lost frames have a red border, those found anew
    an orange one. Captions tell frame, time, status, confidence and, where the result carries truth, the mean
    error of its points. Images of a camera with lens distortion are drawn without it.

    Videos are H.264, which browsers, players and chats play. Ctrl-C leaves what was drawn, readable. Exit
    code 3 means that the result is truncated, or frames of it are not in the recording.
    """
    from posetrack_cli.evaluation.viewing.outputs import check_view_output, open_output
    from posetrack_cli.results.reader import read_result

    check_view_output(output, overwrite=options["overwrite"])
    results = [read_result(path) for path in paths]
    drawn = _prepare(results, output, options)
    with stop_signals() as stopped, _finished(open_output(output, options["rate"] or drawn.rate_hz)) as out:
        count = _draw(drawn, out, stopped)
    _close(output, count, drawn, results, interrupted=stopped())


def _prepare(results: Sequence[Result], output: Path, options: dict[str, Any]) -> ResultView:
    """Everything that can be refused is refused here, before the first frame."""
    from posetrack_cli.evaluation.reading.recording_of import required_recording
    from posetrack_cli.evaluation.viewing.layers import ViewOptions
    from posetrack_cli.evaluation.viewing.outputs import is_sheet
    from posetrack_cli.evaluation.viewing.view import ResultView, style_of
    from posetrack_cli.rendering.devices import open_usual_device

    tracks = chosen_tracks(options["track"])
    drawn = {name: options[called] for name, called in DRAWN.items()}
    view_options = ViewOptions(**drawn, sheet=is_sheet(output), tracks=tracks)
    _check_one_recording(results, options)
    style_of(results)
    chosen = {"any_recording": options["any_recording"], "in_colour": True, **reading_options(options)}
    recording = required_recording(results[0], options["recording"], **chosen)
    return ResultView(results, recording, view_options, cache(lambda: open_usual_device(options["device"])))


def _check_one_recording(results: Sequence[Result], options: dict[str, Any]) -> None:
    """Refuse results of several recordings, unless any will do."""
    from posetrack_cli.recording.base import RECORDING_KEY

    given, any_recording = options["recording"], options["any_recording"]
    if any_recording and given is None:
        raise UsageError("--any-recording needs --recording")
    inputs = {result.run.get(RECORDING_KEY) for result in results}
    if len(inputs) > 1 and not any_recording:
        found = ", ".join(str(result.path) for result in results)
        raise UsageError("results are of different recordings", found=found)


@contextmanager
def _finished(out: Output) -> Iterator[Output]:
    """Yield an output; it is finished at the end, and nothing of it is left after a failure."""
    try:
        yield out
        out.close()
    except BaseException:
        out.discard()
        raise


def _draw(drawn: ResultView, out: Output, stopped: Any) -> int:
    """Draw the frames until it is stopped; return how many there are."""
    from contextlib import closing

    count = 0
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
    """The closing line, and the exit code."""
    from posetrack_cli.losses import loss_line

    context, asked = click.get_current_context(), len(drawn.rows)
    if interrupted:
        what = f"after {count} of {asked} frames: {output}" if count else "before the first frame"
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
