"""Options of every command that reads a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from posetrack_cli.cli.option_group import option_group

_CAMERA = click.option(
    "--camera",
    "camera_file",
    type=click.Path(path_type=Path),
    help="camera.toml to use in place of the recording's own calibration.",
)
_MIRROR = click.option("--mirror/--no-mirror", default=None, help="Flip images left to right, or do not.")
_IMAGE_RATE = click.option("--fps", type=float, help="Frame rate of a folder of images or a video, Hz.")

recording_options = option_group(
    click.option("--topic", help="MCAP topic of the depth images; found by itself if only one fits."),
    click.option("--camera-topic", help="MCAP topic of the calibration; found by frame id or namespace."),
    _CAMERA,
    click.option("--fps", type=float, help="Frame rate of a folder of images, Hz."),
    click.option("--depth-unit-mm", type=float, help="Millimetres per stored unit of a folder's images."),
    click.option("--missing", type=int, help="Stored value of a folder's images that means no reading."),
    _MIRROR,
)
image_options = option_group(
    click.option(
        "--cameras",
        metavar="NAME,NAME",
        help="Which of the recording's cameras; of an MCAP file also topics.  [default: all]",
    ),
    _CAMERA,
    _IMAGE_RATE,
    _MIRROR,
    click.option(
        "--tolerance-ms", type=float, help="Largest difference of stamps within a frame.  [default: 10]"
    ),
)
one_camera_options = option_group(
    click.option(
        "--cameras", metavar="NAME", help="Which camera of several; of an MCAP file also its topic."
    ),
    _CAMERA,
    _IMAGE_RATE,
    _MIRROR,
)
NAMES = (
    *("topic", "camera_topic", "cameras", "camera_file", "fps"),
    *("depth_unit_mm", "missing", "mirror", "tolerance_ms"),
)


def reading_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a command's options say of how ``open_recording`` is to read."""
    given = {name: options[name] for name in NAMES if options.get(name) is not None}
    if "cameras" in given:
        given["cameras"] = [name.strip() for name in given["cameras"].split(",")]
    return given
