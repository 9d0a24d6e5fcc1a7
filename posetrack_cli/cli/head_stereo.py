"""``posetrack head stereo``: pose and face deformation from calibrated cameras."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.head_options import (
    LEARNED,
    START,
    head_configuration,
    head_run_options,
    learning_options,
    start_options,
    track_head,
)
from posetrack_cli.cli.options import (
    CONFIGURATION,
    FILE,
    configuration_options,
    frame_options,
    image_options,
    option_group,
    particles_option,
    result_options,
)
from posetrack_cli.cli.running import open_for_reading
from posetrack_cli.errors import UsageError

if TYPE_CHECKING:
    from posetrack_cli.head.config import HeadStereoConfig
    from posetrack_cli.head.run import HeadRun, HeadRunOptions
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.tracking.run import Report
    from posetrack_cli.tracking.two_pass import Learned, LearningTracker


@click.command(
    "stereo",
    cls=Command,
    examples=(
        "posetrack head stereo recording.mcap -o head.mcap",
        "posetrack head stereo images/ --fps 30 --camera rig.toml -o head.mcap",
    ),
    short_help="Track a head in the images of calibrated cameras.",
)
@click.argument("recording", type=FILE)
@result_options("The result, and the model of --save-model")
@option(
    "--model",
    type=click.Choice(["deformable", "rigid"]),
    help="Whether the face's deformations are learnt and tracked.  [default: deformable]",
    group=LEARNED,
)
@learning_options
@option_group(start_options, title=START)
@option_group(particles_option(1000), title=CONFIGURATION)
@configuration_options("head-stereo (the defaults), head-stereo-paper", "model.components=3")
@frame_options
@image_options
@volume_options
def head_stereo(recording: Path, **options: Any) -> None:
    """Track the head in RECORDING: a folder with one folder of images per camera, MCAP or a bag of ROS.

    Two or more calibrated cameras are needed. The face is found by itself, any person's; how it deforms is
    learnt while it is tracked. The result is MCAP with pose, velocity, ten points, the deformation and the
    model learnt. The same input, configuration and seed give the same bytes.
    Exit code 3: some data could not be used, or less than 5 % of the frames were tracked.
    """
    from posetrack_cli.head.config import HeadStereoConfig

    source = open_stereo_recording(recording, options)
    config = head_configuration(HeadStereoConfig, options, {"model": "model.kind"})
    chosen = head_run_options(options, source)
    passes = config.run.passes
    track_head(source, passes, chosen, lambda first_pass: _run(source, config, chosen, first_pass))


def open_stereo_recording(recording: Path, options: dict[str, Any]) -> Recording:
    """Return the recording, of two cameras at least."""
    source = open_for_reading(recording, options, "grey")
    if len(source.cameras) < 2:
        raise UsageError(
            "too few cameras",
            where=recording,
            found=f"only '{source.cameras[0].name}'",
            expected="2 or more",
            hint="a folder has one folder of images per camera, such as left/ and right/",
        )
    return source


def _run(source: Recording, config: HeadStereoConfig, options: HeadRunOptions, first_pass: Report) -> HeadRun:
    """Everything that can be refused is refused here, before the first frame."""
    from posetrack_cli.head.run import HeadRun
    from posetrack_cli.head.subject import head_subject
    from posetrack_cli.head.tracker.stereo import components_of, make_stereo_tracker

    clicked = None if options.init is None else Path(options.init)

    def make_tracker(known: Learned | None) -> LearningTracker[Any]:
        return make_stereo_tracker(
            config, source.cameras, known, clicked=clicked, landmarks=options.landmarks
        )

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
