"""``posetrack head synth``: make a recording of a moving, deforming head whose truth is known."""

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
    motion_option,
    option_group,
    output_option,
    overwrite_option,
    seed_option,
    speed_option,
)
from posetrack_cli.cli.progress import bar
from posetrack_cli.cli.running import tell_next
from posetrack_cli.cli.standard_output import print_line
from posetrack_cli.errors import UsageError


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
    with _progress(options.frames) as report:
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
def _progress(frames: int) -> Iterator[Callable[[Any], None]]:
    """A bar on stderr if that is a terminal."""
    with bar("synth", "frame", frames) as shown:
        yield lambda frame: shown.advance()
