"""``posetrack doctor``: list renderers, their speed and missing system packages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, suppress
from typing import TYPE_CHECKING

import click

from posetrack_cli.cli.command import Command, option
from posetrack_cli.cli.options import device_option, particles_option
from posetrack_cli.cli.running import announce_compiling
from posetrack_cli.cli.terminal import print_line, print_note
from posetrack_cli.errors import EXIT_FAILED, PosetrackError
from posetrack_cli.phases import phase

if TYPE_CHECKING:
    from posetrack_cli.rendering.port import RenderingDevice

PARTICLES = 512
REPEATS = 11
MOST_DEVICES = 16
# Run-time dependencies; their versions belong in every bug report
LIBRARIES = (
    "av",
    "numpy",
    "scipy",
    "threadpoolctl",
    "numba",
    "fast-simplification",
    "jinja2",
    "filelock",
    "opencv-python-headless",
    "moderngl",
    "lz4",
    "mcap",
    "mcap-protobuf-support",
    "foxglove-schemas-protobuf",
    "protobuf",
    "pydantic",
    "click",
    "tqdm",
    "zstandard",
)


@click.command(
    cls=Command,
    examples=("posetrack doctor", "posetrack doctor --device cpu", "posetrack doctor --warm"),
    short_help="Check renderers and measure their speed.",
)
@device_option("EGL device to test, or cpu.  [default: all]")
@particles_option(PARTICLES)
@option(
    "--warm",
    is_flag=True,
    help="Only compile all kernels and cache them, e.g. in a container image or a CI job.",
)
def doctor(device: int | str | None, particles: int | None, warm: bool) -> None:
    """List the available renderers, their speed, and missing packages.

    Hand particles are scored on the GPU if there is one, else on the CPU; everything else is rendered with
    OpenGL.
    """
    from posetrack_cli.rendering.devices import CPU

    if warm:
        return _warm()
    _print_versions()
    particles = particles or PARTICLES
    if device is None or device == CPU:
        with announce_compiling():
            _check_processor(particles)
    if not (device is None or isinstance(device, int)):
        return
    works = _check("default" if device is None else f"device {device}", device, particles)
    numbers = _working_devices() if device is None else []
    if len(numbers) > 1 or not works:  # a single device is the default one, which was reported
        for number in numbers:
            _check(f"device {number}", number, particles)
    if not works:
        click.get_current_context().exit(EXIT_FAILED)


def _warm() -> None:
    from posetrack_cli.cli.warm import RUNS, warm_kernels

    with phase("compiling kernels", "group", len(RUNS)) as advance:
        cache = warm_kernels(advance)
    print_line(f"kernels are compiled and cached in {cache}")


def _print_versions() -> None:
    import platform
    from importlib import metadata

    from posetrack_cli.build import build_name, processor_features

    print_line(f"posetrack {build_name()}, Python {platform.python_version()}, {platform.platform()}")
    for name in LIBRARIES:
        try:
            print_line(f"  {name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            print_line(f"  {name} is missing: reinstall posetrack with pip")
    print_line(f"  {processor_features()}")


def _working_devices() -> list[int]:
    """Return the numbers of usable EGL devices, which need not be consecutive."""
    from posetrack_cli.rendering.devices import open_device

    numbers = []
    with phase("probing EGL devices", "number", MOST_DEVICES) as advance:
        for number in range(MOST_DEVICES):
            with suppress(PosetrackError):
                open_device(number).close()
                numbers.append(number)
            advance(1)
    return numbers


def _check(label: str, device: int | None, particles: int) -> bool:
    """Print name and speed of a device, or the reason why it fails; return whether it works."""
    from posetrack_cli.rendering.devices import open_device

    try:
        with phase(f"opening OpenGL {label}", "device", 1) as advance:
            drawing = open_device(device)
            advance(1)
        with closing(drawing):
            print_line(f"OpenGL {label}: {drawing.info}")
            _print_times(drawing, particles)
    except PosetrackError as error:
        print_line(f"OpenGL {label}: does not work")
        print_note(f"posetrack: {error}")
        return False
    return True


def _check_processor(particles: int) -> None:
    from posetrack_cli.rendering.cpu import CpuDevice

    with closing(CpuDevice()) as drawing:
        print_line(f"Processor: {drawing.info}")
        _print_times(drawing, particles)


def _print_times(device: RenderingDevice, particles: int) -> None:
    for tile, milliseconds in _scoring_times(device, particles):
        print_line(f"  {particles} particles, {tile}x{tile} pixels each: {milliseconds:.1f} ms")


def _scoring_times(device: RenderingDevice, particles: int) -> Iterator[tuple[int, float]]:
    """Yield tile sizes (px) and median times (ms) to score open hands near one pose."""
    import numpy as np

    from posetrack_cli.hand.model.anatomy import make_anatomy
    from posetrack_cli.hand.model.hand import hand_mesh
    from posetrack_cli.hand.model.kinematics import skinning_transforms
    from posetrack_cli.hand.start import scattered_poses
    from posetrack_cli.rendering.devices import WARM_UP, scoring_milliseconds

    anatomy = make_anatomy()
    with phase("generating hand poses", "hand", particles) as advance:
        poses = scattered_poses(anatomy, particles, np.random.default_rng(0))
        transforms, mesh = skinning_transforms(anatomy, poses), hand_mesh(anatomy)
        advance(particles)
    for tile in (64, 128):
        with phase(f"measuring {tile}x{tile} pixels", "run", REPEATS + WARM_UP) as advance:
            took = scoring_milliseconds(device, mesh, transforms, tile, 128 // tile, REPEATS, advance)
        yield tile, took
