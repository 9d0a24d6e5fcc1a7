"""``convert`` and ``export``."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    FILE,
    FILTERED,
    TRACKS,
    option_group,
    output_option,
    overwrite_option,
    recording_options,
    track_option,
    truth_option,
)
from posetrack_cli.cli.running import open_for_reading
from posetrack_cli.cli.terminal import STANDARD_OUTPUT, print_data, print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST, UsageError

if TYPE_CHECKING:
    from posetrack_cli.recording.base import TruthMessage
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.results.export.source import ExportSource


# ``posetrack convert``: write a recording as one MCAP file


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
    from posetrack_cli.evaluation.reading.truth_tables import load_csv_track
    from posetrack_cli.evaluation.reading.truth_topics import points_messages, points_topic
    from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
    from posetrack_cli.results.estimate import Subject

    subject = Subject("hand", source.cameras[0].name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
    if any(message.topic == points_topic(subject.name) for message in source.truth()):
        raise UsageError("has true joints already", where=source.path, hint="leave --truth out")
    return list(points_messages(load_csv_track(path, subject)))


# ``posetrack export``: write a result for other tools


FORMATS = ("csv", "tum", "npz", "json", "bvh", "c3d", "mcap")
SCHEMAS = ("ros2",)
_BY_SUFFIX = {f".{name}": name for name in FORMATS}


@click.command(
    cls=Command,
    examples=(
        "posetrack export result.mcap -o result.csv",
        "posetrack export result.mcap --format tum --no-lost -o head.tum",
        "posetrack export result.mcap -o hand.bvh",
        "posetrack export result.mcap --schemas ros2 -o result-ros2.mcap",
        "posetrack export result.mcap --estimate-topic /truth/hand/estimate",
    ),
    former={"--topic": "--estimate-topic"},
    short_help="Write a result for other tools: CSV, TUM, numpy, JSON, BVH, C3D, ROS 2.",
)
@click.argument("path", metavar="RESULT", type=FILE)
@option(
    "--format",
    "format_name",
    type=click.Choice(FORMATS),
    help="What to write.  [default: as FILE is named; without an ending csv]",
)
@option(
    "--schemas",
    type=click.Choice(SCHEMAS),
    help="Whose messages an MCAP file holds; RESULT itself has Foxglove's.  [default: ros2]",
)
@output_option("Nothing or - is standard output.", "FILE|-", required=False)
@overwrite_option("The file of -o")
@track_option(*TRACKS, default=FILTERED)
@option(
    "--estimate-topic",
    "topic",
    metavar="TOPIC",
    help="MCAP topic of the estimates, such as /truth/hand/estimate.  [default: the result's own]",
)
@option("--no-lost", is_flag=True, help="Leave out frames whose status is lost.")
@volume_options
def export(
    path: Path,
    format_name: str | None,
    schemas: str | None,
    output: Path | None,
    track: str,
    topic: str | None,
    no_lost: bool,
    overwrite: bool,
) -> None:
    """Write the estimates of RESULT, finished or not, for other tools.

    \b
    csv   a header row and a row per frame: mm, rad, deg, as columns are named
    tum   timestamp tx ty tz qx qy qz qw, in s and m, for trajectory tools
    json  the columns of csv as lists, below their meanings and the run record
    npz   an array per field of an estimate, for numpy; needs -o
    bvh   a hand's skeleton for Blender: m, y up, a fixed frame rate
    c3d   joints or points as markers: mm, a fixed frame rate; needs -o
    mcap  messages of ROS 2 (tf2, nav_msgs, sensor_msgs); needs -o

    Euler angles: R = R_y(yaw) R_x(pitch) R_z(roll), in camera axes. Lost frames are in, with their last pose;
    their status says so in all formats but tum and bvh: there leave them out with --no-lost. In c3d they are
    markers that are not seen. Exit code 3 means that RESULT is truncated or damaged; what can be read is
    written all the same.
    """
    from posetrack_cli.losses import loss_line
    from posetrack_cli.results.export.export import export_file, save_text, text_pieces
    from posetrack_cli.results.export.source import export_source
    from posetrack_cli.results.reader import read_result

    output = None if output == STANDARD_OUTPUT else output
    chosen = _chosen_format(format_name, schemas, output)
    if topic is not None and track != FILTERED:
        raise UsageError("--estimate-topic and --track exclude each other", found=f"{topic} and {track}")
    result = read_result(path)
    source = export_source(result, topic or result.topic_of_track(track), lost=not no_lost)
    notes: tuple[str, ...] = ()
    pieces: Iterable[str] | None = None
    if chosen == "bvh":
        pieces, notes = _bvh(source)
    if output is None:
        if sys.stdout is None:
            raise UsageError("standard output is closed", hint="name a file with -o")
        for piece in text_pieces(source, chosen) if pieces is None else pieces:
            print_data(piece)
    else:
        if pieces is None:
            notes = export_file(source, chosen, output, overwrite=overwrite)
        else:
            save_text(pieces, source, output, overwrite=overwrite)
        print_line(f"{output}: {chosen}, {output.stat().st_size} bytes")
    for note in notes:
        print_note(f"{path}: {note}")
    if result.losses:
        print_note(f"{path}: {loss_line(result.losses)}")
        click.get_current_context().exit(EXIT_DATA_LOST)


def _chosen_format(format_name: str | None, schemas: str | None, output: Path | None) -> str:
    """What is asked for, else what the output is named as; schemas are of MCAP files only."""
    suffix = output.suffix.lower() if output else ""
    chosen = format_name or _BY_SUFFIX.get(suffix) or ("mcap" if schemas else "csv")
    if suffix and not (format_name or schemas or suffix in _BY_SUFFIX):
        known = ", ".join(_BY_SUFFIX)
        hint = "or choose one with --format"
        raise UsageError("no such format", where=output, found=suffix, expected=known, hint=hint)
    if schemas and chosen != "mcap":
        raise UsageError(
            "--schemas is of MCAP files", found=chosen, expected="--format mcap, or -o NAME.mcap"
        )
    return chosen


def _bvh(source: ExportSource) -> tuple[Iterable[str], tuple[str, ...]]:
    """The text of a hand's animation, and what there is to say of its frames."""
    from posetrack_cli.evaluation.reading.recording_of import anatomy_of
    from posetrack_cli.hand.bvh import bvh_text, check_hand

    check_hand(source)
    rate, pieces = bvh_text(source, anatomy_of(source.result))
    return pieces, tuple(rate.notes("they lie between their neighbours"))
