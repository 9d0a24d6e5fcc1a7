"""``posetrack hand``: the commands for hands."""

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
    close,
    compiling_said,
    kept,
    open_for_reading,
    print_remark,
    progress,
    tell_settings,
)
from posetrack_cli.cli.synth import hand_synth
from posetrack_cli.cli.terminal import print_aside, print_detail
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
    "side": "hand.side",
    "scale": "hand.scale",
    "mesh": "hand.mesh",
    "shape": "init.shape",
}


@click.group()
def hand() -> None:
    """Track a hand, or make recordings of one."""


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
    short_help="Track the hand in recorded depth.",
)
@click.argument("recording", type=FILE)
@result_options("The result")
@option_group(
    hand_side_option("auto", "right", "left", details="auto tells from the first seconds.  [default: auto]"),
    option(
        "--shape",
        metavar="auto|average|FILE",
        type=NameOrFile("auto", "average"),
        help="Size and shape of the hand: auto estimates them from the recording, average is the average "
        "hand, FILE is one of hand calibrate or a result of hand run.  [default: auto]",
    ),
    scale_option,
    hand_mesh_option,
    init_option(
        "auto|center|FILE",
        "auto finds the hand, center takes an open one in the middle, palm to the sensor, FILE has a pose.  "
        "[default: auto]",
    ),
    option(
        "--keypoints",
        "keypoint_file",
        metavar="FILE",
        type=FILE,
        help="21 points per frame that another program found, CSV or JSON (docs/keypoints.md).",
    ),
    option(
        "--keypoints-unit",
        type=click.Choice(["px", "normalised", "mm", "m"]),
        help="Of their coordinates; px and normalised in the depth images.  [default: as FILE says or looks]",
        rare=True,
    ),
    option(
        "--keypoints-swap-sides",
        is_flag=True,
        help="Exchange right and left: for handedness of MediaPipe before 0.10.15, multi_handedness of "
        "mirrored images, or wrong sides.",
        rare=True,
    ),
    title="Hand",
)
@option_group(
    option(
        "--filter",
        "filter_kind",
        type=click.Choice(["rbpf", "pf", "pso"]),
        help="Filter, or pso, the optimiser of Oikonomidis and others, 2011.  [default: rbpf]",
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
        help="Cost function over the image.  [default: mixture]",
        rare=True,
    ),
    device_option("[default: a GPU if there is one, else cpu]"),
    title="Configuration",
)
@configuration_options("hand (the defaults), hand-fast, hand-paper, hand-pso", "observation.sigma_mm=5")
@frame_options
@recording_options
@volume_options
def hand_run(recording: Path, **options: Any) -> None:
    """Track the hand in RECORDING: MCAP, a bag of ROS, a folder of 16-bit depth images or a Kinect file.

    The result is MCAP with pose, velocity, their variances and the 21 joints of every frame. The same input,
    configuration and seed give the same bytes. Exit code 3: some data could not be used, or less than 5 % of
    the frames were tracked.
    """
    output = options["output"]
    with compiling_said(output) as is_compiling:
        run, total, found = _prepare(recording, options)
        with (
            stop_signals(is_compiling) as stopped,
            progress(total, options["start"], options["stride"], "hand") as report,
            kept(output),
        ):
            outcome = run.track(report, stopped)
    if found.line and not outcome.failure:
        if found.is_doubtful:
            print_remark(recording, found.line)
        else:
            print_aside(f"{recording}: {found.line}")
    close(recording, output, outcome)


def _prepare(recording: Path, options: dict[str, Any]) -> tuple[HandRun, int | None, DetectedHand]:
    """Refuse what can be refused before the first frame, and settle what is left open."""
    from posetrack_cli.hand.autodetect import detect_hand
    from posetrack_cli.hand.run import HandRun, RunOptions, check_run
    from posetrack_cli.rendering.devices import open_fastest_device
    from posetrack_cli.tracking.options import frames_ahead

    config = _configuration(options)
    source = open_hand_recording(recording, options)
    keypoints = _keypoints(options, source)
    own = {name: options[name] for name in (*RUN_OPTIONS, "init", "smooth")}
    run_options = RunOptions(**own, keypoints=keypoints)
    device = open_fastest_device(options["device"])
    print_detail(f"draws with {device.info}")
    check_run(source, config, run_options)
    found = detect_hand(source, config, options["start"], keypoints)
    tell_settings(found.config)
    run = HandRun(source, found.config, run_options, device)
    return run, frames_ahead(source, run_options), found


def open_hand_recording(recording: Path, options: dict[str, Any]) -> Recording:
    """Return the recording of depth."""
    return open_for_reading(recording, options)


def _keypoints(options: dict[str, Any], source: Recording) -> KeypointFile | None:
    """Read the keypoints that are given, and say what they are taken for."""
    path, unit, swap = (options[f"keypoint{name}"] for name in ("_file", "s_unit", "s_swap_sides"))
    if path is None:
        if unit is not None or swap:
            option = "--keypoints-unit" if unit is not None else "--keypoints-swap-sides"
            raise UsageError(f"{option} is about keypoints, and none are given", hint="--keypoints FILE")
        return None
    from posetrack_cli.hand.keypoints.file import read_keypoints
    from posetrack_cli.recording.keypoints.reading import fitted_to

    keypoints = read_keypoints(path, source.cameras[0], unit, swap)
    sets, words = fitted_to(keypoints.sets, source)
    keypoints = replace(keypoints, sets=sets)
    print_aside(f"{path}: {keypoints.line}{words and f'; {words}'}")
    return keypoints


def _configuration(options: dict[str, Any]) -> HandConfig:
    from posetrack_cli.hand.config import HandConfig

    options = _with_shape(options)
    config = configuration_of(HandConfig, options, CONFIGURED)
    if config.filter.kind != "pso":
        return config
    swarms = {"swarm": options["particles"]}  # --particles says a swarm's, too
    return configuration_of(HandConfig, options | swarms, CONFIGURED | {"swarm": "pso.particles"})


def _with_shape(options: dict[str, Any]) -> dict[str, Any]:
    """The options with what ``--shape`` stands for: a key of the configuration, or a file of it."""
    shape = options["shape"]
    if shape is None and options["scale"] is not None:
        shape = "average"  # of that size
    if shape in (None, "auto", "average"):
        return options | {"shape": {"auto": "auto", "average": "given"}.get(shape)}
    if Path(shape).suffix == ".mcap":
        from posetrack_cli.hand.shape_fit import hand_assignments

        told = hand_assignments(Path(shape))
        return options | {"shape": "given", "settings": (*told, *options["settings"])}
    return options | {"shape": None, "configs": (*options["configs"], shape)}
