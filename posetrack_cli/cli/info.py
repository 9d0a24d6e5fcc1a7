"""``posetrack info``: tell what a recording or a result holds."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from posetrack_cli.errors import EXIT_DATA_LOST

Values = Mapping[str, Any]


@click.command(short_help="Tell what a recording or a result holds.")
@click.argument("path", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the same as JSON.")
def info(path: Path, as_json: bool) -> None:
    """Tell what FILE holds: a folder of images, a recording or a result, also an unfinished one.

    Exit code 3 means that the file is truncated or damaged; what can be read is listed all the same.
    """
    from posetrack_cli.recording.inspection import describe

    report = describe(path)
    lines = [json.dumps(report, indent=2, ensure_ascii=False)] if as_json else report_lines(report)
    for line in lines:
        click.echo(line)
    for loss in report["losses"]:
        click.echo(f"{path}: {loss['what']}: {loss['count']}, first {loss['first']}", err=True)
    if report["losses"]:
        click.get_current_context().exit(EXIT_DATA_LOST)


def report_lines(report: Values) -> Iterator[str]:
    """Yield the lines that tell a report of ``describe`` to people."""
    yield from _folder_lines(report) if report["kind"] == "folder" else _mcap_lines(report)


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


def _mcap_lines(report: Values) -> Iterator[str]:
    state = "complete" if report["complete"] else "INCOMPLETE"
    yield f"{report['name']}: MCAP, {_size(report['bytes'])}, {state}"
    for loss in report["losses"]:
        yield f"lost: {loss['what']}: {loss['count']}, first {loss['first']}"
    for topic in report["topics"]:
        yield f"topic {topic['topic']}: {_content(topic)}"
        yield f"    {_timing(topic)}"
    for camera in report["cameras"]:
        yield f"camera {camera['topic']}: {camera.get('problem') or _intrinsics(camera)}"
    for record in report["metadata"]:
        yield f"metadata {record['name']}: {record['entries']} entries"
        for key, value in record.get("values", {}).items():
            yield f"    {key}: {value}"
    for attachment in report["attachments"]:
        yield f"attachment {attachment['name']}: {attachment['media_type']}, {_size(attachment['bytes'])}"


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
