"""Options that several commands share, their types, and what their values mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from posetrack_cli.configuration import Settings


Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Any], Any]


def option_group(*options: Option) -> Callable[[Command], Command]:
    """Return what adds options to a command, in this order; its function gets them as keyword arguments."""

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


class FiniteRange(click.FloatRange):
    """A number within limits; unlike click's own range it takes neither NaN nor an infinity."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> float:
        """Return the number.

        Raises:
            click.BadParameter: it is none, not finite, or out of range.
        """
        number = float(super().convert(value, parameter, context))
        if not math.isfinite(number):
            self.fail(f"{value} is no finite number.", parameter, context)
        return number


class DrawingDevice(click.IntRange):
    """The index of an EGL device, or ``cpu``."""

    name = "index|cpu"

    def __init__(self) -> None:
        super().__init__(min=0)

    def convert(  # type: ignore[override]
        self, value: Any, parameter: click.Parameter | None, context: click.Context | None
    ) -> int | str:
        """Return the index, or ``cpu`` as it is.

        Raises:
            click.BadParameter: it is neither.
        """
        return "cpu" if value == "cpu" else int(super().convert(value, parameter, context))


smooth_option = option_group(
    click.option("--smooth", is_flag=True, help="Also write a track smoothed over the whole recording.")
)


def only_once(context: click.Context, parameter: click.Parameter, values: tuple[Any, ...]) -> Any:
    """Callback of an option with ``multiple=True`` that may be given once: a second one is not passed over.

    Raises:
        click.BadParameter: it is given several times.
    """
    if len(values) > 1:
        raise click.BadParameter("given more than once", context, parameter)
    return values[0] if values else None


FILTERED, SMOOTHED = "filtered", "smoothed"
TRACKS = (FILTERED, SMOOTHED)
"""As ``results.tracks`` has them, which would take long to load for the help."""
BOTH = "both"


def chosen_tracks(track: str | None) -> tuple[str, ...]:
    """Return the tracks that an option's value names, the filtered one for none."""
    return TRACKS if track == BOTH else (track or FILTERED,)


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


Config = TypeVar("Config", bound="Settings")

RUN_OPTIONS = ("output", "seed", "start", "end", "stride", "resume", "overwrite", "timings")
"""Names of those that ``tracking.options.RunOptions`` has, too."""


def result_options(shipped: str, example: str) -> Callable[[Command], Command]:
    """Return what adds --output, --config and --set to a command.

    Args:
        shipped: the configurations that are shipped for it, in words.
        example: of an assignment.
    """
    return option_group(
        click.option(
            "-o", "--output", required=True, type=click.Path(path_type=Path), help="Result to write, MCAP."
        ),
        click.option(
            "--config",
            "configs",
            multiple=True,
            help=f"TOML file, or a shipped name: {shipped}; repeatable, later ones override.",
        ),
        click.option(
            "--set",
            "settings",
            metavar="KEY=VALUE",
            multiple=True,
            help=f"Set any key of the configuration, such as {example}; repeatable.",
        ),
    )


frame_options = option_group(
    click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Random seed."),
    click.option("--start", type=click.IntRange(min=0), default=0, help="First frame."),
    click.option("--end", type=click.IntRange(min=1), help="Frame to stop before."),
    click.option("--stride", type=click.IntRange(min=1), default=1, help="Track every so many frames."),
)


def finishing_options(replaced: str) -> Callable[[Command], Command]:
    """Return what adds --resume, --overwrite and --timings to a command.

    Args:
        replaced: what --overwrite replaces, in words.
    """
    return option_group(
        click.option("--resume", is_flag=True, help="Go on with an interrupted run."),
        click.option("--overwrite", is_flag=True, help=f"Replace {replaced}."),
        click.option(
            "--timings",
            is_flag=True,
            help="Write each frame's milliseconds (bytes then differ from run to run).",
        ),
    )


def configuration_of(kind: type[Config], options: Mapping[str, Any], configured: Mapping[str, str]) -> Config:
    """Return the configuration: defaults < --config < --set < options.

    Args:
        kind: of configuration.
        options: of the command.
        configured: configuration key of each option that stands for one.

    Raises:
        UsageError: what cannot be meant.
    """
    from posetrack_cli.configuration import find_configuration, load_settings, parse_assignments

    files = [find_configuration(name) for name in options["configs"]]
    own = {key: options[name] for name, key in configured.items() if options[name] is not None}
    return load_settings(kind, files, parse_assignments(options["settings"]) | own)
