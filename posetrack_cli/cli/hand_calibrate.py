"""``posetrack hand calibrate``: the size and proportions of the hand in a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    FILE,
    config_option,
    hand_mesh_option,
    hand_side_option,
    option_group,
    output_option,
    overwrite_option,
    recording_options,
)
from posetrack_cli.cli.running import compiling_said, open_for_reading, tell_next
from posetrack_cli.cli.standard_output import print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST

if TYPE_CHECKING:
    from posetrack_cli.hand.calibration.calibrate import Calibration
    from posetrack_cli.hand.config import HandConfig


@click.command(
    "calibrate",
    cls=Command,
    examples=(
        "posetrack hand calibrate depth.mcap -o hand.toml",
        "posetrack hand run other.mcap --shape hand.toml -o hand.mcap",
    ),
    former={"--frames": "--fit-frames"},
    short_help="Find the size and proportions of the hand in a recording.",
)
@click.argument("recording", type=FILE)
@output_option("The hand, a configuration file.", "HAND.toml")
@overwrite_option("HAND.toml")
@option_group(
    option(
        "--fit-frames",
        metavar="N",
        type=click.IntRange(min=4, max=200),
        default=32,
        show_default=True,
        help="How many frames the shape is fitted to: those that show the most of fingers, up to 16 of them "
        "from as many parts of the recording.",
    ),
    hand_side_option("auto", "right", "left", details="auto tells from the images.  [default: auto]"),
    hand_mesh_option,
    title="Hand",
)
@config_option("As of hand run")
@recording_options
@volume_options
def hand_calibrate(recording: Path, output: Path, **options: Any) -> None:
    """Estimate side, size and shape of the hand in RECORDING, which may be some separate depth images.

    Frames are chosen from all of it; the hand should be seen open, from its palm or its back, and with its
    fingers bent. The file serves other recordings of the hand: hand run RECORDING --shape HAND.toml.
    """
    from posetrack_cli.hand.calibration.before_run import calibrate
    from posetrack_cli.hand.calibration.calibrate import CalibrationOptions, write_hand_file
    from posetrack_cli.hand.calibration.doubts import doubts_of
    from posetrack_cli.losses import loss_line
    from posetrack_cli.outputs import check_target

    check_target(output, overwrite=options["overwrite"], source=recording)
    config = _configuration(options)
    side = None if options["side"] == "auto" else options["side"]
    source = open_for_reading(recording, options)
    chosen = CalibrationOptions(side, options["fit_frames"])
    with compiling_said():
        found = calibrate(source, config, chosen)
    write_hand_file(output, found, config.hand.mesh, recording.name)
    _show(found)
    print_line(
        f"{output}: {found.frames_used} of {found.frames_seen} frames, residual {found.residual_mm:.2f} mm"
    )
    if doubts := doubts_of(found):
        print_note(f"{recording}: a {found.side} hand, {found.length_mm:.0f} mm long{doubts}")
    result = Path(f"{recording.resolve().stem}-tracked.mcap")
    tell_next(("hand", "run", recording, "--shape", output, "-o", result))
    if source.losses:
        print_note(f"{recording}: {loss_line(source.losses)}")
        click.get_current_context().exit(EXIT_DATA_LOST)


def _configuration(options: dict[str, Any]) -> HandConfig:
    from posetrack_cli.configuration import find_configuration, load_settings
    from posetrack_cli.hand.config import HandConfig

    files = [find_configuration(name) for name in options["configs"]]
    return load_settings(HandConfig, files, {"hand.mesh": options["mesh"]})


def _show(calibration: Calibration) -> None:
    """A table: what the hand measures, with standard deviations."""
    print_line(f"{'side':<18}{calibration.side:>8}")
    print_line(f"{'mm':<18}{'':>8}{'sd':>8}")
    for name, value in calibration.measured.values.items():
        print_line(f"{name.replace('_', ' '):<18}{value:>8.1f}{calibration.measured.sd[name]:>8.1f}")
