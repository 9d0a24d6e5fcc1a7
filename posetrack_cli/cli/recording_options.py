"""Options of every command that reads a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from posetrack_cli.cli.option_group import option_group

recording_options = option_group(
    click.option("--topic", help="MCAP topic of the depth images; found by itself if only one fits."),
    click.option("--camera-topic", help="MCAP topic of the calibration; found by frame id or namespace."),
    click.option(
        "--camera",
        "camera_file",
        type=click.Path(path_type=Path),
        help="camera.toml to use in place of the recording's own calibration.",
    ),
    click.option("--fps", type=float, help="Frame rate of a folder of images, Hz."),
    click.option("--depth-unit-mm", type=float, help="Millimetres per stored unit of a folder's images."),
    click.option("--missing", type=int, help="Stored value of a folder's images that means no reading."),
    click.option("--mirror/--no-mirror", default=None, help="Flip images left to right, or do not."),
)
NAMES = ("topic", "camera_topic", "camera_file", "fps", "depth_unit_mm", "missing", "mirror")


def opening_arguments(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of ``open_recording`` among a command's options."""
    return {name: options.get(name) for name in NAMES}
