"""``head stereo`` and ``head mono``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from posetrack_cli import limits
from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    CONFIGURATION,
    FILE,
    READ,
    RUN_OPTIONS,
    NameOrFile,
    configuration_of,
    configuration_options,
    frame_options,
    image_options,
    init_option,
    one_camera_options,
    option_group,
    particles_option,
    result_options,
)
from posetrack_cli.cli.process import stop_signals
from posetrack_cli.cli.running import (
    announce_compiling,
    close,
    name_partial_result,
    open_for_reading,
    print_settings,
    progress,
)
from posetrack_cli.cli.terminal import print_info, print_note
from posetrack_cli.errors import UsageError

if TYPE_CHECKING:
    from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
    from posetrack_cli.head.landmarks.faces import LandmarkFile
    from posetrack_cli.head.run import HeadRun, HeadRunOptions
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.tracking.run import Report


# Shared by head stereo and head mono


HeadConfig = TypeVar("HeadConfig", "HeadStereoConfig", "HeadMonoConfig")
# Configuration keys by option name
CONFIGURED = {
    "particles": "particles.count",
    "detector": "start.detection.detector",
    "detector_model": "start.detection.model",
    "passes": "run.passes",
}
HEAD_RUN_OPTIONS = (*RUN_OPTIONS, "load_model", "save_model", "smooth")


LEARNED, START = "Learning", "Initialisation and landmarks"


learning_options = option_group(
    option(
        "--passes",
        metavar="1|2",
        type=click.IntRange(1, 2),
        help="Number of passes over the recording; the second starts from the model learned in the first and "
        "gives the result.  [default: 2 for head mono, 1 for head stereo and head-mono-paper]",
    ),
    option(
        "--save-model",
        metavar="FILE.npz",
        type=FILE,
        help="Write the learned model.",
    ),
    option(
        "--load-model",
        metavar="FILE",
        type=FILE,
        help="Start from a model learned in an earlier run of the same person: its --save-model file or "
        "result.",
    ),
    title=LEARNED,
)


start_options = option_group(
    option(
        "--detector", type=click.Choice(["haar", "yunet"]), help="Face detector.  [default: haar]", rare=True
    ),
    option(
        "--detector-model",
        metavar="FILE.onnx",
        type=NameOrFile(),
        help="Model file for --detector yunet, e.g. face_detection_yunet_2023mar.onnx from the OpenCV model "
        "zoo.",
        rare=True,
    ),
    init_option(
        "auto|FILE.csv",
        "Initialisation: detect the face (auto), or a CSV table camera,point,x,y of points marked in the "
        "first frame.",
        default="auto",
    ),
    option(
        "--landmarks",
        "landmark_file",
        metavar="FILE",
        type=FILE,
        help="Face landmarks per frame from another detector, in images of the reference camera, CSV or "
        "JSON: 68 from OpenFace, 478 from MediaPipe, or ten by name (docs/landmarks.md).",
    ),
    option(
        "--landmarks-unit",
        type=click.Choice(["px", "normalised"]),
        help="Unit of the landmarks.  [default: from FILE]",
        rare=True,
    ),
)


def head_configuration(
    kind: type[HeadConfig], options: Mapping[str, Any], own: Mapping[str, str]
) -> HeadConfig:
    """Return the configuration of a head tracker; see ``configuration_of``.

    Args:
        kind: class of the configuration.
        options: values of the command's options.
        own: configuration keys by option name, for options that only this command has.

    Raises:
        UsageError: invalid settings, such as a model for a detector without one.
    """
    config = configuration_of(kind, options, {**CONFIGURED, **own})
    print_settings(config)
    detector = config.start.detection.detector
    if options["detector_model"] is not None and detector != "yunet":
        raise UsageError(
            "--detector-model does not apply", found=f"detector {detector}", hint="add --detector yunet"
        )
    return config


def head_run_options(options: Mapping[str, Any], source: Recording) -> HeadRunOptions:
    """Return the run options, and print how a landmark file was interpreted.

    Args:
        options: values of the command's options.
        source: the recording; landmarks refer to images of its reference camera.
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
            hint = "add --landmarks FILE or leave it out"
            raise UsageError("--landmarks-unit requires --landmarks", hint=hint)
        return None
    from posetrack_cli.head.landmarks.faces import read_landmarks
    from posetrack_cli.recording.keypoints.reading import fitted_to

    landmarks = read_landmarks(path, source.cameras[0], unit)
    sets, words = fitted_to(landmarks.sets, source)
    landmarks = replace(landmarks, sets=sets)
    print_info(f"{path}: {landmarks.line}{words and f'; {words}'}")
    return landmarks


def track_head(
    source: Recording, passes: int, options: HeadRunOptions, made: Callable[[Report], HeadRun]
) -> None:
    """Track with a progress bar per pass, print the closing lines and set the exit code.

    Args:
        source: the recording.
        passes: number of passes.
        options: run options.
        made: creates the run, given the progress callback of its first pass; raises on unusable input.
    """
    from posetrack_cli.tracking.options import frames_ahead

    names = ("head",) if passes == 1 else ("pass 1", "pass 2")
    with (
        announce_compiling(options.output) as is_compiling,
        stop_signals(is_compiling) as stopped,
        name_partial_result(options.output),
        ExitStack() as stack,
    ):
        # The run reports to bars that are created after it, so the callback looks them up late.
        reports: list[Report] = []
        run = made(lambda estimate: reports[0](estimate))  # may print, so the bars come later
        total = frames_ahead(source, options)
        bars = (progress(total, options.start, options.stride, name) for name in names)
        reports.extend(stack.enter_context(bar) for bar in bars)
        outcome = run.track(reports[-1], stopped)
    close(source.path, options.output, outcome, passes)


FACES = option(
    "--faces",
    type=click.Choice(["all"]),
    help="Track all faces, each as a track of its own: 1, 2 and so on. Requires two passes.",
)

# posetrack head stereo


@click.command(
    "stereo",
    cls=Command,
    examples=(
        "posetrack head stereo recording.mcap -o head.mcap",
        "posetrack head stereo images/ --fps 30 --camera rig.toml -o head.mcap",
    ),
    short_help="Track a head with two or more calibrated cameras.",
)
@click.argument("recording", type=FILE)
@result_options("RESULT.mcap and the --save-model file if they exist")
@option(
    "--model",
    type=click.Choice(["deformable", "rigid"]),
    help="Learn and track face deformations, or track a rigid face.  [default: deformable]",
    group=LEARNED,
)
@learning_options
@option_group(start_options, FACES, title=START)
@option_group(particles_option(1000), title=CONFIGURATION)
@configuration_options("head-stereo (default), head-stereo-paper", "model.components=3")
@frame_options
@image_options
@volume_options
def head_stereo(recording: Path, **options: Any) -> None:
    """Track the head in RECORDING: an MCAP file, ROS bag, or folder with one image folder per camera.

    Requires two or more calibrated cameras. The face is detected automatically and its deformations are
    learned during tracking. The result (MCAP) holds pose, velocity, ten face points, deformation and the
    learned model. The same input, configuration and seed give an identical file. Exit code 3: some data was
    unusable, or fewer than 5 % of the frames were tracked.
    """
    from posetrack_cli.head.config import HeadStereoConfig
    from posetrack_cli.head.runs import make_stereo_run

    source = open_stereo_recording(recording, options)
    config = head_configuration(HeadStereoConfig, options, {"model": "model.kind"})
    chosen = head_run_options(options, source)
    make_run = partial(make_stereo_run, source, config, chosen, all_faces=options["faces"] is not None)
    track_head(source, config.run.passes, chosen, make_run)


def open_stereo_recording(recording: Path, options: dict[str, Any]) -> Recording:
    """Open a recording with at least two cameras."""
    source = open_for_reading(recording, options, "grey")
    if len(source.cameras) < 2:
        raise UsageError(
            "too few cameras",
            where=recording,
            found=f"only '{source.cameras[0].name}'",
            expected="2 or more",
            hint="a folder needs one image folder per camera, such as left/ and right/",
        )
    return source


# posetrack head mono


OWN_CONFIGURED = {
    "adjust": "adjustment.when",
    "face_model": "model.file",
    "interpupillary_mm": "person.interpupillary_mm",
}


@click.command(
    "mono",
    cls=Command,
    examples=(
        "posetrack head mono face.mp4 -o face.mcap",
        "posetrack head mono recording.mcap --cameras left --smooth -o face.mcap",
        "posetrack head mono face.mp4 --fov 70 --interpupillary-mm 62 -o face.mcap",
    ),
    short_help="Track a head with one camera.",
)
@click.argument("recording", type=FILE)
@result_options("RESULT.mcap and the --save-model file if they exist")
@option_group(
    option(
        "--interpupillary-mm",
        metavar="MM",
        type=float,
        help="Interpupillary distance for far vision; sets the scale of head size and distance.",
    ),
    option(
        "--person",
        metavar="RESULT",
        type=FILE,
        help="Use (and fix) the face shape and size from an earlier result of the same person, from head "
        "mono or head stereo.",
    ),
    option(
        "--face-model",
        metavar="FILE.npz",
        type=NameOrFile(),
        help="Face model written by head build-model.  [default: shipped]",
        rare=True,
    ),
    option(
        "--adjust",
        type=click.Choice(["always", "start", "never"]),
        help="When to fit the face model to the person: after every suitable frame, only at the start, or "
        "never (average face).  [default: always]",
    ),
    title="Person",
)
@learning_options
@option_group(
    start_options,
    option(
        "--face",
        metavar="N",
        type=click.IntRange(min=1, max=limits.FACES),
        default=1,
        show_default=True,
        help="Face to track, by size in the first frames; 1 is the largest.",
    ),
    FACES,
    title=START,
)
@option_group(particles_option(750), title=CONFIGURATION)
@configuration_options("head-mono (default), head-mono-paper", "adjustment.views=10")
@frame_options
@one_camera_options
@option(
    "--fov",
    metavar="DEG",
    type=float,
    help="Field of view along the longer image side, if the camera is not calibrated.  [default: "
    "estimated from the face]",
    group=READ,
)
@volume_options
def head_mono(recording: Path, **options: Any) -> None:
    """Track the head in RECORDING: a video, image folder, MCAP file or ROS bag.

    The face is detected automatically; a face model is fitted to the person's identity and deformation. The
    result (MCAP) holds pose, velocity, ten face points, deformation and identity. A single camera cannot
    measure scale: distance and size follow from the average face and from the focal length, which is
    estimated without a calibration (--camera, --fov). The same input, configuration and seed give an
    identical file. Exit code 3: some data was unusable, or fewer than 5 % of the frames were tracked.
    """
    from posetrack_cli.head.config import HeadMonoConfig

    source = open_mono_recording(recording, options)
    config = head_configuration(HeadMonoConfig, options, OWN_CONFIGURED)
    chosen, face = head_run_options(options, source), options["face"]
    if chosen.init is not None and face > 1:
        raise UsageError("--face cannot be combined with --init FILE", found=face, hint="leave it out")

    if options["faces"] is not None and face > 1:
        raise UsageError(
            "--face and --faces are mutually exclusive", found=face, hint="leave one of them out"
        )

    def made(first_pass: Report) -> HeadRun:
        from posetrack_cli.head.runs import guess_note, make_heads_run, make_mono_run

        run: HeadRun
        fov_is_given = options["fov"] is not None
        if options["faces"] is None:
            run = make_mono_run(source, config, chosen, face, first_pass, fov_is_given=fov_is_given)
        else:
            run = make_heads_run(source, config, chosen, first_pass, fov_is_given=fov_is_given)
        note = guess_note(run, "--fov")
        if note:
            print_note(f"{source.path}: {note}")
        return run

    track_head(source, config.run.passes, chosen, made)


def open_mono_recording(recording: Path, options: dict[str, Any]) -> Recording:
    """Open a recording of one camera; without a calibration, the focal length is guessed."""
    from posetrack_cli.recording.camera_of import Guess, guess_of_field
    from posetrack_cli.recording.grey import PLAIN_BITS, Grey

    fov = options["fov"]
    guess = Guess() if fov is None else guess_of_field(fov)
    source = open_for_reading(recording, options, "grey", guess=guess)
    if fov is not None and not source.is_guessed:
        raise UsageError(
            "--fov cannot be used with a calibrated camera",
            where=recording,
            found=f"{source.cameras[0].fx:.0f} px",
            hint="leave it out",
        )
    if any(isinstance(pixels, Grey) and pixels.bits > PLAIN_BITS for pixels in source.pixels):
        note = "images of more than 8 bits are read as intensities"
        print_note(f"{recording}: {note}; for depth images, use posetrack hand run")
    return source
