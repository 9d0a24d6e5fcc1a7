"""``posetrack head stereo``: pose and face deformation from calibrated cameras."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.compiling import compiling_said
from posetrack_cli.cli.image_options import image_arguments, image_options
from posetrack_cli.cli.running import close, kept, progress
from posetrack_cli.cli.signals import stop_signals
from posetrack_cli.errors import UsageError

if TYPE_CHECKING:
    from posetrack_cli.head.config import HeadStereoConfig
    from posetrack_cli.head.model_file import Learned
    from posetrack_cli.head.protocol import HeadTracker
    from posetrack_cli.head.run import HeadRun, HeadRunOptions
    from posetrack_cli.recording.base import Recording
    from posetrack_cli.tracking.run import Report

# option -> configuration key
CONFIGURED = {
    "particles": "particles.count",
    "model": "model.kind",
    "detector": "start.detection.detector",
    "detector_model": "start.detection.model",
}
RUN_OPTIONS = (
    "output",
    "seed",
    "start",
    "end",
    "stride",
    "resume",
    "overwrite",
    "timings",
    "passes",
    "load_model",
    "save_model",
)


@click.command("stereo", short_help="Track a head in the images of calibrated cameras.")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Result to write, MCAP.")
@click.option(
    "--config",
    "configs",
    multiple=True,
    help="TOML file, or a shipped name: head-stereo (the defaults), head-stereo-paper; repeatable, later "
    "ones override.",
)
@click.option(
    "--set",
    "settings",
    metavar="KEY=VALUE",
    multiple=True,
    help="Set any key of the configuration, such as model.components=3; repeatable.",
)
@click.option("--particles", type=click.IntRange(min=1), help="Number of particles.  [default: 1000]")
@click.option(
    "--model",
    type=click.Choice(["deformable", "rigid"]),
    help="Whether the face's deformations are learnt and tracked.  [default: deformable]",
)
@click.option(
    "--passes",
    type=click.IntRange(1, 2),
    default=1,
    show_default=True,
    help="Track twice: the second pass, which is the result, begins with what the first has learned.",
)
@click.option(
    "--save-model", metavar="FILE.npz", type=click.Path(path_type=Path), help="Write what was learned."
)
@click.option(
    "--load-model",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Begin with what an earlier run of the same person learned: its --save-model, or its result.",
)
@click.option("--detector", type=click.Choice(["haar", "yunet"]), help="Face detector.  [default: haar]")
@click.option(
    "--detector-model",
    metavar="FILE.onnx",
    help="The model of --detector yunet, such as face_detection_yunet_2023mar.onnx of OpenCV's model zoo.",
)
@click.option(
    "--init",
    metavar="auto|FILE.csv",
    default="auto",
    show_default=True,
    help="Start: find the face, or a table camera,point,x,y of points clicked in the first frame.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Random seed.")
@click.option("--start", type=click.IntRange(min=0), default=0, help="First frame.")
@click.option("--end", type=click.IntRange(min=1), help="Frame to stop before.")
@click.option("--stride", type=click.IntRange(min=1), default=1, help="Track every so many frames.")
@image_options
@click.option("--resume", is_flag=True, help="Go on with an interrupted run.")
@click.option("--overwrite", is_flag=True, help="Replace an existing result, and an existing model.")
@click.option(
    "--timings", is_flag=True, help="Write each frame's milliseconds (bytes then differ from run to run)."
)
def head_stereo(recording: Path, **options: Any) -> None:
    """Track the head in RECORDING: a folder with one folder of images per camera, or an MCAP file.

    Two or more calibrated cameras are needed. The face is found by itself, any person's; how it deforms is
    learnt while it is tracked. The result is MCAP with pose, velocity, ten points, the deformation and the
    model learnt. The same input, configuration and seed give the same bytes.
    """
    from posetrack_cli.tracking.options import frames_ahead

    source, config, chosen = _opened(recording, options), _configuration(options), _run_options(options)
    names = ("head",) if chosen.passes == 1 else ("pass 1", "pass 2")
    with compiling_said(), stop_signals() as stopped, kept(chosen.output), ExitStack() as stack:
        total = frames_ahead(source, chosen)
        bars = (progress(total, chosen.start, chosen.stride, name) for name in names)
        reports = [stack.enter_context(bar) for bar in bars]
        outcome = _run(source, config, chosen, reports[0]).track(reports[-1], stopped)
    close(recording, chosen.output, outcome, chosen.passes)


def _opened(recording: Path, options: dict[str, Any]) -> Recording:
    """The recording, of two cameras at least."""
    from posetrack_cli.recording.opening import open_images

    source = open_images(recording, **image_arguments(options))
    if len(source.cameras) < 2:
        raise UsageError(
            "too few cameras",
            where=recording,
            found=f"only '{source.cameras[0].name}'",
            expected="2 or more",
            hint="a folder has one folder of images per camera, such as left/ and right/",
        )
    return source


def _run_options(options: dict[str, Any]) -> HeadRunOptions:
    from posetrack_cli.head.run import HeadRunOptions

    init = None if options["init"] == "auto" else options["init"]
    return HeadRunOptions(**{name: options[name] for name in RUN_OPTIONS}, init=init)


def _run(source: Recording, config: HeadStereoConfig, options: HeadRunOptions, first_pass: Report) -> HeadRun:
    """Everything that can be refused is refused here, before the first frame."""
    from posetrack_cli.head.clicked_tracker import ClickedTracker
    from posetrack_cli.head.stereo_estimates import components_of
    from posetrack_cli.head.run import HeadRun
    from posetrack_cli.head.stereo_tracker import make_stereo_tracker
    from posetrack_cli.head.subject import head_subject

    def make_tracker(known: Learned | None) -> HeadTracker[Any]:
        if options.init is None:
            return make_stereo_tracker(config, source.cameras, known)
        return ClickedTracker(config, source.cameras, Path(options.init), known)

    return HeadRun(
        source,
        config,
        options,
        name="head-stereo",
        subject=head_subject(source.cameras[0].name, components_of(config)),
        flush_frames=config.output.flush_frames,
        make_tracker=make_tracker,
        first_pass=first_pass,
    )


def _configuration(options: dict[str, Any]) -> HeadStereoConfig:
    from posetrack_cli.configuration import find_configuration, load_settings, parse_assignments
    from posetrack_cli.head.config import HeadStereoConfig

    files = [find_configuration(name) for name in options["configs"]]
    own = {key: options[name] for name, key in CONFIGURED.items() if options[name] is not None}
    return load_settings(HeadStereoConfig, files, parse_assignments(options["settings"]) | own)
