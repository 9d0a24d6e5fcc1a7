"""``head stereo`` and ``head mono``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
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
from posetrack_cli.cli.running import close, compiling_said, kept, open_for_reading, progress, tell_settings
from posetrack_cli.cli.terminal import print_aside, print_note
from posetrack_cli.errors import UsageError

if TYPE_CHECKING:
    from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
    from posetrack_cli.head.landmarks.faces import LandmarkFile
    from posetrack_cli.head.multilinear.face_model import FaceModel
    from posetrack_cli.head.run import HeadRun, HeadRunOptions
    from posetrack_cli.head.tracker.given_person import GivenPerson
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.tracking.run import Report
    from posetrack_cli.tracking.two_pass import Learned, LearningTracker


# Options of the commands that track heads, and what these do alike


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
    option(
        "--detector", type=click.Choice(["haar", "yunet"]), help="Face detector.  [default: haar]", rare=True
    ),
    option(
        "--detector-model",
        metavar="FILE.onnx",
        type=NameOrFile(),
        help="The model of --detector yunet, such as face_detection_yunet_2023mar.onnx of OpenCV's model "
        "zoo.",
        rare=True,
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
        rare=True,
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
    from posetrack_cli.head.landmarks.faces import read_landmarks
    from posetrack_cli.recording.keypoints.reading import fitted_to

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


# ``posetrack head stereo``: pose and face deformation from calibrated cameras


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
    track_head(source, passes, chosen, lambda first_pass: _stereo_run(source, config, chosen, first_pass))


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


def _stereo_run(
    source: Recording, config: HeadStereoConfig, options: HeadRunOptions, first_pass: Report
) -> HeadRun:
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


# ``posetrack head mono``: pose and face deformation from one camera


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
    short_help="Track a head in the images of one camera.",
)
@click.argument("recording", type=FILE)
@result_options("The result, and the model of --save-model")
@option_group(
    option(
        "--interpupillary-mm",
        metavar="MM",
        type=float,
        help="Distance of the person's pupils when looking far away: it tells how large and how far the "
        "head is.",
    ),
    option(
        "--person",
        metavar="RESULT",
        type=FILE,
        help="Who it is: another result of posetrack head of the same person, with one camera or several, "
        "whose shape and size are held.",
    ),
    option(
        "--face-model",
        metavar="FILE.npz",
        type=NameOrFile(),
        help="Faces that there are, as head build-model writes it.  [default: shipped]",
        rare=True,
    ),
    option(
        "--adjust",
        type=click.Choice(["always", "start", "never"]),
        help="When the person's face is adjusted to the images: after every frame that allows it, only at "
        "the start, or never (an average face).  [default: always]",
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
        help="Which of several faces in the first frames; 1 is the largest.",
    ),
    title=START,
)
@option_group(particles_option(750), title=CONFIGURATION)
@configuration_options("head-mono (the defaults), head-mono-paper", "adjustment.views=10")
@frame_options
@one_camera_options
@option(
    "--fov",
    metavar="DEG",
    type=float,
    help="Field of view along the image's longer side, where no calibration tells the focal length.  "
    "[default: 53, a guess]",
    group=READ,
)
@volume_options
def head_mono(recording: Path, **options: Any) -> None:
    """Track the head in RECORDING: a video, a folder of images, MCAP or a bag of ROS.

    The face is found by itself, any person's; who it is and how it deforms is adjusted to the images within a
    model of faces. The result is MCAP with pose, velocity, ten points, deformation and identity. One camera
    sees no scale: distance and size rest on what faces are like, and on the focal length, which is guessed
    where neither recording nor --camera tells it. The same input, configuration and seed give the same bytes.
    Exit code 3: some data could not be used, or less than 5 % of the frames were tracked.
    """
    from posetrack_cli.head.config import HeadMonoConfig

    source = open_mono_recording(recording, options)
    config = head_configuration(HeadMonoConfig, options, OWN_CONFIGURED)
    chosen, face = head_run_options(options, source), options["face"]
    if chosen.init is not None and face > 1:
        raise UsageError("--face does not apply to clicked points", found=face, hint="leave it out")

    def made(first_pass: Report) -> HeadRun:
        run = _mono_run(source, config, chosen, face, first_pass)
        _say_guess(source, options["fov"])
        return run

    track_head(source, config.run.passes, chosen, made)


def open_mono_recording(recording: Path, options: dict[str, Any]) -> Recording:
    """Return the recording of one camera, which may be guessed."""
    from posetrack_cli.recording.camera_of import Guess, guess_of_field
    from posetrack_cli.recording.grey import PLAIN_BITS, Grey

    fov = options["fov"]
    guess = Guess() if fov is None else guess_of_field(fov)
    source = open_for_reading(recording, options, "grey", guess=guess)
    if fov is not None and not source.is_guessed:
        raise UsageError(
            "--fov does not apply to a calibrated camera",
            where=recording,
            found=_focal(source),
            hint="leave it out",
        )
    if any(isinstance(pixels, Grey) and pixels.bits > PLAIN_BITS for pixels in source.pixels):
        bits = "images of more than 8 bits are taken for light"
        print_note(f"{recording}: {bits}; if they are depth, posetrack hand run tracks hands in them")
    return source


def _say_guess(source: Recording, fov: float | None) -> None:
    if not source.is_guessed:
        return
    by = "a field of view of 53 degrees, --fov says another" if fov is None else "--fov"
    taken = f"no calibration: focal length taken for {_focal(source)} ({by})"
    print_note(f"{source.path}: {taken}; distances are a guess")


def _focal(source: Recording) -> str:
    return f"{source.cameras[0].fx:.0f} px"


def _mono_run(
    source: Recording,
    config: HeadMonoConfig,
    options: HeadRunOptions,
    face: int,
    first_pass: Report,
) -> HeadRun:
    """Everything that can be refused is refused here, before the first frame."""
    from posetrack_cli.head.multilinear.face_model import load_face_model
    from posetrack_cli.head.run import HeadRun
    from posetrack_cli.head.subject import mono_subject
    from posetrack_cli.head.tracker.mono import make_mono_tracker

    (camera,) = source.cameras
    file = None if config.model.file is None else Path(config.model.file)
    clicked = None if options.init is None else Path(options.init)
    model = load_face_model(file)
    given = _given_person(options, config, model)
    person = {} if given is None else {"systematic_sd": given.systematic_sd}

    def make_tracker(known: Learned | None) -> LearningTracker[Any]:
        if known is None and given is not None:
            known = given.learned
        return make_mono_tracker(
            config, camera, known, face=face - 1, clicked=clicked, landmarks=options.landmarks, **person
        )

    return HeadRun(
        source,
        config,
        options,
        name="head-mono",
        subject=mono_subject(camera.name, model),
        flush_frames=config.output.flush_frames,
        make_tracker=make_tracker,
        origin=model.deformation_mean,
        first_pass=first_pass,
        stated=_stated(source, file, face, _scale_from(config, given)),
    )


def _given_person(options: HeadRunOptions, config: HeadMonoConfig, model: FaceModel) -> GivenPerson | None:
    """Who it is, where a result says that.

    Raises:
        UsageError: other options say something else of it.
    """
    from posetrack_cli.head.tracker.given_person import read_person

    if options.person is None:
        return None
    others = {"--load-model": options.load_model, "--init": options.init}
    for name, given in others.items():
        if given is not None:
            what = f"--person and {name} both say how to begin"
            raise UsageError(what, found=given, hint="leave one of them out")
    person = read_person(options.person, model, config.adjustment)
    if person.size is not None and config.person.interpupillary_mm is not None:
        raise UsageError(
            "--person says how large the person is, and so does --interpupillary-mm",
            where=options.person,
            found=f"{config.person.interpupillary_mm:g} mm",
            hint="leave one of them out",
        )
    return person


def _scale_from(config: HeadMonoConfig, given: GivenPerson | None) -> str:
    """What the size of the head rests on."""
    if config.person.interpupillary_mm is not None:
        return "interpupillary"
    return "prior" if given is None or given.size is None else "person"


def _stated(source: Recording, face_model: Path | None, face: int, scale: str) -> dict[str, str]:
    """What the run record says besides: what the result rests on that is not in the images."""
    from posetrack_cli.recording.identity import file_digest, shown_name

    stated = {
        "scale": scale,
        "intrinsics": "guessed" if source.is_guessed else "given",
        "face": str(face),
        "face_model": "shipped",
    }
    if face_model is None:
        return stated
    return stated | {"face_model": shown_name(face_model), "face_model.sha256": file_digest(face_model)[1]}
