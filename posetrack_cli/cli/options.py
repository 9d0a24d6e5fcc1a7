"""Options that several commands share, their types, and what their values mean."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from posetrack_cli.cli.command import Adding, Function, Option, option

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from posetrack_cli.configuration import Settings


FILE = click.Path(path_type=Path)
"""A path, of a file or folder; the shell completes it."""
FILE_OR_STANDARD_OUTPUT = click.Path(path_type=Path, allow_dash=True)


def option_group(*options: Adding, title: str = "") -> Adding:
    """Return what adds options to a command, in this order; its function gets them as keyword arguments.

    Args:
        options: of the group.
        title: their heading in the help, of those that have none yet.
    """

    def add(function: Function) -> Function:
        before = len(getattr(function, "__click_params__", ()))
        for one in reversed(options):
            function = one(function)
        for parameter in getattr(function, "__click_params__", ())[before:]:
            parameter.group = parameter.group or title
        return function

    return add


def options_of(group: Adding) -> tuple[Option, ...]:
    """Return the options of a group, for a command that is made without a function of its own."""

    def nothing() -> None:
        pass

    added: list[Option] = getattr(group(nothing), "__click_params__")  # noqa: B009 as click keeps them
    return tuple(reversed(added))


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

    name = "integer or cpu"

    def __init__(self) -> None:
        super().__init__(min=0)

    def _describe_range(self) -> str:
        return ""  # the help says what it is

    def convert(  # type: ignore[override]
        self, value: Any, parameter: click.Parameter | None, context: click.Context | None
    ) -> int | str:
        """Return the index, or ``cpu`` as it is.

        Raises:
            click.BadParameter: it is neither.
        """
        return "cpu" if value == "cpu" else int(super().convert(value, parameter, context))


class NameOrFile(click.ParamType[str]):
    """One of some names, or a file; the shell completes both.

    Args:
        names: that are no files.
    """

    name = "text"

    def __init__(self, *names: str) -> None:
        self._names = names

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the names that begin so, and that files are to be completed."""
        from click.shell_completion import CompletionItem

        names = [CompletionItem(name) for name in self._names if incomplete and name.startswith(incomplete)]
        return names or [CompletionItem(incomplete, type="file")]


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
"""As ``results.channels`` has them, which would take long to load for the help."""
BOTH = "both"


def chosen_tracks(track: str | None) -> tuple[str, ...]:
    """Return the tracks that an option's value names, the filtered one for none."""
    return TRACKS if track == BOTH else (track or FILTERED,)


# What several commands have is declared here, once: the first sentence of its help is what it means
# everywhere (a test compares), the rest what is particular to a command.


WRITTEN = "Output"
READ = "Recording"
CONFIGURATION = "Configuration"


def _told(meaning: str, details: str) -> str:
    """What an option means, and what is particular to a command; a default stands a little apart."""
    return f"{meaning}{'  ' if details.startswith('[') else ' '}{details}".strip()


def output_option(what: str, metavar: str = "FILE", *, required: bool = True) -> Adding:
    """Return -o of a command, told in words what it writes."""
    return option(
        "-o",
        "--output",
        metavar=metavar,
        required=required,
        type=FILE,
        help=f"Where to write. {what}",
        group=WRITTEN,
    )


def overwrite_option(what: str, group: str = WRITTEN) -> Adding:
    """Return --overwrite of a command, told in words what it replaces."""
    return option("--overwrite", is_flag=True, help=f"Replace existing files. {what}.", group=group)


smooth_option = option("--smooth", is_flag=True, help="Also write a smoothed track.", group=WRITTEN)


def seed_option(details: str = "") -> Adding:
    """Return --seed."""
    return option(
        "--seed",
        type=click.IntRange(min=0),
        metavar="N",
        default=0,
        show_default=True,
        help=_told("Random seed.", details),
    )


def fps_option(details: str, default: float | None = None) -> Adding:
    """Return --fps, of a recording that is read or made."""
    return option(
        "--fps",
        metavar="HZ",
        type=float,
        default=default,
        show_default=default is not None,
        help=_told("Frame rate of the recording.", details),
    )


def particles_option(default: int | str) -> Adding:
    """Return --particles, whose default, as help states it, is in the configuration, or the command's own."""
    return option(
        "--particles",
        metavar="N",
        type=click.IntRange(min=1),
        help=f"Number of particles.  [default: {default}]",
        rare=True,
    )


def track_option(*choices: str, default: str | None, details: str = "") -> Adding:
    """Return --track of a command that reads results."""
    return option(
        "--track",
        type=click.Choice(choices),
        default=default,
        show_default=default is not None,
        help=_told("Which track of the result.", details),
    )


def truth_option(details: str) -> Adding:
    """Return --truth, a file."""
    return option("--truth", metavar="FILE", type=FILE, help=_told("File with the truth.", details))


def recording_option(details: str) -> Adding:
    """Return --recording of a command that reads results."""
    return option(
        "--recording",
        metavar="PATH",
        type=FILE,
        help=_told("The recording of the result.", details),
        group=READ,
    )


def device_option(details: str) -> Adding:
    """Return --device, what draws."""
    return option(
        "--device",
        metavar="N|cpu",
        type=DrawingDevice(),
        help=_told("What draws. The number of an EGL device, or cpu.", details),
        rare=True,
    )


def hand_side_option(*choices: str, details: str, default: str | None = None) -> Adding:
    """Return --hand-side."""
    return option(
        "--hand-side",
        "side",
        type=click.Choice(choices),
        default=default,
        show_default=default is not None,
        help=_told("Which hand.", details),
    )


scale_option = option(
    "--scale",
    metavar="FACTOR",
    type=float,
    help="Size of the hand. 1 is the average adult's, 179 mm long.",
    rare=True,
)
hand_mesh_option = option(
    "--hand-mesh",
    "mesh",
    metavar="FILE.glb",
    type=NameOrFile(),
    help="Hand in place of the average one. Skinned, glTF with WebXR joint names.",
    rare=True,
)


def init_option(metavar: str, details: str, default: str | None = None) -> Adding:
    """Return --init."""
    names = [name for name in metavar.split("|") if name.islower()]
    return option(
        "--init",
        metavar=metavar,
        type=NameOrFile(*names),
        default=default,
        show_default=default is not None,
        help=_told("How the track begins.", details),
        rare=True,
    )


def frames_option(default: int, details: str) -> Adding:
    """Return --frames of a command that makes recordings."""
    return option(
        "--frames", metavar="N", default=default, show_default=True, help=_told("Number of frames.", details)
    )


def motion_option(*choices: str, default: str, details: str) -> Adding:
    """Return --motion of a command that makes recordings."""
    return option(
        "--motion",
        type=click.Choice(choices, case_sensitive=False),
        metavar=f"[{'|'.join(choices)}]",  # click would show the choices in lower case
        default=default,
        show_default=True,
        help=_told("How it moves.", details),
    )


def speed_option(details: str) -> Adding:
    """Return --speed of a command that makes recordings."""
    return option(
        "--speed",
        metavar="FACTOR",
        default=1.0,
        show_default=True,
        help=_told("How fast it moves, a factor.", details),
    )


def json_option(details: str = "") -> Adding:
    """Return --json of a command that reports."""
    return option(
        "--json",
        type=FILE_OR_STANDARD_OUTPUT,
        metavar="FILE|-",
        help=_told("Write everything as JSON.", details),
    )


def cameras_option(details: str, group: str = READ) -> Adding:
    """Return --cameras, which of a recording's cameras."""
    return option(
        "--cameras", metavar="NAME,...", help=_told("Which of the recording's cameras.", details), group=group
    )


_CAMERA = option(
    "--camera",
    "camera_file",
    metavar="FILE.toml|NAME",
    type=FILE,
    help="Camera file to use in place of the recording's own calibration, or the name of a nominal camera.",
)
_MIRROR = option(
    "--mirror/--no-mirror", default=None, help="Flip images left to right, or do not.", rare=True
)

recording_options = option_group(
    option("--topic", metavar="TOPIC", help="Topic of the depth images.  [default: the likeliest]"),
    option(
        "--camera-topic",
        metavar="TOPIC",
        help="Topic of the calibration.  [default: by frame id or namespace]",
        rare=True,
    ),
    _CAMERA,
    fps_option("Of a folder of images, which may not tell it."),
    option(
        "--depth-unit-mm",
        metavar="MM",
        type=float,
        help="Millimetres per stored unit of depth.  [default: by what the images hold; integers are mm, "
        "floats m]",
        rare=True,
    ),
    option(
        "--missing",
        metavar="N",
        type=int,
        help="Stored integer that means no reading; 0 always does.",
        rare=True,
    ),
    _MIRROR,
    title=READ,
)
image_options = option_group(
    cameras_option("The reference first; of an MCAP file also topics.  [default: all]"),
    _CAMERA,
    fps_option("Of a folder of images or a video, which may not tell it."),
    _MIRROR,
    option(
        "--tolerance-ms",
        metavar="MS",
        type=float,
        help="Largest difference of stamps within a frame.  [default: 10]",
        rare=True,
    ),
    title=READ,
)
one_camera_options = option_group(
    cameras_option("One of several; of an MCAP file also its topic."),
    _CAMERA,
    fps_option("Of a folder of images or a video, which may not tell it."),
    _MIRROR,
    title=READ,
)
NAMES = (
    *("topic", "camera_topic", "cameras", "camera_file", "fps"),
    *("depth_unit_mm", "missing", "mirror", "tolerance_ms"),
)


def reading_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a command's options say of how ``open_recording`` is to read."""
    given = {name: options[name] for name in NAMES if options.get(name) is not None}
    if "cameras" in given:
        given["cameras"] = camera_names(given["cameras"])
    return given


def camera_names(text: str) -> list[str]:
    """Return the names that --cameras gives."""
    return [name.strip() for name in text.split(",")]


gate_options = option_group(
    option(
        "--fail-if",
        "conditions",
        metavar="CONDITION",
        multiple=True,
        help="Gate on each result, such as 'joint_error_mm.mean > 10' or 'coverage < 0.99'; on the frames of "
        "all together, 'pooled.joint_error_mm.mean > 8'; or on the figures over results, "
        "'p95(joint_error_mm.mean) > 12', 'count(coverage) < 100'; repeatable.",
    ),
    option(
        "--gates",
        "gate_files",
        metavar="FILE",
        type=FILE,
        multiple=True,
        help="File of gates, one a line; repeatable.",
    ),
    option(
        "--baseline",
        metavar="FILE.json",
        type=FILE,
        multiple=True,
        callback=only_once,
        help="Earlier --json of eval, or summary.json of a batch; worse figures fail, of each result of the "
        "same name and of all together. Results that only the baseline has fail, new ones are told.",
    ),
    option(
        "--baseline-tolerance",
        metavar="SHARE",
        type=FiniteRange(min=0.0),
        default=0.05,
        show_default=True,
        help="How much worse may pass: a share of an error, an absolute difference of a coverage.",
        rare=True,
    ),
    title="Gates",
)


def junit_option(details: str) -> Adding:
    """Return --junit."""
    return option("--junit", type=FILE, metavar="FILE", help=_told("Write the gates as JUnit XML.", details))


def markdown_option() -> Adding:
    """Return --markdown."""
    return option(
        "--markdown",
        type=FILE_OR_STANDARD_OUTPUT,
        metavar="FILE|-",
        help="Write a summary as Markdown: failed gates first, totals, results, changes against the "
        "baseline.",
    )


Config = TypeVar("Config", bound="Settings")

RUN_OPTIONS = ("output", "seed", "start", "end", "stride", "resume", "overwrite", "timings")
"""Names of those that ``tracking.options.RunOptions`` has, too."""


def config_option(shipped: str) -> Adding:
    """Return --config, told in words which configurations are shipped for a command."""
    return option(
        "--config",
        "configs",
        metavar="FILE|NAME",
        type=NameOrFile(),
        multiple=True,
        help=f"Configuration, a TOML file or a shipped one. {shipped}; repeatable, later ones override.",
    )


def configuration_options(shipped: str, example: str) -> Adding:
    """Return what adds --config, --set and --seed to a command.

    Args:
        shipped: the configurations that are shipped for it, in words.
        example: of an assignment.
    """
    return option_group(
        config_option(f"Shipped: {shipped}"),
        option(
            "--set",
            "settings",
            metavar="KEY=VALUE",
            multiple=True,
            help=f"Set any key of the configuration. Such as {example}; repeatable.",
        ),
        seed_option(),
        title=CONFIGURATION,
    )


frame_options = option_group(
    option("--start", metavar="N", type=click.IntRange(min=0), default=0, help="First frame.  [default: 0]"),
    option(
        "--end",
        metavar="N",
        type=click.IntRange(min=1),
        help="Frame to stop before.  [default: behind the last]",
    ),
    option(
        "--stride",
        metavar="N",
        type=click.IntRange(min=1),
        default=1,
        help="Track every so many frames.  [default: 1]",
        rare=True,
    ),
    title="Frames",
)


def result_options(replaced: str) -> Adding:
    """Return what adds -o, --smooth, --timings, --resume and --overwrite to a command.

    Args:
        replaced: what --overwrite replaces, in words.
    """
    return option_group(
        output_option("The result, an MCAP file.", "RESULT.mcap"),
        smooth_option,
        option(
            "--timings",
            is_flag=True,
            help="Write each frame's milliseconds (bytes then differ from run to run).",
            rare=True,
        ),
        option("--resume", is_flag=True, help="Go on with an interrupted run."),
        overwrite_option(replaced),
        title=WRITTEN,
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
