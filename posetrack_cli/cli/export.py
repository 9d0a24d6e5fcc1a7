"""``convert`` and ``export``."""

from __future__ import annotations

import heapq
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    FILE,
    FILTERED,
    READ,
    TRACKS,
    WRITTEN,
    cameras_option,
    of_option,
    option_group,
    output_option,
    overwrite_option,
    reading_options,
    recording_options,
    tolerance_option,
    track_option,
)
from posetrack_cli.cli.running import print_opened
from posetrack_cli.cli.terminal import STANDARD_OUTPUT, bar, print_data, print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST, UsageError

if TYPE_CHECKING:
    from posetrack_cli.recording.base import TruthMessage
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.results.export.source import ExportSource
    from posetrack_cli.results.reader import Result


# posetrack convert


class SideAndFile(click.ParamType[Any]):
    """``[SIDE=]FILE`` as side and path; the side is empty if it is not given."""

    name = "file"

    def convert(
        self, value: Any, parameter: click.Parameter | None, context: click.Context | None
    ) -> tuple[str, Path]:
        """Split the text."""
        if isinstance(value, tuple):
            return value
        from posetrack_cli.hand.config import SIDES

        side, equals, path = value.partition("=")
        if not equals or side not in SIDES:
            side, path = "", value
        return side, Path(FILE.convert(path, parameter, context))


@click.command(
    cls=Command,
    examples=(
        "posetrack convert depth/ --fps 30 -o recording.mcap",
        "posetrack convert depth/ --truth joints.csv -o recording.mcap",
        "posetrack convert face.mp4 -o face.mcap",
    ),
    short_help="Convert a recording to MCAP for Foxglove and rerun.",
)
@click.argument("recording", metavar="IN", type=FILE)
@output_option("Output file (MCAP).", "OUT.mcap")
@overwrite_option("OUT.mcap if it exists")
@option(
    "--raw",
    is_flag=True,
    help="Store whole millimetres of depth uncompressed (16UC1), which Foxglove and rerun show in colour.",
    group=WRITTEN,
)
@option_group(
    option(
        "--truth",
        metavar="[SIDE=]FILE",
        type=SideAndFile(),
        multiple=True,
        help="Ground truth of hand joints to add, CSV: stamp_ns or t_s, and <joint>_x_mm, _y_mm, _z_mm in "
        "camera axes, or labels of a public dataset; of two hands left=FILE and right=FILE. Repeatable.",
        meaning="Ground truth file",
    ),
    title="Ground truth",
)
@option_group(
    cameras_option("Cameras to convert, reference first; for MCAP files also topics.  [default: all]"),
    option("--images", is_flag=True, help="Convert the camera images of IN even if it has depth."),
    tolerance_option,
    title=READ,
)
@recording_options
@volume_options
def convert(
    recording: Path,
    output: Path,
    truth: tuple[tuple[str, Path], ...],
    overwrite: bool,
    raw: bool,
    images: bool,
    **options: Any,
) -> None:
    """Convert the recording IN, in any supported format, to Foxglove MCAP.

    Depth is written if IN has any: whole millimetres as 16-bit PNG, other depth as 32-bit float metres.
    Without depth, images of one or more cameras are written with calibration and poses. JPEG, PNG, WebP and
    raw images and H.264 and H.265 video without B-frames are copied unchanged. Other images are stored as the
    8-bit grey that is tracked, other video as JPEG images, which differ slightly.

    Ground truth in IN is copied; --truth adds joints as /truth/hand/points (or /truth/hand/left/points), used
    by eval. Exit code 3: frames were lost.
    """
    from posetrack_cli.losses import loss_line
    from posetrack_cli.recording.conversion import convert_recording
    from posetrack_cli.recording.opening import open_any

    source = open_any(recording, images=images, **reading_options(options))
    print_opened(recording, source)
    joints = _joints(truth, source)
    source.identity()  # of a large file it takes long, and has a bar of its own
    with bar("convert", "frame", source.frame_count) as shown:
        conversion = convert_recording(
            source, output, overwrite=overwrite, raw=raw, truth=joints, advance=shown.advance
        )
    print_line(f"{output}: {conversion.frames} frames, {output.stat().st_size} bytes")
    if source.is_guessed:
        print_note(f"{recording}: camera is not calibrated, so no calibration is written")
    for note in conversion.notes:
        print_note(f"{recording}: {note}")
    if conversion.losses:
        print_note(f"{recording}: {loss_line(conversion.losses)}")
        click.get_current_context().exit(EXIT_DATA_LOST)


def _joints(given: Sequence[tuple[str, Path]], source: Recording) -> list[TruthMessage]:
    """Read joints of one or two hands as ground truth messages in log-time order."""
    each = [_joints_of(side, path, source) for side, path in given]
    return list(heapq.merge(*each, key=lambda message: message.log_time_ns))


def _joints_of(side: str, path: Path, source: Recording) -> list[TruthMessage]:
    """Read joints as ground truth messages; refuse recordings that already have some."""
    import numpy as np

    from posetrack_cli.evaluation.reading.hand_labels import is_labels, read_labels
    from posetrack_cli.evaluation.reading.truth_tables import load_csv_track
    from posetrack_cli.evaluation.reading.truth_topics import points_messages, points_topic
    from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
    from posetrack_cli.losses import LossLog
    from posetrack_cli.results.estimate import Subject

    names = ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
    subject = Subject("hand", source.cameras[0].name, *names, label=side)
    if any(message.topic == points_topic(subject.topic) for message in source.truth()):
        raise UsageError("recording already has ground truth joints", where=source.path, hint="omit --truth")
    if not is_labels(path):
        return list(points_messages(load_csv_track(path, subject), subject.topic))
    labels = read_labels(path, source.path.name)
    stamps = {k: f.stamp_ns for k, f in enumerate(source.matched(LossLog())) if f is not None}
    frames = np.array([frame for frame in labels.frames.tolist() if frame in stamps], dtype=np.int64)
    stamp_ns = np.array([stamps[frame] for frame in frames.tolist()], dtype=np.int64)
    mirrored = source.identity().get("mirror") == "true"
    return list(points_messages(labels.track(path, stamp_ns, frames, mirrored=mirrored), subject.topic))


# posetrack export


_BY_SUFFIX = {
    f".{name}": name for name in ("csv", "tum", "npz", "json", "parquet", "nwb", "bvh", "c3d", "mcap")
}
_BY_ENDING = {"_motion.tsv": "bids"} | _BY_SUFFIX
FORMATS = (*_BY_SUFFIX.values(), "bids", "openface", "arkit", "blinks", "mediapipe", "rom")
DATED = ("nwb", "bids")
"""Formats with the date of the session."""
SCHEMAS = ("ros2", "protobuf")


@click.command(
    cls=Command,
    examples=(
        "posetrack export result.mcap -o result.csv",
        "posetrack export result.mcap --format tum --no-lost -o head.tum",
        "posetrack export result.mcap --format rom -o angles.csv",
        "posetrack export result.mcap --format bids -o study/sub-01_task-reach",
        "posetrack export result.mcap --schemas ros2 -o result-ros2.mcap",
        "posetrack export result.mcap --schemas protobuf -o result-protobuf.mcap",
        "posetrack export result.mcap --estimate-topic /truth/hand/estimate",
    ),
    former={"--topic": "--estimate-topic"},
    short_help="Export a result as CSV, Parquet, NumPy, NWB, BIDS, BVH, C3D or ROS 2 messages.",
)
@click.argument("path", metavar="RESULT", type=FILE)
@option(
    "--format",
    "format_name",
    metavar="NAME",
    type=click.Choice(FORMATS),
    help="Output format, see above.  [default: by the ending of FILE, else csv]",
)
@option(
    "--schemas",
    type=click.Choice(SCHEMAS),
    help="Messages of an exported MCAP file: ROS 2, or all topics of RESULT with protobuf in place of JSON.  "
    "[default: ros2]",
)
@output_option("Output file.  [default: standard output]", "FILE|-", required=False)
@overwrite_option("FILE if it exists")
@track_option(*TRACKS, default=FILTERED, text="Track to export.")
@of_option("export")
@option(
    "--estimate-topic",
    "topic",
    metavar="TOPIC",
    help="MCAP topic to export, e.g. /truth/hand/estimate.  [default: the estimates of RESULT]",
)
@option("--no-lost", is_flag=True, help="Omit frames with status lost.")
@option(
    "--session-start",
    metavar="TIME",
    help="Start of the session for nwb and bids, such as 2026-01-31T10:00:00+01:00.  [default: first frame, "
    "if stamps are UNIX time]",
)
@volume_options
def export(
    path: Path,
    format_name: str | None,
    schemas: str | None,
    output: Path | None,
    track: str,
    of: str | None,
    topic: str | None,
    no_lost: bool,
    session_start: str | None,
    overwrite: bool,
) -> None:
    """Export the estimates of RESULT, which may be unfinished.

    \b
    csv        a row per frame: pose, points, pixels, angles; units in names
    parquet    the table of csv with types and units; requires -o
    json       the columns of csv as lists, with their meanings and the run record
    npz        one array per field of an estimate, for NumPy; requires -o
    rom        range and speed of joint angles (hand) or Euler angles (head), CSV
    tum        timestamp tx ty tz qx qy qz qw, in s and m, for trajectory tools
    nwb        NWB with ndx-pose; requires -o
    bids       BIDS Motion; requires -o DATASET/sub-01_task-reach
    openface   head pose and landmarks in the columns of OpenFace, CSV
    arkit      expression of a head as coefficients of ARKit's blend shapes, CSV
    blinks     begin and end of each blink, CSV
    mediapipe  hand landmarks as MediaPipe's HandLandmarker returns them, JSON
    bvh        hand skeleton for Blender: m, y up, fixed frame rate
    c3d        joints or points as markers: mm, fixed frame rate; requires -o
    mcap       ROS 2 messages, or RESULT as protobuf (--schemas); requires -o

    Euler angles: R = R_y(yaw) R_x(pitch) R_z(roll), in camera axes. Lost frames are exported with their last
    pose and status lost, without pixels; nwb, bids, openface, arkit, mediapipe and c3d leave them empty, and
    rom omits them. tum and bvh have no status: use --no-lost. Of several heads or hands, csv has a column
    track; other formats write a file for each, such as FILE-left.npz. Exit code 3: RESULT is truncated or
    damaged, and its readable part was exported.
    """
    from posetrack_cli.losses import loss_line
    from posetrack_cli.results.export.source import export_source
    from posetrack_cli.results.reader import read_result

    output = None if output == STANDARD_OUTPUT else output
    chosen = _chosen_format(format_name, schemas, output)
    if topic is not None and track != FILTERED:
        what = "--estimate-topic and --track are mutually exclusive"
        raise UsageError(what, found=f"{topic} and {track}")
    start_ns = _session_start_ns(session_start, chosen)
    result = read_result(path)
    sources = [
        export_source(part, topic or part.topic_of_track(track), lost=not no_lost, session_start_ns=start_ns)
        for part in _parts(result, of, topic)
    ]
    if output is None and sys.stdout is None:
        raise UsageError("standard output is closed", hint="write to a file with -o")
    for note in _exported(sources[:1] if chosen == "protobuf" else sources, chosen, output, overwrite):
        print_note(f"{path}: {note}")
    if result.losses:
        print_note(f"{path}: {loss_line(result.losses)}")
        click.get_current_context().exit(EXIT_DATA_LOST)


def _parts(result: Result, label: str | None, topic: str | None) -> tuple[Result, ...]:
    """Return the parts of a result to export: of one subject if it or its topic is chosen, else of all."""
    if label is not None:
        return (result.of(label),)
    if topic is not None:
        named = [part for part in result.parts if f"/{part.subject.topic}/" in topic]
        return (*named, *result.parts)[:1]
    return result.parts


def _exported(
    sources: Sequence[ExportSource], chosen: str, output: Path | None, overwrite: bool
) -> Iterator[str]:
    """Export subjects: CSV to one table, other formats to one file per subject; yield notes."""
    from posetrack_cli.results.export.export import save_text, text_pieces, tracks_csv_text

    if len(sources) > 1 and chosen == "csv":
        together = tracks_csv_text(sources)
        if output is None:
            for piece in together:
                print_data(piece)
        else:
            save_text(together, sources[0], output, overwrite=overwrite)
            print_line(f"{output}: {chosen}, {output.stat().st_size} bytes")
        return
    if len(sources) > 1 and output is None:
        found = f"{len(sources)} tracks in format {chosen}"
        raise UsageError(
            "standard output holds one track", found=found, hint="choose one with --of, or use -o"
        )
    for source in sources:
        pieces, notes = _OF_SUBJECTS[chosen](source) if chosen in _OF_SUBJECTS else (None, ())
        if output is None:
            for piece in text_pieces(source, chosen) if pieces is None else pieces:
                print_data(piece)
        else:
            label = source.result.subject.label if len(sources) > 1 and chosen != "bids" else ""
            place = output.with_stem(f"{output.stem}-{label}") if label else output
            written, more = _written(source, chosen, place, pieces, overwrite=overwrite)
            notes = (*notes, *more)
            print_line(f"{written}: {chosen}, {written.stat().st_size} bytes")
        yield from notes


def _chosen_format(format_name: str | None, schemas: str | None, output: Path | None) -> str:
    """Return the output format from --format, --schemas or the ending of the output."""
    name, suffix = (output.name.lower(), output.suffix.lower()) if output else ("", "")
    by_name = next((kind for ending, kind in _BY_ENDING.items() if name.endswith(ending)), None)
    chosen = format_name or by_name or ("mcap" if schemas else "csv")
    if suffix and not (format_name or schemas or by_name):
        hint = f"or choose one with --format: {', '.join(FORMATS)}"
        expected = ", ".join(_BY_ENDING)
        raise UsageError("unknown format", where=output, found=suffix, expected=expected, hint=hint)
    if schemas and chosen != "mcap":
        expected = "--format mcap or -o NAME.mcap"
        raise UsageError("--schemas requires MCAP output", found=chosen, expected=expected)
    return "protobuf" if schemas == "protobuf" else chosen


def _session_start_ns(text: str | None, chosen: str) -> int | None:
    """Return --session-start as UNIX time, ns."""
    if text is None:
        return None
    if chosen not in DATED:
        expected = f"--format {' or '.join(DATED)}"
        raise UsageError("--session-start does not apply to this format", found=chosen, expected=expected)
    try:
        since = datetime.fromisoformat(text) - datetime.fromtimestamp(0, UTC)
    except (ValueError, TypeError) as error:  # a TypeError without time zone
        expected = "date, time and zone, e.g. 2026-01-31T10:00:00+01:00"
        raise UsageError("invalid --session-start", found=text, expected=expected) from error
    return since // timedelta(microseconds=1) * 1000


def _written(
    source: ExportSource, chosen: str, output: Path, pieces: Iterable[str] | None, *, overwrite: bool
) -> tuple[Path, tuple[str, ...]]:
    """Write an export, from text pieces if given; return the main file, and notes."""
    from posetrack_cli.results.export.export import export_file, save_text

    if chosen == "bids":
        from posetrack_cli.results.export.bids import write_bids

        return write_bids(source, output, overwrite=overwrite), ()
    if pieces is None:
        return output, export_file(source, chosen, output, overwrite=overwrite)
    save_text(pieces, source, output, overwrite=overwrite)
    return output, ()


# Formats that need what is above the results package in the layers, such as the hand model


Pieces: TypeAlias = tuple[Iterable[str], tuple[str, ...]]
"""Text of an export, and notes for the user."""


def _bvh(source: ExportSource) -> Pieces:
    from posetrack_cli.evaluation.reading.recording_of import anatomy_of
    from posetrack_cli.hand.bvh import bvh_text, check_hand

    check_hand(source, "BVH")
    rate, pieces = bvh_text(source, anatomy_of(source.result))
    return pieces, tuple(rate.notes("they lie between their neighbours"))


def _mediapipe(source: ExportSource) -> Pieces:
    from posetrack_cli.evaluation.reading.recording_of import configuration_of
    from posetrack_cli.hand.bvh import check_hand
    from posetrack_cli.hand.mediapipe import mediapipe_text

    check_hand(source, "mediapipe")
    side = source.result.subject.label or configuration_of(source.result.run).hand.side
    return mediapipe_text(source, "left" if side == "left" else "right"), ()


def _openface(source: ExportSource) -> Pieces:
    from posetrack_cli.head.openface import openface_text

    return openface_text(source), ()


def _arkit(source: ExportSource) -> Pieces:
    from posetrack_cli.head.arkit import arkit_text

    return arkit_text(source), ()


def _blinks(source: ExportSource) -> Pieces:
    from posetrack_cli.head.blinks import blinks_text

    return blinks_text(source), ()


_OF_SUBJECTS: Mapping[str, Callable[[ExportSource], Pieces]] = {
    "bvh": _bvh,
    "mediapipe": _mediapipe,
    "openface": _openface,
    "arkit": _arkit,
    "blinks": _blinks,
}
