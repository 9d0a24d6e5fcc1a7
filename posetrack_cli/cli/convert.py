"""``posetrack convert``: write a recording as one MCAP file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.command import Command, volume_options
from posetrack_cli.cli.options import (
    FILE,
    option_group,
    output_option,
    overwrite_option,
    recording_options,
    truth_option,
)
from posetrack_cli.cli.running import open_for_reading
from posetrack_cli.cli.standard_output import print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST, UsageError

if TYPE_CHECKING:
    from posetrack_cli.recording.base import TruthMessage
    from posetrack_cli.recording.recording import Recording


@click.command(
    cls=Command,
    examples=(
        "posetrack convert depth/ --fps 30 -o recording.mcap",
        "posetrack convert depth/ --truth joints.csv -o recording.mcap",
    ),
    short_help="Write a recording as one MCAP file, without loss.",
)
@click.argument("recording", metavar="IN", type=FILE)
@output_option("The recording, an MCAP file.", "OUT.mcap")
@overwrite_option("The recording")
@option_group(
    truth_option("Joints of a hand, CSV: stamp_ns or t_s, and <joint>_x_mm, _y_mm, _z_mm in camera axes."),
    title="Truth",
)
@recording_options
@volume_options
def convert(recording: Path, output: Path, truth: Path | None, overwrite: bool, **options: Any) -> None:
    """Write IN, whatever recording of depth it is, as Foxglove MCAP without loss.

    Depth in whole millimetres is stored as 16-bit PNG, copied unchanged where IN has just that; other
    depth as 32-bit metres. Truth that IN carries goes along; --truth adds joints as /truth/hand/points, which
    eval measures results by. Exit code 3 means that frames were lost.
    """
    from posetrack_cli.losses import loss_line
    from posetrack_cli.recording.conversion import convert_recording

    source = open_for_reading(recording, options)
    joints = [] if truth is None else _joints(truth, source)
    conversion = convert_recording(source, output, overwrite=overwrite, truth=joints)
    print_line(f"{output}: {conversion.frames} frames, {output.stat().st_size} bytes")
    if conversion.losses:
        print_note(f"{recording}: {loss_line(conversion.losses)}")
        click.get_current_context().exit(EXIT_DATA_LOST)


def _joints(path: Path, source: Recording) -> list[TruthMessage]:
    """The joints of a CSV file as messages of truth, for a recording that has none on their topic."""
    from posetrack_cli.evaluation.truth.csv_track import load_csv_track
    from posetrack_cli.evaluation.truth.topics import points_messages, points_topic
    from posetrack_cli.hand.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
    from posetrack_cli.results.estimate import Subject

    subject = Subject("hand", source.cameras[0].name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
    if any(message.topic == points_topic(subject.name) for message in source.truth()):
        raise UsageError("has true joints already", where=source.path, hint="leave --truth out")
    return list(points_messages(load_csv_track(path, subject)))
