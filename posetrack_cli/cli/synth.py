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
from posetrack_cli.cli.running import print_next
from posetrack_cli.cli.terminal import bar, print_line
from posetrack_cli.errors import UsageError

# posetrack hand synth


SWITCHES = (
    ("noise", "Depth noise, and range limits of 0.5 to 4.5 m."),
    ("edges", "Missing and displaced readings at depth edges."),
    ("background", "Render a room behind the hand."),
    ("body", "Render trunk and head behind the hand."),
    ("forearm", "Render the forearm."),
    ("drops", "Drop frames."),
    ("late", "Delay frames."),
)
FINGERS = (("lengths", "the finger lengths, thumb first"), ("widths", "the finger radii, thumb first"))
PALM = (
    ("width", "side to side"),
    ("length", "wrist to knuckles"),
    ("thickness", "back to front"),
)
SHAPE = (
    "scale",
    *(f"finger_{name}" for name, _ in FINGERS),
    *(f"palm_{name}" for name, _ in PALM),
    "wrist_width",
    "thumb_place",
    "padding_mm",
)


# Their default, None, stands for the default of the motion
switch_options = option_group(
    *(option(f"--{name}/--no-{name}", default=None, help=text) for name, text in SWITCHES),
    title="Switches",
)
shape_options = option_group(
    option("--random-hand", is_flag=True, help="Choose hand size and shape at random from the seed."),
    hand_mesh_option,
    scale_option,
    *(
        option(f"--finger-{name}", metavar="FACTOR...", type=float, nargs=5, help=f"Factors on {text}.")
        for name, text in FINGERS
    ),
    *(
        option(f"--palm-{name}", metavar="FACTOR", type=float, help=f"Factor on the palm {name} ({text}).")
        for name, text in PALM
    ),
    option("--wrist-width", metavar="FACTOR", type=float, help="Factor on the wrist width."),
    option(
        "--thumb-place",
        metavar="FACTOR",
        type=float,
        help="Factor on the distance of the thumb base along the palm.",
    ),
    option(
        "--padding-mm",
        metavar="MM",
        type=float,
        help="Thickness of a layer on the skin, e.g. a glove, 0 to 12.  [default: 0]",
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
    short_help="Generate a recording of a moving hand with ground truth.",
)
@output_option("Output file (MCAP).", "OUT.mcap")
@overwrite_option("OUT.mcap if it exists")
@option_group(
    motion_option(
        "A",
        "B",
        "C",
        default="C",
        text="Motion: random walk of the pose (A), of pose and velocity (B), or smooth natural motion (C).",
    ),
    speed_option("Factor on the speed: on the noise for A and B, on the time scale for C."),
    frames_option(300, "Number of frames at the nominal rate, including dropped ones."),
    fps_option("Nominal frame rate.", 30.0),
    seed_option(),
    title="Motion",
)
@option_group(hand_side_option("right", "left", text="Left or right hand.", default="right"), title="Hand")
@shape_options
@option_group(
    option(
        "--sensor",
        metavar="NAME",
        default="kinect2",
        help="Sensor: kinect1, kinect2, azure-nfov, azure-wfov, d415, d435, l515, sr305 or iphone-lidar.  "
        "[default: kinect2]",
    ),
    title="Sensor",
)
@switch_options
@volume_options
def hand_synth(output: Path, overwrite: bool, **values: Any) -> None:
    """Generate OUT.mcap, a depth recording of a moving hand with ground truth on /truth/hand.

    By default, all switches are on for motion C and off for A and B. The same options give an identical file.
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
    print_next(("hand", "run", output, "-o", output.with_stem(f"{output.stem}-tracked")))


def synth_options(values: dict[str, Any]) -> Any:
    """Return the SynthOptions for the command's values.

    Raises:
        UsageError: an invalid value or combination.
    """
    from dataclasses import asdict, replace

    from posetrack_cli.synthesis.hand.options import Switches, SynthOptions, hand_of_seed

    values = dict(values)
    # None: the switch was not given, and the default of the motion applies.
    given = {name: values.pop(name) for name, _ in SWITCHES}
    chosen = {name: value for name, value in given.items() if value is not None}
    random_hand, shape = values.pop("random_hand", False), _given_shape(values)
    options = SynthOptions(**values, **shape, switches=replace(Switches.usual(values["motion"]), **chosen))
    if not random_hand:
        return options
    if shape:
        option = f"--{next(iter(shape))}".replace("_", "-")
        what = "--random-hand cannot be combined with options of the hand's shape"
        raise UsageError(what, found=option, hint="leave one of them out")
    return replace(options, **asdict(hand_of_seed(options.seed)))


def _given_shape(values: dict[str, Any]) -> dict[str, Any]:
    """Remove the shape options from ``values``; return those that are given."""
    given = {name: values.pop(name, None) for name in SHAPE}
    return {name: value for name, value in given.items() if value is not None}


@contextmanager
def _hand_progress(frames: int) -> Iterator[Callable[[Any], None]]:
    """Yield a function that advances a bar to the nominal time of a frame; dropped frames count."""
    with bar("synth", "frame", frames) as shown:
        yield lambda frame: shown.advance(frame.instant + 1 - shown.done)
        shown.advance(frames - shown.done)


# posetrack head synth


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
    short_help="Generate a recording of a moving head with ground truth.",
)
@output_option("Output: an MCAP file, or a folder of images with camera.toml.", "OUT.mcap|FOLDER")
@overwrite_option("the output if it exists")
@option(
    "--image-format",
    type=click.Choice(["jpeg", "png", "raw"]),
    default="jpeg",
    show_default=True,
    help="Image encoding; raw is for MCAP files only.",
    group=WRITTEN,
)
@option_group(
    motion_option(
        "natural",
        "slight",
        "turn",
        "still",
        default="natural",
        text="Motion; slight has a fifth of the natural amplitude, turn adds two sudden turns of 200 deg/s "
        "after three quarters of the recording.",
    ),
    speed_option("Factor on the speed of the natural motion."),
    option(
        "--yaw-range",
        metavar="DEG",
        default=26.0,
        show_default=True,
        help="Largest yaw of the natural motion to either side.",
    ),
    option(
        "--roll",
        metavar="DEG",
        default=0.0,
        show_default=True,
        help="Rotate the person in the image, clockwise.",
    ),
    frames_option(600, "Number of frames."),
    fps_option("Frame rate.", 30.0),
    seed_option("Random seed; does not affect the person (--identity)."),
    option(
        "--expressions/--no-expressions",
        default=True,
        help="Facial expressions and blinks.  [default: expressions]",
    ),
    option(
        "--script",
        type=click.Choice(["free", "two-motions"]),
        default="free",
        show_default=True,
        help="Expressions: any in the first two thirds, then none (free); or mouth wide and narrow, then "
        "face long and short, for build-model (two-motions).",
    ),
    title="Motion",
)
@option_group(
    option("--identity", default=1, show_default=True, metavar="SEED", help="Seed of the person."),
    option(
        "--distance-mm", metavar="MM", default=700.0, show_default=True, help="Distance of the head in mm."
    ),
    option(
        "--light",
        type=click.Choice(["slow", "sudden", "steady"]),
        default="slow",
        show_default=True,
        help="Illumination: slow drift (slow), drift with a jump in the middle (sudden), or constant "
        "(steady).",
    ),
    option("--occlusion", is_flag=True, help="Cover half the face by an object for one second."),
    title="Scene",
)
@option_group(
    option(
        "--camera-count",
        "cameras",
        metavar="1..4",
        default=2,
        show_default=True,
        help="Number of cameras, which converge on the head: the second to the right of the first, the "
        "third to its left, the fourth above.",
    ),
    option(
        "--baseline-mm",
        metavar="MM",
        default=120.0,
        show_default=True,
        help="Distance of the other cameras from the first in mm.",
    ),
    option(
        "--image-size",
        metavar="WIDTHxHEIGHT",
        default="640x480",
        show_default=True,
        help="Image size in pixels.",
    ),
    option(
        "--noise-factor",
        "noise",
        metavar="FACTOR",
        default=1.0,
        show_default=True,
        help="Factor on the sensor noise; 0 for none.",
    ),
    option("--lens-distortion", "distortion", is_flag=True, help="Apply lens distortion."),
    option(
        "--drops/--no-drops",
        default=False,
        help="Drop frames, independently for each camera.  [default: no-drops]",
        meaning="Drop frames",
    ),
    title="Cameras",
)
@volume_options
def head_synth(output: Path, image_format: str, overwrite: bool, **values: Any) -> None:
    """Generate a recording of a moving head from one to four grey cameras, with ground truth on /truth/head.

    The head is synthetic and rendered with OpenGL. The same options give an identical file on the same
    machine.
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
    print_next(("head", "stereo" if options.cameras == 2 else "mono", output, "-o", tracked))


def head_synth_options(values: dict[str, Any]) -> Any:
    """Return the HeadSynthOptions for the command's values.

    Raises:
        UsageError: an invalid value.
    """
    from posetrack_cli.synthesis.head.options import HeadSynthOptions

    values = dict(values)
    width, height = _size(values.pop("image_size"))
    return HeadSynthOptions(**values, width=width, height=height)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise UsageError("invalid --image-size", found=text, expected="WIDTHxHEIGHT, such as 640x480")
    return int(width), int(height)


@contextmanager
def _head_progress(frames: int) -> Iterator[Callable[[Any], None]]:
    with bar("synth", "frame", frames) as shown:
        yield lambda frame: shown.advance()
