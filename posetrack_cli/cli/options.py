"""Options shared by several commands, their types and the interpretation of their values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from posetrack_cli.cli.command import Function, Option, OptionDecorator, option

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from posetrack_cli.configuration import Settings


# Path of a file or folder, with shell completion
FILE = click.Path(path_type=Path)
FILE_OR_STANDARD_OUTPUT = click.Path(path_type=Path, allow_dash=True)


def option_group(*options: OptionDecorator, title: str = "") -> OptionDecorator:
    """Return a decorator that adds options to a command, in this order.

    Args:
        options: decorators of the single options.
        title: heading in the help, for options that have none yet.
    """

    def add(function: Function) -> Function:
        before = len(getattr(function, "__click_params__", ()))
        for one in reversed(options):  # click reverses the order of decorators
            function = one(function)
        for parameter in getattr(function, "__click_params__", ())[before:]:
            parameter.group = parameter.group or title
        return function

    return add


def options_of(group: OptionDecorator) -> tuple[Option, ...]:
    """Return the options of a group, for commands that are built without a decorated function."""

    def nothing() -> None:
        pass

    # Click collects the options of decorators here, last one first.
    added: list[Option] = getattr(group(nothing), "__click_params__")  # noqa: B009 as click keeps them
    return tuple(reversed(added))


class FiniteRange(click.FloatRange):
    """A finite number within limits; click's own range accepts NaN and infinities."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> float:
        """Return the number.

        Raises:
            click.BadParameter: the value is not a number, not finite or out of range.
        """
        number = float(super().convert(value, parameter, context))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", parameter, context)
        return number


class DeviceIndex(click.IntRange):
    """Index of an EGL device, or ``cpu``."""

    name = "integer or cpu"

    def __init__(self) -> None:
        super().__init__(min=0)

    def _describe_range(self) -> str:
        return ""  # "[x>=0]" in the help would be wrong for cpu

    def convert(  # type: ignore[override]
        self, value: Any, parameter: click.Parameter | None, context: click.Context | None
    ) -> int | str:
        """Return the index, or ``"cpu"``.

        Raises:
            click.BadParameter: the value is neither.
        """
        return "cpu" if value == "cpu" else int(super().convert(value, parameter, context))


class NameOrFile(click.ParamType[str]):
    """A keyword or a file, with shell completion of both.

    Args:
        names: keywords.
    """

    name = "text"

    def __init__(self, *names: str) -> None:
        self._names = names

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the matching keywords, else a request for file completion."""
        from click.shell_completion import CompletionItem

        # Nothing typed yet: a list of keywords would hide the files.
        names = [CompletionItem(name) for name in self._names if incomplete and name.startswith(incomplete)]
        return names or [CompletionItem(incomplete, type="file")]


def only_once(context: click.Context, parameter: click.Parameter, values: tuple[Any, ...]) -> Any:
    """Return the single value of an option with ``multiple=True`` (callback).

    Click would silently use the last value of a plain option.

    Raises:
        click.BadParameter: the option is given several times.
    """
    if len(values) > 1:
        raise click.BadParameter("given more than once", context, parameter)
    return values[0] if values else None


FILTERED, SMOOTHED = "filtered", "smoothed"
# As in ``results.topics``, whose import would slow down --help
TRACKS = (FILTERED, SMOOTHED)
BOTH = "both"


def chosen_tracks(track: str | None) -> tuple[str, ...]:
    """Return the tracks selected by a --track value; the filtered one if None."""
    return TRACKS if track == BOTH else (track or FILTERED,)


# Shared options. An option has the same meaning in every command (a test checks this); the help may add
# details for one command.


WRITTEN = "Output"
READ = "Recording"
CONFIGURATION = "Configuration"


def output_option(text: str, metavar: str = "FILE", *, required: bool = True) -> OptionDecorator:
    """Return -o with this help."""
    return option(
        "-o",
        "--output",
        metavar=metavar,
        required=required,
        type=FILE,
        help=text,
        meaning="Output file or folder",
        group=WRITTEN,
    )


def overwrite_option(what: str, group: str = WRITTEN) -> OptionDecorator:
    """Return --overwrite.

    Args:
        what: files and condition, such as ``"OUT.mcap if it exists"``.
        group: heading in the help.
    """
    text = f"Overwrite {what}."
    return option("--overwrite", is_flag=True, help=text, meaning="Overwrite existing output", group=group)


smooth_option = option("--smooth", is_flag=True, help="Also write a smoothed track.", group=WRITTEN)


def seed_option(text: str = "Random seed.") -> OptionDecorator:
    """Return --seed with this help."""
    return option(
        "--seed",
        type=click.IntRange(min=0),
        metavar="N",
        default=0,
        show_default=True,
        help=text,
        meaning="Random seed",
    )


def fps_option(text: str, default: float | None = None) -> OptionDecorator:
    """Return --fps with this help, for a recording that is read or generated."""
    return option(
        "--fps",
        metavar="HZ",
        type=float,
        default=default,
        show_default=default is not None,
        help=text,
        meaning="Frame rate of the recording",
    )


def particles_option(default: int | str) -> OptionDecorator:
    """Return --particles; ``default`` is only shown, the value comes from the configuration or command."""
    return option(
        "--particles",
        metavar="N",
        type=click.IntRange(min=1),
        help=f"Number of particles.  [default: {default}]",
        rare=True,
    )


def track_option(*choices: str, default: str | None, text: str) -> OptionDecorator:
    """Return --track with this help, for commands that read results."""
    return option(
        "--track",
        type=click.Choice(choices),
        default=default,
        show_default=default is not None,
        help=text,
        meaning="Track of the result to use",
    )


def of_option(verb: str) -> OptionDecorator:
    """Return --of with a verb in its help, for commands that read results."""
    return option(
        "--of",
        metavar="NAME",
        help=f"Name of the head or hand to {verb}, for results of several, e.g. 1 or left.  [default: all]",
        meaning="Name of a head or hand in a result of several",
    )


def truth_option(text: str) -> OptionDecorator:
    """Return --truth (a file) with this help."""
    return option("--truth", metavar="FILE", type=FILE, help=text, meaning="Ground truth file")


def recording_option(text: str) -> OptionDecorator:
    """Return --recording with this help, for commands that read results."""
    meaning = "Recording that the result was tracked in"
    return option("--recording", metavar="PATH", type=FILE, help=text, meaning=meaning, group=READ)


def device_option(text: str) -> OptionDecorator:
    """Return --device with this help."""
    return option(
        "--device",
        metavar="N|cpu",
        type=DeviceIndex(),
        help=text,
        meaning="Rendering device: EGL device number or cpu",
        rare=True,
    )


def hand_side_option(*choices: str, text: str, default: str | None = None) -> OptionDecorator:
    """Return --hand-side with this help."""
    return option(
        "--hand-side",
        "side",
        type=click.Choice(choices),
        default=default,
        show_default=default is not None,
        help=text,
        meaning="Left or right hand",
    )


scale_option = option(
    "--scale",
    metavar="FACTOR",
    type=float,
    help="Hand size; 1 is the average adult hand (179 mm).",
    meaning="Hand size",
    rare=True,
)
hand_mesh_option = option(
    "--hand-mesh",
    "mesh",
    metavar="FILE.glb",
    type=NameOrFile(),
    help="Hand mesh to use instead of the average hand: skinned glTF with WebXR joint names.",
    rare=True,
)


def init_option(metavar: str, text: str, default: str | None = None) -> OptionDecorator:
    """Return --init with this help; the lower-case words of ``metavar`` are its keywords."""
    names = [name for name in metavar.split("|") if name.islower()]
    return option(
        "--init",
        metavar=metavar,
        type=NameOrFile(*names),
        default=default,
        show_default=default is not None,
        help=text,
        meaning="Initialisation of the track",
        rare=True,
    )


def frames_option(default: int, text: str) -> OptionDecorator:
    """Return --frames with this help, for commands that generate recordings."""
    meaning = "Number of frames"
    return option("--frames", metavar="N", default=default, show_default=True, help=text, meaning=meaning)


def motion_option(*choices: str, default: str, text: str) -> OptionDecorator:
    """Return --motion with this help, for commands that generate recordings."""
    return option(
        "--motion",
        type=click.Choice(choices, case_sensitive=False),
        metavar=f"[{'|'.join(choices)}]",  # click would show the choices in lower case
        default=default,
        show_default=True,
        help=text,
        meaning="Type of motion",
    )


def speed_option(text: str) -> OptionDecorator:
    """Return --speed with this help, for commands that generate recordings."""
    meaning = "Speed of the motion, a factor"
    return option("--speed", metavar="FACTOR", default=1.0, show_default=True, help=text, meaning=meaning)


def json_option(text: str) -> OptionDecorator:
    """Return --json with this help."""
    meaning = "Write the full report as JSON"
    return option("--json", type=FILE_OR_STANDARD_OUTPUT, metavar="FILE|-", help=text, meaning=meaning)


def cameras_option(text: str, group: str = READ) -> OptionDecorator:
    """Return --cameras with this help."""
    meaning = "Cameras of the recording to use"
    return option("--cameras", metavar="NAME,...", help=text, meaning=meaning, group=group)


_CAMERA = option(
    "--camera",
    "camera_file",
    metavar="FILE.toml|NAME",
    type=FILE,
    help="Camera file, or name of a nominal camera; replaces the recording's calibration.",
)
_MIRROR = option(
    "--mirror/--no-mirror",
    default=None,
    help="Flip the images horizontally, or not; overrides the camera file.",
    rare=True,
)

tolerance_option = option(
    "--tolerance-ms",
    metavar="MS",
    type=float,
    help="Maximum difference between the timestamps of a frame's images.  [default: 10]",
    rare=True,
)

recording_options = option_group(
    option("--topic", metavar="TOPIC", help="Topic of the depth images.  [default: best match]"),
    option(
        "--camera-topic",
        metavar="TOPIC",
        help="Topic of the camera calibration.  [default: by frame id or namespace]",
        rare=True,
    ),
    _CAMERA,
    fps_option("Frame rate of an image folder without timestamps."),
    option(
        "--depth-unit-mm",
        metavar="MM",
        type=float,
        help="Millimetres per stored depth unit.  [default: mm for integers, m for floats, unless the "
        "images show otherwise]",
        rare=True,
    ),
    option(
        "--missing",
        metavar="N",
        type=int,
        help="Stored integer for missing readings, in addition to 0.",
        rare=True,
    ),
    _MIRROR,
    title=READ,
)
image_options = option_group(
    cameras_option("Cameras to use, reference first; for MCAP files also topics.  [default: all]"),
    _CAMERA,
    fps_option("Frame rate of an image folder or video without timestamps."),
    _MIRROR,
    tolerance_option,
    title=READ,
)
one_camera_options = option_group(
    cameras_option("Camera to use if there are several; for MCAP files also a topic."),
    _CAMERA,
    fps_option("Frame rate of an image folder or video without timestamps."),
    _MIRROR,
    title=READ,
)
NAMES = (
    *("topic", "camera_topic", "cameras", "camera_file", "fps"),
    *("depth_unit_mm", "missing", "mirror", "tolerance_ms"),
)


def reading_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments for ``open_recording`` from a command's options."""
    given = {name: options[name] for name in NAMES if options.get(name) is not None}
    if "cameras" in given:
        given["cameras"] = camera_names(given["cameras"])
    return given


def camera_names(text: str) -> list[str]:
    """Split the value of --cameras."""
    return [name.strip() for name in text.split(",")]


gate_options = option_group(
    option(
        "--fail-if",
        "conditions",
        metavar="CONDITION",
        multiple=True,
        help="Fail if the condition holds for a result, e.g. 'joint_error_mm.mean > 10' or "
        "'coverage < 0.99'; for the pooled frames of all results, 'pooled.joint_error_mm.mean > 8'; or for "
        "a statistic over results, 'p95(joint_error_mm.mean) > 12'. Repeatable.",
    ),
    option(
        "--gates",
        "gate_files",
        metavar="FILE",
        type=FILE,
        multiple=True,
        help="File of --fail-if conditions, one per line. Repeatable.",
    ),
    option(
        "--baseline",
        metavar="FILE.json",
        type=FILE,
        multiple=True,
        callback=only_once,
        help="Report to compare with: --json of eval or summary.json of a batch. Metrics that got worse, per "
        "result or pooled, fail, and so do missing results; new results are listed.",
    ),
    option(
        "--baseline-tolerance",
        metavar="SHARE",
        type=FiniteRange(min=0.0),
        default=0.05,
        show_default=True,
        help="Allowed deterioration: relative for errors, absolute for coverage.",
        rare=True,
    ),
    title="Gates",
)


def junit_option(text: str) -> OptionDecorator:
    """Return --junit with this help."""
    meaning = "Write the gates as JUnit XML"
    return option("--junit", type=FILE, metavar="FILE", help=text, meaning=meaning)


def markdown_option() -> OptionDecorator:
    """Return --markdown."""
    return option(
        "--markdown",
        type=FILE_OR_STANDARD_OUTPUT,
        metavar="FILE|-",
        help="Write a Markdown summary: failed gates, totals, results and changes against the baseline.",
    )


Config = TypeVar("Config", bound="Settings")

# Options that are also fields of ``tracking.options.RunOptions``
RUN_OPTIONS = ("output", "seed", "start", "end", "stride", "resume", "overwrite", "timings")


def config_option(shipped: str) -> OptionDecorator:
    """Return --config; the help lists the shipped configurations."""
    return option(
        "--config",
        "configs",
        metavar="FILE|NAME",
        type=NameOrFile(),
        multiple=True,
        help=f"Configuration: a TOML file or one of {shipped}. Repeatable; later ones override.",
        meaning="Configuration: a TOML file or the name of a shipped one",
    )


def configuration_options(shipped: str, example: str) -> OptionDecorator:
    """Return a decorator that adds --config, --set and --seed.

    Args:
        shipped: names of the shipped configurations, for the help.
        example: an assignment, for the help.
    """
    return option_group(
        config_option(shipped),
        option(
            "--set",
            "settings",
            metavar="KEY=VALUE",
            multiple=True,
            help=f"Set a configuration key, e.g. {example}. Repeatable.",
            meaning="Set a configuration key",
        ),
        seed_option(),
        title=CONFIGURATION,
    )


# Defaults are part of the text where click would add the range to them.
frame_options = option_group(
    option("--start", metavar="N", type=click.IntRange(min=0), default=0, help="First frame.  [default: 0]"),
    option(
        "--end",
        metavar="N",
        type=click.IntRange(min=1),
        help="End frame, exclusive.  [default: all frames]",
    ),
    option(
        "--stride",
        metavar="N",
        type=click.IntRange(min=1),
        default=1,
        help="Track every N-th frame.  [default: 1]",
        rare=True,
    ),
    title="Frames",
)


def result_options(replaced: str) -> OptionDecorator:
    """Return a decorator that adds -o, --smooth, --timings, --resume and --overwrite.

    Args:
        replaced: for ``overwrite_option``.
    """
    return option_group(
        output_option("Output file (MCAP).", "RESULT.mcap"),
        smooth_option,
        option(
            "--timings",
            is_flag=True,
            help="Also write run times per frame; the output is then not reproducible to the byte.",
            rare=True,
        ),
        option("--resume", is_flag=True, help="Continue an interrupted run."),
        overwrite_option(replaced),
        title=WRITTEN,
    )


def configuration_of(kind: type[Config], options: Mapping[str, Any], configured: Mapping[str, str]) -> Config:
    """Return the configuration; precedence: defaults < --config < --set < options.

    Args:
        kind: class of the configuration.
        options: values of the command's options.
        configured: configuration key by option name, for options that set a key.

    Raises:
        UsageError: an unknown key or an invalid value.
    """
    from posetrack_cli.configuration import find_configuration, load_settings, parse_assignments

    files = [find_configuration(name) for name in options["configs"]]
    # Options that set a key have no default of their own, so None means that they are not given.
    own = {key: options[name] for name, key in configured.items() if options[name] is not None}
    return load_settings(kind, files, parse_assignments(options["settings"]) | own)
