"""``posetrack info``: list the contents of a recording or result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from json import dumps
from pathlib import Path
from typing import Any

import click

from posetrack_cli.cli.command import Command, option
from posetrack_cli.cli.options import FILE, WRITTEN, json_option, option_group, overwrite_option
from posetrack_cli.cli.terminal import STANDARD_OUTPUT, print_data, print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST, UsageError
from posetrack_cli.text import printable_json

Values = Mapping[str, Any]


@click.command(
    cls=Command,
    examples=("posetrack info recording.mcap", "posetrack info hand.mcap --methods"),
    short_help="List the contents of a recording or result.",
)
@click.argument("path", metavar="FILE", type=FILE)
@option_group(json_option("Write the full report as JSON."), title=WRITTEN)
@overwrite_option("the --json file if it exists")
@option(
    "--methods",
    is_flag=True,
    help="Print a methods paragraph for publications instead: what the run of a result did, the command that "
    "repeats it, and the works to cite.",
)
def info(path: Path, json: Path | None, overwrite: bool, methods: bool) -> None:
    """List the contents of FILE: an image folder, video, recording or result, finished or not.

    Exit code 3: the file is truncated or damaged, and its readable part was listed.
    """
    from posetrack_cli.files import write_output
    from posetrack_cli.outputs import check_target, whole_or_nothing
    from posetrack_cli.recording.opening import describe

    if methods:
        return _print_methods(path, json)
    if json is not None and json != STANDARD_OUTPUT:
        check_target(json, overwrite=overwrite, source=path)
    report = describe(path)
    if json == STANDARD_OUTPUT:
        print_data(_json_text(report))
    else:
        for line in report_lines(report):
            print_line(line)
    if json is not None and json != STANDARD_OUTPUT:
        with whole_or_nothing(json) as part:
            write_output(part, _json_text(report).encode())
    for loss in report["losses"]:
        print_note(f"{path}: {loss['what']}: {loss['count']}, first {loss['first']}")
    if report["losses"]:
        click.get_current_context().exit(EXIT_DATA_LOST)


def _print_methods(path: Path, json: Path | None) -> None:
    from posetrack_cli.evaluation.reports.methods import methods
    from posetrack_cli.results.reader import read_result

    if json is not None:
        raise UsageError("--methods and --json are mutually exclusive", hint="leave one of them out")
    print_data(methods(read_result(path)) + "\n")


def _json_text(report: Values) -> str:
    return printable_json(dumps(report, indent=2, ensure_ascii=False)) + "\n"


def report_lines(report: Values) -> Iterator[str]:
    """Yield a report of ``describe`` as lines of text."""
    # The lines are stable: scripts/digests compares them between versions.
    lines = {
        "folder": _folder_lines,
        "images": _image_lines,
        "video": _video_lines,
        "dataset": _dataset_lines,
    }
    yield from lines.get(report["kind"], _message_lines)(report)


def _folder_lines(report: Values) -> Iterator[str]:
    image = report["image"]
    yield f"{report['name']}: folder of {report['images']} images, {_size(report['bytes'])}"
    yield (
        f"images: {report['first']} to {report['last']}, {image['width']}x{image['height']}, "
        f"{image['bits']} bit, channels {image['channels']}"
    )
    yield f"stamps: {_timing(report['stamps']) if report['stamps'] else report['no_stamps']}"
    for camera in report["cameras"]:
        yield f"camera: {_intrinsics(camera)}"
        yield (
            f"depth: unit {camera['depth_unit_mm']:g} mm, missing {camera['missing']}, "
            f"mirror {'yes' if camera['mirror'] else 'no'}"
        )
    if report["no_camera"]:
        yield f"camera: {report['no_camera']}"
    yield from report["remarks"]
    if "colour" in report:
        yield from _image_lines(report["colour"])


def _image_lines(report: Values) -> Iterator[str]:
    count = sum(folder["images"] for folder in report["folders"])
    yield f"{report['name']}: {count} images of {len(report['folders'])} cameras, {_size(report['bytes'])}"
    for folder in report["folders"]:
        name = f" {folder['name']}" if folder["name"] else ""
        yield (
            f"images{name}: {folder['images']}, {folder['first']} to {folder['last']}, "
            f"{folder['width']}x{folder['height']}, {folder['stored']}"
        )
    if report["frames"]:
        yield f"frames: {report['frames']}, of which {report['incomplete_frames']} lack a camera"
    if report["stamps"] or report["no_stamps"]:
        yield f"stamps: {_timing(report['stamps']) if report['stamps'] else report['no_stamps']}"
    yield from _camera_lines(report)
    yield from report["remarks"]


def _dataset_lines(report: Values) -> Iterator[str]:
    frames = "" if report["frames"] is None else f", {report['frames']} frames"
    yield f"{report['name']}: {report['format']}{frames}, {_size(report['bytes'])}"
    if report["stamps"]:
        yield f"stamps: {_timing(report['stamps'])}"
    yield from _use_lines(report)


def _video_lines(report: Values) -> Iterator[str]:
    image = report["image"]
    yield f"{report['name']}: video, {_size(report['bytes'])}"
    yield (
        f"images: {report['frames']}, {image['width']}x{image['height']}, {report['rate_hz']:.2f} Hz, "
        "as far as the video tells"
    )
    yield from _camera_lines(report)
    yield from report["remarks"]
    if "depth" in report:
        depth = report["depth"]
        yield from (f"depth: {_intrinsics(camera)}" for camera in depth["cameras"])
        if depth["no_camera"]:
            yield f"depth: {depth['no_camera']}"


def _camera_lines(report: Values) -> Iterator[str]:
    for number, camera in enumerate(report["cameras"]):
        place = f", {camera['distance_mm']:.1f} mm from the first" if number else ""
        why = f" ({camera['why']})" if camera["why"] else ""
        yield f"camera {camera['name']}: {_intrinsics(camera)}{place}{why}"
    if report["no_camera"]:
        yield f"camera: {report['no_camera']}"


def _message_lines(report: Values) -> Iterator[str]:
    state = "complete" if report["complete"] else "INCOMPLETE"
    yield f"{report['name']}: {report['container']}, {_size(report['bytes'])}, {state}"
    for loss in report["losses"]:
        yield f"lost: {loss['what']}: {loss['count']}, first {loss['first']}"
    for topic in report["topics"]:
        yield f"topic {topic['topic']}: {_content(topic)}"
        yield f"    {_timing(topic)}"
    for camera in report["cameras"]:
        yield f"camera {camera['topic']}: {camera.get('problem') or _intrinsics(camera)}"
    yield from _use_lines(report)
    yield from _rig_lines(report)
    for record in report["metadata"]:
        yield f"metadata {record['name']}: {record['entries']} entries"
        for key, value in record.get("values", {}).items():
            yield f"    {key}: {value}"
    for attachment in report["attachments"]:
        yield f"attachment {attachment['name']}: {attachment['media_type']}, {_size(attachment['bytes'])}"


def _use_lines(report: Values) -> Iterator[str]:
    """Yield the camera that each command would use, and the reason."""
    for use in report["used"]:
        for camera in use["cameras"]:
            yield f"{use['command']} uses {_intrinsics(camera)} ({camera['why']})"
        yield from (f"{use['command']}: {remark}" for remark in use["remarks"])
        if use["problem"]:
            yield f"{use['command']} cannot read it: {use['problem']}"


def _rig_lines(report: Values) -> Iterator[str]:
    """Yield the extrinsics of the cameras of a message file."""
    if report["no_rig"]:
        yield f"cameras together: {report['no_rig']}"
    if report["rig"]:
        first, *others = report["rig"]
        places = ", ".join(f"{camera['name']} at {camera['distance_mm']:.1f} mm" for camera in others)
        yield f"cameras together: {first['name']} is the reference, {places}"


def _content(topic: Values) -> str:
    parts = [f"{topic['type'] or 'no schema'} ({topic['message_encoding']})"]
    if topic["encoding"] is not None:
        size = f" {topic['width']}x{topic['height']}" if topic["width"] else ""
        parts.append(f"{topic['encoding']}{size}{', depth' if topic['depth'] else ''}")
    if topic["frame_id"]:
        parts.append(f"frame {topic['frame_id']}")
    return ", ".join(parts)


def _timing(values: Values) -> str:
    parts = [f"{values['messages']} messages"]
    if values["duration_s"] is not None:
        parts.append(f"{values['duration_s']:.3f} s")
    if values["rate_hz"] is not None:
        parts.append(f"{values['rate_hz']:.2f} Hz")
        parts.append(f"largest gap {values['largest_gap_s']:.3f} s, {values['gaps']} gaps")
    if values["stamps_not_later"]:
        parts.append(f"{values['stamps_not_later']} stamps doubled or out of order")
    parts += values["remarks"]
    return ", ".join(parts)


def _intrinsics(camera: Values) -> str:
    text = (
        f"{camera['width']}x{camera['height']}, fx {camera['fx']:g} fy {camera['fy']:g} "
        f"cx {camera['cx']:g} cy {camera['cy']:g}"
    )
    if not camera["distortion"]:
        return text + ", no distortion"
    return f"{text}, {camera['distortion_model']} {' '.join(f'{value:g}' for value in camera['distortion'])}"


def _size(count: int) -> str:
    size = float(count)
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.4g} {unit}"
        size /= 1000
    return f"{size:.4g} GB"
