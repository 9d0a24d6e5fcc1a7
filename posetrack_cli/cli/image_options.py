"""Options of every command that reads grey images of one or more cameras."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])

OPTIONS = (
    click.option(
        "--cameras",
        metavar="NAME,NAME",
        help="Which of the recording's cameras; of an MCAP file also topics.  [default: all]",
    ),
    click.option(
        "--camera",
        "camera_file",
        type=click.Path(path_type=Path),
        help="camera.toml to use in place of the recording's own calibration.",
    ),
    click.option("--fps", type=float, help="Frame rate of a folder of images or a video, Hz."),
    click.option("--mirror/--no-mirror", default=None, help="Flip images left to right, or do not."),
    click.option(
        "--tolerance-ms", type=float, help="Largest difference of stamps within a frame.  [default: 10]"
    ),
)
NAMES = ("camera_file", "fps", "mirror", "tolerance_ms")


def image_options(command: Command) -> Command:
    """Add the options to a command; its function receives them as keyword arguments."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


def image_arguments(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of ``open_images`` among a command's options."""
    names = options["cameras"]
    cameras = None if names is None else [name.strip() for name in names.split(",")]
    return {name: options[name] for name in NAMES} | {"cameras": cameras}
