"""``posetrack export``: write a result for other tools."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from posetrack_cli.cli.command import Command, option
from posetrack_cli.cli.options import FILE, FILTERED, TRACKS, output_option, overwrite_option, track_option
from posetrack_cli.cli.standard_output import STANDARD_OUTPUT, print_data, print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST, UsageError

FORMATS = ("csv", "tum", "npz", "json")
_BY_SUFFIX = {f".{name}": name for name in FORMATS}


@click.command(
    cls=Command,
    examples=(
        "posetrack export result.mcap -o result.csv",
        "posetrack export result.mcap --format tum --no-lost -o head.tum",
        "posetrack export result.mcap --estimate-topic /truth/hand/estimate",
    ),
    former={"--topic": "--estimate-topic"},
    short_help="Write a result as CSV, TUM, numpy or JSON.",
)
@click.argument("path", metavar="RESULT", type=FILE)
@option(
    "--format",
    "format_name",
    type=click.Choice(FORMATS),
    help="What to write.  [default: as FILE is named, else csv]",
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
def export(
    path: Path,
    format_name: str | None,
    output: Path | None,
    track: str,
    topic: str | None,
    no_lost: bool,
    overwrite: bool,
) -> None:
    """Write the estimates of RESULT, finished or not, for other tools.

    \b
    csv   one row per frame, every column explained in comments above: mm, rad, deg
    tum   timestamp tx ty tz qx qy qz qw, in s and m, for trajectory tools
    json  the columns of csv as lists, below a header with units and the run record
    npz   one array per field of an estimate, for numpy; needs -o

    Euler angles: R = R_y(yaw) R_x(pitch) R_z(roll), in camera axes. Lost frames are in, with their last pose;
    their status says so in all formats but tum: there leave them out with --no-lost. Exit code 3 means that
    RESULT is truncated or damaged; what can be read is written all the same.
    """
    from posetrack_cli.losses import loss_line
    from posetrack_cli.results.export.export import export_file, text_pieces
    from posetrack_cli.results.export.source import export_source
    from posetrack_cli.results.reader import read_result

    result = read_result(path)
    if topic is not None and track != FILTERED:
        raise UsageError("--estimate-topic and --track exclude each other", found=f"{topic} and {track}")
    source = export_source(result, topic or result.topic_of_track(track), lost=not no_lost)
    if output == STANDARD_OUTPUT:
        output = None
    chosen = format_name or _BY_SUFFIX.get(output.suffix.lower() if output else "", "csv")
    if output is None:
        if sys.stdout is None:
            raise UsageError("standard output is closed", hint="name a file with -o")
        for piece in text_pieces(source, chosen):
            print_data(piece)
    else:
        export_file(source, chosen, output, overwrite=overwrite)
        print_line(f"{output}: {chosen}, {output.stat().st_size} bytes")
    if result.losses:
        print_note(f"{path}: {loss_line(result.losses)}")
        click.get_current_context().exit(EXIT_DATA_LOST)
