"""Options of the commands that track heads, and what these do alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import click

from posetrack_cli.cli.command import option
from posetrack_cli.cli.options import (
    FILE,
    RUN_OPTIONS,
    NameOrFile,
    configuration_of,
    init_option,
    option_group,
)
from posetrack_cli.cli.process import stop_signals
from posetrack_cli.cli.running import close, compiling_said, kept, progress, tell_settings
from posetrack_cli.cli.standard_output import print_aside
from posetrack_cli.errors import UsageError

if TYPE_CHECKING:
    from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
    from posetrack_cli.head.landmarks.file import LandmarkFile
    from posetrack_cli.head.run import HeadRun, HeadRunOptions
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.tracking.run import Report

HeadConfig = TypeVar("HeadConfig", "HeadStereoConfig", "HeadMonoConfig")
CONFIGURED = {
    "particles": "particles.count",
    "detector": "start.detection.detector",
    "detector_model": "start.detection.model",
    "passes": "run.passes",
}
"""Configuration keys that options stand for."""
HEAD_RUN_OPTIONS = (*RUN_OPTIONS, "load_model", "save_model", "smooth")


LEARNED, START = "Learning", "Start and evidence"


learning_options = option_group(
    option(
        "--passes",
        metavar="1|2",
        type=click.IntRange(1, 2),
        help="How often the recording is gone through: the last pass, which is the result, begins with "
        "what the first has learned.  [default: 2 with one camera, 1 with several or as printed]",
    ),
    option(
        "--save-model",
        metavar="FILE.npz",
        type=FILE,
        help="Write what was learned.",
    ),
    option(
        "--load-model",
        metavar="FILE",
        type=FILE,
        help="Begin with what an earlier run of the same person learned: its --save-model or result.",
    ),
    title=LEARNED,
)


start_options = option_group(
    option("--detector", type=click.Choice(["haar", "yunet"]), help="Face detector.  [default: haar]"),
    option(
        "--detector-model",
        metavar="FILE.onnx",
        type=NameOrFile(),
        help="The model of --detector yunet, such as face_detection_yunet_2023mar.onnx of OpenCV's model "
        "zoo.",
    ),
    init_option(
        "auto|FILE.csv",
        "auto finds the face, FILE is a table camera,point,x,y of points clicked in the first frame.",
        default="auto",
    ),
    option(
        "--landmarks",
        "landmark_file",
        metavar="FILE",
        type=FILE,
        help="Points per frame that another program found in the images (of the reference camera), CSV or "
        "JSON: OpenFace's 68, MediaPipe's 478, or our ten by name (docs/landmarks.md).",
    ),
    option(
        "--landmarks-unit",
        type=click.Choice(["px", "normalised"]),
        help="Of their coordinates.  [default: as FILE says or looks]",
    ),
)


def head_configuration(
    kind: type[HeadConfig], options: Mapping[str, Any], own: Mapping[str, str]
) -> HeadConfig:
    """Return the configuration of a head tracker; see ``configuration_of``.

    Args:
        kind: of configuration.
        options: of the command.
        own: configuration key of each option that only this command has.

    Raises:
        UsageError: what cannot be meant, such as a model for a detector that uses none.
    """
    config = configuration_of(kind, options, {**CONFIGURED, **own})
    tell_settings(config)
    detector = config.start.detection.detector
    if options["detector_model"] is not None and detector != "yunet":
        raise UsageError(
            "--detector-model does not apply", found=f"detector {detector}", hint="add --detector yunet"
        )
    return config


def head_run_options(options: Mapping[str, Any], source: Recording) -> HeadRunOptions:
    """Return what a run depends on besides recording and configuration, and say what landmarks are taken for.

    Args:
        options: of the command.
        source: the recording; landmarks are of the images of its reference camera.
    """
    from posetrack_cli.head.run import HeadRunOptions

    init = None if options["init"] == "auto" else options["init"]
    own = {name: options[name] for name in HEAD_RUN_OPTIONS}
    person = options.get("person")
    return HeadRunOptions(**own, init=init, person=person, landmarks=_landmarks(options, source))


def _landmarks(options: Mapping[str, Any], source: Recording) -> LandmarkFile | None:
    path, unit = options["landmark_file"], options["landmarks_unit"]
    if path is None:
        if unit is not None:
            what = "--landmarks-unit is about landmarks, and none are given"
            raise UsageError(what, hint="--landmarks FILE")
        return None
    from posetrack_cli.head.landmarks.file import read_landmarks
    from posetrack_cli.recording.keypoints.use import fitted_to

    landmarks = read_landmarks(path, source.cameras[0], unit)
    sets, words = fitted_to(landmarks.sets, source)
    landmarks = replace(landmarks, sets=sets)
    print_aside(f"{path}: {landmarks.line}{words and f'; {words}'}")
    return landmarks


def track_head(
    source: Recording, passes: int, options: HeadRunOptions, made: Callable[[Report], HeadRun]
) -> None:
    """Track with a bar for each pass, tell how it closed, and set the exit code.

    Args:
        source: the recording.
        passes: of the run.
        options: of the run.
        made: makes the run, given what reports its first pass; refuses all that can be refused before it.
    """
    from posetrack_cli.tracking.options import frames_ahead

    names = ("head",) if passes == 1 else ("pass 1", "pass 2")
    with (
        compiling_said(options.output) as is_compiling,
        stop_signals(is_compiling) as stopped,
        kept(options.output),
        ExitStack() as stack,
    ):
        reports: list[Report] = []
        run = made(lambda estimate: reports[0](estimate))  # may speak, so no bar is drawn before
        total = frames_ahead(source, options)
        bars = (progress(total, options.start, options.stride, name) for name in names)
        reports.extend(stack.enter_context(bar) for bar in bars)
        outcome = run.track(reports[-1], stopped)
    close(source.path, options.output, outcome, passes)
