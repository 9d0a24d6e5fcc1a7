"""``calibrate stereo`` and ``hand calibrate``."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    FILE,
    camera_names,
    cameras_option,
    config_option,
    hand_mesh_option,
    hand_side_option,
    option_group,
    output_option,
    overwrite_option,
    recording_options,
)
from posetrack_cli.cli.running import announce_compiling, open_for_reading, print_next
from posetrack_cli.cli.terminal import bar, print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST, RecordingError, UsageError

if TYPE_CHECKING:
    from posetrack_cli.hand.config import HandConfig
    from posetrack_cli.hand.shape_fit import Calibration


# posetrack calibrate: cameras


SQUARES = re.compile(r"(\d{1,4})[xX](\d{1,4})")


@click.group()
def calibrate() -> None:
    """Calibrate cameras."""


@calibrate.command(
    "stereo",
    cls=Command,
    examples=(
        "posetrack calibrate stereo boards/ --squares 10x7 --square-mm 25 -o rig.toml",
        "posetrack calibrate stereo boards/ --squares 10x7 --square-mm 25 \\",
        "    --marker-mm 18 --cameras left,right -o rig.toml",
    ),
    short_help="Calibrate two or more cameras from images of a board.",
)
@click.argument("images", metavar="FOLDER", type=FILE)
@output_option("Output file: the camera file.", "camera.toml")
@option_group(
    option(
        "--squares",
        metavar="COLUMNSxROWS",
        required=True,
        help="Squares of the board; 10x7 has 9x6 inner corners.",
    ),
    option(
        "--square-mm",
        metavar="MM",
        type=float,
        required=True,
        help="Side of a square in mm, measured on the print.",
    ),
    option(
        "--marker-mm",
        metavar="MM",
        type=float,
        help="Side of a marker in mm; selects a ChArUco board instead of a chessboard.",
    ),
    option(
        "--dictionary",
        metavar="NAME",
        default="4X4_50",
        show_default=True,
        help="Marker dictionary of the ChArUco board (OpenCV name).",
    ),
    title="Board",
)
@cameras_option("Names of the camera folders, reference first.  [default: all]", "Cameras")
@option(
    "--distortion",
    type=click.Choice(["none", "four", "five", "eight"]),
    default="four",
    show_default=True,
    help="Number of distortion coefficients: k1 k2 p1 p2 (four), plus k3 (five), plus k4 k5 k6 (eight).",
    group="Cameras",
)
@overwrite_option("camera.toml if it exists")
@volume_options
def calibrate_stereo(images: Path, output: Path, **options: Any) -> None:
    """Calibrate intrinsics, distortion and extrinsics of cameras from images of a board in FOLDER.

    FOLDER has one image folder per camera (left/ right/ ...). Images taken at the same time have the same
    name or number, or timestamps as names. Take about 20 images of the board: near and far, tilted, in the
    centre and the corners of every camera. The camera file is used as camera.toml of recordings with these
    cameras; it lists the errors as comments. Exit code 3: the errors are large.
    """
    from posetrack_cli.files import write_output
    from posetrack_cli.losses import LossLog, loss_line
    from posetrack_cli.outputs import check_target, whole_or_nothing
    from posetrack_cli.recording.calibration.solve import calibrate_stereo as calibrated
    from posetrack_cli.recording.calibration.views import Board, find_views

    check_target(output, overwrite=options["overwrite"], source=images)
    board = Board(
        *_squares(options["squares"]), options["square_mm"], options["marker_mm"], options["dictionary"]
    )
    names = camera_names(options["cameras"]) if options["cameras"] else None
    losses = LossLog()
    with _progress() as report:
        views = find_views(images, board, names, report, losses)
        found = calibrated(views, options["distortion"])
    for note in losses.notes:
        print_note(f"{images}: {note}")
    for line in found.lines():
        print_line(line)
    for warning in found.doubts():
        print_note(f"warning: {warning}")
    if not found.fits_together:
        raise RecordingError(
            "cameras are inconsistent, camera file not written",
            where=images,
            found="images that fit each camera alone, but not together",
            hint="give simultaneous images the same name or number, or timestamps as names",
        )
    with whole_or_nothing(output) as part:
        write_output(part, found.file_text(images).encode())
    print_line(f"{output}: cameras {', '.join(camera.name for camera in found.cameras)}")
    if losses.losses:
        print_note(f"{images}: {loss_line(losses.losses)}")
    if losses.losses or found.is_inaccurate:
        click.get_current_context().exit(EXIT_DATA_LOST)


def _squares(text: str) -> tuple[int, int]:
    match = SQUARES.fullmatch(text)
    if match is None:
        raise UsageError("invalid --squares", found=f"'{text}'", expected="COLUMNSxROWS such as 10x7")
    return int(match[1]), int(match[2])


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """Yield a function that updates a progress bar."""
    with bar("board", "image") as shown:
        yield lambda done, total: shown.advance(done - shown.done, total=total)


# posetrack hand calibrate: size and shape of a hand


@click.command(
    "calibrate",
    cls=Command,
    examples=(
        "posetrack hand calibrate depth.mcap -o hand.toml",
        "posetrack hand run other.mcap --shape hand.toml -o hand.mcap",
    ),
    former={"--frames": "--fit-frames"},
    short_help="Estimate the size and shape of the hand in a recording.",
)
@click.argument("recording", type=FILE)
@output_option("Output file: hand configuration (TOML).", "HAND.toml")
@overwrite_option("HAND.toml if it exists")
@option_group(
    option(
        "--fit-frames",
        metavar="N",
        type=click.IntRange(min=4, max=200),
        default=32,
        show_default=True,
        help="Number of frames to fit the shape to; frames with the most visible fingers are chosen from all "
        "parts of the recording.",
    ),
    hand_side_option("auto", "right", "left", text="Side of the hand; auto estimates it.  [default: auto]"),
    hand_mesh_option,
    title="Hand",
)
@config_option("hand (default), hand-fast, hand-paper, hand-pso")
@recording_options
@volume_options
def hand_calibrate(recording: Path, output: Path, **options: Any) -> None:
    """Estimate side, size and shape of the hand in RECORDING, which may be a folder of single depth images.

    The recording should show the hand open, from the palm or back, and with bent fingers. Use the file for
    other recordings of the same hand: posetrack hand run RECORDING --shape HAND.toml.
    """
    from posetrack_cli.hand.autodetect import calibrate
    from posetrack_cli.hand.shape_fit import CalibrationOptions, write_hand_file
    from posetrack_cli.losses import loss_line
    from posetrack_cli.outputs import check_target

    check_target(output, overwrite=options["overwrite"], source=recording)
    config = _configuration(options)
    side = None if options["side"] == "auto" else options["side"]
    source = open_for_reading(recording, options)
    chosen = CalibrationOptions(side, options["fit_frames"])
    with announce_compiling():
        found = calibrate(source, config, chosen)
    write_hand_file(output, found, config.hand.mesh, recording.name)
    _show(found)
    print_line(
        f"{output}: {found.frames_used} of {found.frames_seen} frames, residual {found.residual_mm:.2f} mm"
    )
    if warning := found.warning:
        print_note(f"{recording}: a {found.side} hand, {found.length_mm:.0f} mm long{warning}")
    # resolve(): the recording may be "." or a link.
    result = Path(f"{recording.resolve().stem}-tracked.mcap")
    print_next(("hand", "run", recording, "--shape", output, "-o", result))
    if source.losses:
        print_note(f"{recording}: {loss_line(source.losses)}")
        click.get_current_context().exit(EXIT_DATA_LOST)


def _configuration(options: dict[str, Any]) -> HandConfig:
    from posetrack_cli.configuration import find_configuration, load_settings
    from posetrack_cli.hand.config import HandConfig

    files = [find_configuration(name) for name in options["configs"]]
    return load_settings(HandConfig, files, {"hand.mesh": options["mesh"]})


def _show(calibration: Calibration) -> None:
    """Print a table of hand measurements and their standard deviations."""
    print_line(f"{'side':<18}{calibration.side:>8}")
    print_line(f"{'mm':<18}{'':>8}{'sd':>8}")
    for name, value in calibration.measured.values.items():
        print_line(f"{name.replace('_', ' '):<18}{value:>8.1f}{calibration.measured.sd[name]:>8.1f}")
