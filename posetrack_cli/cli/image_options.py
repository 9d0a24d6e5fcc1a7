"""Options of every command that reads grey images of one or more cameras."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from posetrack_cli.cli.option_group import option_group

_READING = (
    click.option(
        "--camera",
        "camera_file",
        type=click.Path(path_type=Path),
        help="camera.toml to use in place of the recording's own calibration.",
    ),
    click.option("--fps", type=float, help="Frame rate of a folder of images or a video, Hz."),
    click.option("--mirror/--no-mirror", default=None, help="Flip images left to right, or do not."),
)
NAMES = ("camera_file", "fps", "mirror", "tolerance_ms")

image_options = option_group(
    click.option(
        "--cameras",
        metavar="NAME,NAME",
        help="Which of the recording's cameras; of an MCAP file also topics.  [default: all]",
    ),
    *_READING,
    click.option(
        "--tolerance-ms", type=float, help="Largest difference of stamps within a frame.  [default: 10]"
    ),
)
one_camera_options = option_group(
    click.option(
        "--cameras", metavar="NAME", help="Which camera of several; of an MCAP file also its topic."
    ),
    *_READING,
)


def image_arguments(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of ``open_images`` among a command's options."""
    names = options["cameras"]
    cameras = None if names is None else [name.strip() for name in names.split(",")]
    return {name: options.get(name) for name in NAMES} | {"cameras": cameras}
