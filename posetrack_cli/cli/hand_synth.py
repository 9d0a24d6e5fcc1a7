"""``posetrack hand synth``: make a recording of a moving hand whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
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
from posetrack_cli.cli.progress import bar
from posetrack_cli.cli.running import tell_next
from posetrack_cli.cli.standard_output import print_line
from posetrack_cli.errors import UsageError

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

    from posetrack_cli.synthesis.hand.writing import write_synthetic

    options = synth_options(values)
    began = time.perf_counter()
    with _progress(options.frames) as report:
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
def _progress(frames: int) -> Iterator[Callable[[Any], None]]:
    """A bar on stderr if that is a terminal; it counts the instants that the frames have reached."""
    with bar("synth", "frame", frames) as shown:
        yield lambda frame: shown.advance(frame.instant + 1 - shown.done)
        shown.advance(frames - shown.done)
