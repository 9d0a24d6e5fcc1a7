"""``posetrack hand``: hand commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.calibrate import hand_calibrate
from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    FILE,
    RUN_OPTIONS,
    NameOrFile,
    configuration_of,
    configuration_options,
    device_option,
    frame_options,
    hand_mesh_option,
    hand_side_option,
    init_option,
    option_group,
    particles_option,
    recording_options,
    result_options,
    scale_option,
)
from posetrack_cli.cli.process import stop_signals
from posetrack_cli.cli.running import (
    announce_compiling,
    close,
    name_partial_result,
    open_for_reading,
    print_remark,
    print_settings,
    progress,
)
from posetrack_cli.cli.synth import hand_synth
from posetrack_cli.cli.terminal import print_detail, print_info
from posetrack_cli.errors import UsageError

if TYPE_CHECKING:
    from posetrack_cli.hand.autodetect import DetectedHand
    from posetrack_cli.hand.config import HandConfig
    from posetrack_cli.hand.keypoints.file import KeypointFile
    from posetrack_cli.hand.run import HandRun
    from posetrack_cli.recording.recording import Recording

# option -> configuration key
CONFIGURED = {
    "filter_kind": "filter.kind",
    "particles": "filter.particles",
    "proposal": "filter.proposal",
    "resampling": "filter.resampling",
    "cost": "observation.cost",
    "hands": "hand.count",
    "side": "hand.side",
    "scale": "hand.scale",
    "mesh": "hand.mesh",
    "shape": "init.shape",
}


@click.group()
def hand() -> None:
    """Track a hand, calibrate its shape, or generate recordings."""


hand.add_command(hand_calibrate)
hand.add_command(hand_synth)


@hand.command(
    "run",
    cls=Command,
    examples=(
        "posetrack hand run depth.mcap -o hand.mcap",
        "posetrack hand run depth/ --fps 30 --hand-side left -o hand.mcap",
        "posetrack hand run depth.mcap --shape hand.toml --smooth -o hand.mcap",
    ),
    short_help="Track a hand in recorded depth images.",
)
@click.argument("recording", type=FILE)
@result_options("RESULT.mcap if it exists")
@option_group(
    hand_side_option(
        "auto",
        "right",
        "left",
        text="Hand to track; auto decides from the first seconds.  [default: auto]",
    ),
    option(
        "--hands",
        type=click.Choice(["auto", "1", "2", "1 of 2"]),
        help="Hands to track; 1 of 2: one, with another in view; auto: all seen.  [default: auto]",
    ),
    option(
        "--shape",
        metavar="auto|average|FILE|FOLDER",
        type=NameOrFile("auto", "average"),
        help="Hand size and shape: estimated from the recording (auto), average, from a result or the FILE "
        "of hand calibrate, or the mean of a person's results in FOLDER.  [default: auto]",
    ),
    scale_option,
    hand_mesh_option,
    init_option(
        "auto|center|FILE",
        "Initial pose: detected (auto), an open hand at the image centre with the palm towards the sensor "
        "(center), or from FILE.  [default: auto]",
    ),
    option(
        "--keypoints",
        "keypoint_file",
        metavar="FILE",
        type=FILE,
        help="21 hand keypoints per frame from another detector, CSV or JSON (docs/keypoints.md).",
    ),
    option(
        "--keypoints-unit",
        type=click.Choice(["px", "normalised", "mm", "m"]),
        help="Unit of the keypoints; px and normalised refer to the depth image.  [default: from FILE]",
        rare=True,
    ),
    option(
        "--keypoints-swap-sides",
        is_flag=True,
        help="Swap left and right, e.g. for MediaPipe before 0.10.15 or for multi_handedness of mirrored "
        "images.",
        rare=True,
    ),
    title="Hand",
)
@option_group(
    option(
        "--filter",
        "filter_kind",
        type=click.Choice(["rbpf", "pf", "pso"]),
        help="Particle filter (rbpf, pf) or particle swarm optimiser (pso; Oikonomidis et al. 2011).  "
        "[default: rbpf]",
    ),
    particles_option("256; 64 for pso"),
    option(
        "--proposal",
        type=click.Choice(["guided", "marginal", "paper"]),
        help="Proposal distribution.  [default: guided]",
        rare=True,
    ),
    option(
        "--resampling",
        type=click.Choice(["systematic", "multinomial", "residual", "stratified"]),
        help="Resampling scheme.  [default: systematic]",
        rare=True,
    ),
    option(
        "--cost",
        type=click.Choice(["mixture", "union", "paper"]),
        help="Cost function between rendered and observed depth.  [default: mixture]",
        rare=True,
    ),
    device_option("EGL device to render with, or cpu.  [default: a GPU if available, else cpu]"),
    title="Configuration",
)
@configuration_options("hand (default), hand-fast, hand-paper, hand-pso", "observation.sigma_mm=5")
@frame_options
@recording_options
@volume_options
def hand_run(recording: Path, **options: Any) -> None:
    """Track the hand in RECORDING: an MCAP file, ROS bag, folder of 16-bit depth images or Kinect file.

    The result (MCAP) holds pose, velocity, their variances and the 21 joints of every frame. The same input,
    configuration and seed give an identical file. Exit code 3: some data was unusable, or fewer than 5 % of
    the frames were tracked.
    """
    output = options["output"]
    with announce_compiling(output) as is_compiling:
        run, total, found = _prepare(recording, options)
        with (
            stop_signals(is_compiling) as stopped,
            progress(total, options["start"], options["stride"], "hand") as report,
            name_partial_result(output),
        ):
            outcome = run.track(report, stopped)
    if found.line and found.is_doubtful:
        print_remark(recording, found.line)
    elif found.line and not outcome.failure:
        print_info(f"{recording}: {found.line}")
    close(recording, output, outcome)


def _prepare(recording: Path, options: dict[str, Any]) -> tuple[HandRun, int | None, DetectedHand]:
    """Check recording, configuration and options before the first frame, and detect side and shape."""
    from posetrack_cli.hand.autodetect import detect_hand
    from posetrack_cli.hand.run import HandRun, RunOptions, check_run
    from posetrack_cli.rendering.devices import open_fastest_device
    from posetrack_cli.tracking.options import frames_ahead

    config = _configuration(options)
    source = open_hand_recording(recording, options)
    keypoints = _keypoints(options, source)
    # Cheap checks come first; detection of side and shape takes seconds.
    own = {name: options[name] for name in (*RUN_OPTIONS, "init", "smooth")}
    run_options = RunOptions(**own, keypoints=keypoints)
    device = open_fastest_device(options["device"])
    print_detail(f"rendering with {device.info}")
    check_run(source, config, run_options)
    found = detect_hand(source, config, options["start"], keypoints)
    print_settings(found.config)
    run = HandRun(source, found.config, run_options, device)
    return run, frames_ahead(source, run_options), found


def open_hand_recording(recording: Path, options: dict[str, Any]) -> Recording:
    """Open a depth recording."""
    return open_for_reading(recording, options)


def _keypoints(options: dict[str, Any], source: Recording) -> KeypointFile | None:
    """Read --keypoints and print how the file was interpreted."""
    path, unit, swap = (options[f"keypoint{name}"] for name in ("_file", "s_unit", "s_swap_sides"))
    if path is None:
        if unit is not None or swap:
            option = "--keypoints-unit" if unit is not None else "--keypoints-swap-sides"
            raise UsageError(f"{option} requires --keypoints", hint="add --keypoints FILE or leave it out")
        return None
    from posetrack_cli.hand.keypoints.file import read_keypoints
    from posetrack_cli.recording.keypoints.reading import fitted_to

    keypoints = read_keypoints(path, source.cameras[0], unit, swap)
    sets, words = fitted_to(keypoints.sets, source)
    keypoints = replace(keypoints, sets=sets)
    print_info(f"{path}: {keypoints.line}{words and f'; {words}'}")
    return keypoints


def _configuration(options: dict[str, Any]) -> HandConfig:
    from posetrack_cli.hand.config import HandConfig

    options = _with_shape(options)
    config = configuration_of(HandConfig, options, CONFIGURED)
    if config.filter.kind != "pso":
        return config
    swarms = {"swarm": options["particles"]}  # for pso, --particles sets the size of the swarm
    return configuration_of(HandConfig, options | swarms, CONFIGURED | {"swarm": "pso.particles"})


def _with_shape(options: dict[str, Any]) -> dict[str, Any]:
    """Replace ``--shape`` by the configuration that it stands for."""
    from posetrack_cli.hand.shape_fit import read_shape

    shape = options["shape"]
    if shape is None and options["scale"] is not None:
        shape = "average"  # --scale alone fixes the size, so nothing is estimated
    given = read_shape(shape)
    return options | {
        "shape": given.init,
        "configs": (*options["configs"], *given.files),
        "settings": (*given.assignments, *options["settings"]),
    }
