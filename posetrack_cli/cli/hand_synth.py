"""``posetrack hand synth``: make a recording of a moving hand whose truth is known."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click

from posetrack_cli.cli.standard_output import print_line
from posetrack_cli.errors import UsageError

Command = TypeVar("Command", bound=Callable[..., Any])

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


def switch_options(command: Command) -> Command:
    """Add the switches; None, their default, means the motion's own default."""
    for name, text in reversed(SWITCHES):
        command = click.option(f"--{name}/--no-{name}", default=None, help=text)(command)
    return command


def shape_options(command: Command) -> Command:
    """Add the hand's proportions."""
    padding = "By how much the skin stands out, as in a glove, 0 to 12.  [default: 0]"
    command = click.option("--padding-mm", type=float, help=padding)(command)
    place = "Factor on how far along the palm the thumb begins."
    command = click.option("--thumb-place", type=float, help=place)(command)
    command = click.option("--wrist-width", type=float, help="Factor on the wrist's width.")(command)
    for name, text in reversed(PALM):
        command = click.option(f"--palm-{name}", type=float, help=f"Factor on the palm's {name}, {text}.")(
            command
        )
    for name, text in reversed(FINGERS):
        option = f"--finger-{name}"
        command = click.option(option, type=float, nargs=5, help=f"Factors on {text}.")(command)
    return command


@click.command("synth")
@click.option("-o", "--output", metavar="OUT.mcap", type=click.Path(path_type=Path), required=True)
@click.option(
    "--motion",
    type=click.Choice(["A", "B", "C"], case_sensitive=False),
    metavar="[A|B|C]",  # click would show the choices in lower case
    default="C",
    show_default=True,
    help="A pose random walk, B pose and velocity random walk, C smooth natural motion.",
)
@click.option(
    "--frames", default=300, show_default=True, help="Frames at the nominal rate, dropped ones included."
)
@click.option("--seed", default=0, show_default=True, help="Random seed.")
@click.option(
    "--speed",
    default=1.0,
    show_default=True,
    help="A, B: factor on the noise; C: factor on the rate of time.",
)
@click.option("--hand-side", "side", type=click.Choice(["right", "left"]), default="right", show_default=True)
@click.option("--scale", type=float, help="Factor on the hand's lengths.  [default: 1]")
@shape_options
@click.option("--random-hand", is_flag=True, help="Draw the hand's size and shape from the seed.")
@click.option("--hand-mesh", "mesh", metavar="FILE.glb", help="Hand (glTF) instead of the average one.")
@click.option("--fps", default=30.0, show_default=True, help="Nominal frame rate, Hz.")
@switch_options
@click.option("--overwrite", is_flag=True, help="Replace OUT.mcap if it exists.")
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
    from tqdm import tqdm

    with tqdm(total=frames, unit="frame", disable=not sys.stderr.isatty()) as bar:
        yield lambda frame: _advance(bar, frame.instant + 1)
        _advance(bar, frames)


def _advance(bar: Any, done: int) -> None:
    bar.update(done - bar.n)
