"""``hand synth`` and ``head synth``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    WRITTEN,
    fps_option,
    frames_option,
    hand_mesh_option,
    hand_side_option,
    motion_option,
    option_group,
    output_option,
    overwrite_option,
    scale_option,
    seed_option,
    speed_option,
)
from posetrack_cli.cli.running import tell_next
from posetrack_cli.cli.terminal import bar, print_line
from posetrack_cli.errors import UsageError

# ``posetrack hand synth``: make a recording of a moving hand whose truth is known


SWITCHES = (
    ("noise", "Depth noise, and no readings outside 0.5 to 4.5 m."),
    ("edges", "Missing readings at depth edges."),
    ("background", "A room behind the hand."),
    ("body", "Trunk and head behind the hand."),
    ("forearm", "The forearm behind the wrist."),
    ("drops", "Missing frames."),
    ("late", "Late frames."),
)
FINGERS = (("lengths", "the fingers' lengths, thumb first"), ("widths", "the fingers' radii, thumb first"))
PALM = (
    ("width", "from side to side"),
    ("length", "from wrist to knuckles"),
    ("thickness", "from back to front"),
)
SHAPE = (
    "scale",
    *(f"finger_{name}" for name, _ in FINGERS),
    *(f"palm_{name}" for name, _ in PALM),
    "wrist_width",
    "thumb_place",
    "padding_mm",
)


switch_options = option_group(
    *(option(f"--{name}/--no-{name}", default=None, help=text) for name, text in SWITCHES),
    title="Switches",
)
"""None, their default, means the motion's own default."""
shape_options = option_group(
    option("--random-hand", is_flag=True, help="Draw the hand's size and shape from the seed."),
    hand_mesh_option,
    scale_option,
    *(
        option(f"--finger-{name}", metavar="FACTOR...", type=float, nargs=5, help=f"Factors on {text}.")
        for name, text in FINGERS
    ),
    *(
        option(f"--palm-{name}", metavar="FACTOR", type=float, help=f"Factor on the palm's {name}, {text}.")
        for name, text in PALM
    ),
    option("--wrist-width", metavar="FACTOR", type=float, help="Factor on the wrist's width."),
    option(
        "--thumb-place",
        metavar="FACTOR",
        type=float,
        help="Factor on how far along the palm the thumb begins.",
    ),
    option(
        "--padding-mm",
        metavar="MM",
        type=float,
        help="By how much the skin stands out, as in a glove, 0 to 12.  [default: 0]",
    ),
    title="Hand",
)


@click.command(
    "synth",
    cls=Command,
    examples=(
        "posetrack hand synth -o depth.mcap",
        "posetrack hand synth --frames 90 --seed 3 --random-hand -o depth.mcap",
    ),
    short_help="Make a recording of a moving hand whose truth is known.",
)
@output_option("The recording, an MCAP file.", "OUT.mcap")
@overwrite_option("The recording")
@option_group(
    motion_option(
        "A",
        "B",
        "C",
        default="C",
        details="A pose random walk, B pose and velocity random walk, C smooth natural motion.",
    ),
    speed_option("A, B: on the noise; C: on the rate of time."),
    frames_option(300, "At the nominal rate, dropped ones included."),
    fps_option("The nominal one.", 30.0),
    seed_option(),
    title="Motion",
)
@option_group(hand_side_option("right", "left", details="", default="right"), title="Hand")
@shape_options
@switch_options
@volume_options
def hand_synth(output: Path, overwrite: bool, **values: Any) -> None:
    """Make OUT.mcap, a recording of a moving hand as a Kinect v2 would see it, with truth on /truth/hand.

    All switches are on for motion C and off for A and B unless they are given. The same options give
    the same bytes.
    """
    import time

    from posetrack_cli.synthesis.hand.frames import write_synthetic

    options = synth_options(values)
    began = time.perf_counter()
    with _hand_progress(options.frames) as report:
        made = write_synthetic(options, output, overwrite=overwrite, report=report)
    print_line(
        f"{output}: {made.frames} frames, {made.missing} dropped, {made.seconds:.3f} s long, "
        f"made in {time.perf_counter() - began:.1f} s"
    )
    tell_next(("hand", "run", output, "-o", output.with_stem(f"{output.stem}-tracked")))


def synth_options(values: dict[str, Any]) -> Any:
    """Return the SynthOptions of the command's values.

    Raises:
        UsageError: a value that cannot be used.
    """
    from dataclasses import asdict, replace

    from posetrack_cli.synthesis.hand.options import Switches, SynthOptions, hand_of_seed

    values = dict(values)
    given = {name: values.pop(name) for name, _ in SWITCHES}
    chosen = {name: value for name, value in given.items() if value is not None}
    random_hand, shape = values.pop("random_hand", False), _given_shape(values)
    options = SynthOptions(**values, **shape, switches=replace(Switches.usual(values["motion"]), **chosen))
    if not random_hand:
        return options
    if shape:
        option = f"--{next(iter(shape))}".replace("_", "-")
        raise UsageError("--random-hand draws the hand itself", found=option, hint="leave one of them out")
    return replace(options, **asdict(hand_of_seed(options.seed)))


def _given_shape(values: dict[str, Any]) -> dict[str, Any]:
    """Take the options of the hand's size and proportions out of the values; return those given."""
    given = {name: values.pop(name, None) for name in SHAPE}
    return {name: value for name, value in given.items() if value is not None}


@contextmanager
def _hand_progress(frames: int) -> Iterator[Callable[[Any], None]]:
    """A bar on stderr if that is a terminal; it counts the instants that the frames have reached."""
    with bar("synth", "frame", frames) as shown:
        yield lambda frame: shown.advance(frame.instant + 1 - shown.done)
        shown.advance(frames - shown.done)


# ``posetrack head synth``: make a recording of a moving, deforming head whose truth is known


@click.command(
    "synth",
    cls=Command,
    examples=(
        "posetrack head synth -o recording.mcap",
        "posetrack head synth --camera-count 1 --identity 3 --frames 300 -o images/",
    ),
    former={
        "--cameras": "--camera-count",
        "--noise": "--noise-factor",
        "--distortion": "--lens-distortion",
        "--distance": "--distance-mm",
        "--baseline": "--baseline-mm",
    },
    short_help="Make a recording of a head whose truth is known.",
)
@output_option("The recording, an MCAP file or a folder of images with camera.toml.", "OUT.mcap|FOLDER")
@overwrite_option("The recording")
@option(
    "--image-format",
    type=click.Choice(["jpeg", "png", "raw"]),
    default="jpeg",
    show_default=True,
    help="How images are stored; raw only in an MCAP file.",
    group=WRITTEN,
)
@option_group(
    motion_option(
        "natural",
        "slight",
        "turn",
        "still",
        default="natural",
        details="slight: a fifth of the natural one; turn: also two sudden turns of 200 deg/s after three "
        "quarters.",
    ),
    speed_option("On the natural motion's rate of time."),
    frames_option(600, ""),
    fps_option("", 30.0),
    seed_option("Of everything random but the person."),
    option(
        "--expressions/--no-expressions",
        default=True,
        help="The face deforms and blinks.  [default: expressions]",
    ),
    option(
        "--script",
        type=click.Choice(["free", "two-motions"]),
        default="free",
        show_default=True,
        help="free: all expressions in the first two thirds, then only the head moves; two-motions: the "
        "mouth grows wide and narrow, then the face long and short, for build-model.",
    ),
    title="Motion",
)
@option_group(
    option("--identity", default=1, show_default=True, metavar="SEED", help="Who is seen: seed of a person."),
    option("--distance-mm", metavar="MM", default=700.0, show_default=True, help="How far the head is."),
    option(
        "--light",
        type=click.Choice(["slow", "sudden", "steady"]),
        default="slow",
        show_default=True,
        help="Light that drifts, also changes at once in the middle, or stays.",
    ),
    option("--occlusion", is_flag=True, help="An object covers half the face for one second."),
    title="Scene",
)
@option_group(
    option(
        "--camera-count",
        "cameras",
        metavar="1|2",
        default=2,
        show_default=True,
        help="How many cameras; two are toed in.",
    ),
    option("--baseline-mm", metavar="MM", default=120.0, show_default=True, help="Between two cameras."),
    option(
        "--image-size",
        metavar="WIDTHxHEIGHT",
        default="640x480",
        show_default=True,
        help="Of the images, pixels.",
    ),
    option(
        "--noise-factor",
        "noise",
        metavar="FACTOR",
        default=1.0,
        show_default=True,
        help="Factor on the sensor's noise; 0 for none.",
    ),
    option("--lens-distortion", "distortion", is_flag=True, help="The lenses distort."),
    option(
        "--drops/--no-drops", default=False, help="Missing frames. Each camera's own.  [default: no-drops]"
    ),
    title="Cameras",
)
@volume_options
def head_synth(output: Path, image_format: str, overwrite: bool, **values: Any) -> None:
    """Make a recording of a head as one or two grey cameras see it, with truth on /truth/head.

    The head is drawn by OpenGL and is nobody's. The same options give the same bytes on the same machine.
    """
    import time

    from posetrack_cli.synthesis.head.writing import write_synthetic

    options = head_synth_options(values)
    began = time.perf_counter()
    with _head_progress(options.frames) as report:
        made = write_synthetic(options, output, image_format=image_format, overwrite=overwrite, report=report)
    seconds = time.perf_counter() - began
    print_line(
        f"{output}: {made.frames} frames of {options.cameras} camera{'s'[: options.cameras - 1]}, "
        f"{made.missing} images missing, {made.seconds:.3f} s long, made in {seconds:.1f} s"
    )
    tracked = output.with_name(f"{output.stem}-tracked.mcap")
    tell_next(("head", "stereo" if options.cameras == 2 else "mono", output, "-o", tracked))


def head_synth_options(values: dict[str, Any]) -> Any:
    """Return the HeadSynthOptions of the command's values.

    Raises:
        UsageError: a value that cannot be meant.
    """
    from posetrack_cli.synthesis.head.options import HeadSynthOptions

    values = dict(values)
    width, height = _size(values.pop("image_size"))
    return HeadSynthOptions(**values, width=width, height=height)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise UsageError("--image-size cannot be used", found=text, expected="WIDTHxHEIGHT, such as 640x480")
    return int(width), int(height)


@contextmanager
def _head_progress(frames: int) -> Iterator[Callable[[Any], None]]:
    """A bar on stderr if that is a terminal."""
    with bar("synth", "frame", frames) as shown:
        yield lambda frame: shown.advance()
