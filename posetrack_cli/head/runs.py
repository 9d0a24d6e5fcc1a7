"""Runs of the head trackers, made from recording, configuration and options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from posetrack_cli.errors import UsageError
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from posetrack_cli.head.multilinear.face_model import FaceModel, load_face_model
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.several_run import HeadsRun
from posetrack_cli.head.subject import MONO_TRACK, head_subject, mono_subject
from posetrack_cli.head.tracker.given_person import GivenPerson, read_person
from posetrack_cli.head.tracker.mono import make_mono_tracker
from posetrack_cli.head.tracker.several import HeadsTracker, people_of
from posetrack_cli.head.tracker.stereo import components_of, make_stereo_tracker
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.recording import Recording
from posetrack_cli.tracking.run import Report
from posetrack_cli.tracking.two_pass import Learned, LearningTracker


def make_stereo_run(
    source: Recording, config: HeadStereoConfig, options: HeadRunOptions, first_pass: Report
) -> HeadRun:
    """Return a run of the tracker for several cameras; see ``HeadRun``."""
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


def make_mono_run(
    source: Recording,
    config: HeadMonoConfig,
    options: HeadRunOptions,
    face: int,
    first_pass: Report,
) -> HeadRun:
    """Return a run of the tracker for one camera; ``face`` counts from 1, the largest first."""
    (camera,) = source.cameras
    file = None if config.model.file is None else Path(config.model.file)
    clicked = None if options.init is None else Path(options.init)
    model = load_face_model(file)
    given = _given_person(options, config, model)
    systematic_sd = MONO_TRACK.systematic_sd if given is None else given.systematic_sd

    def make_tracker(known: Learned | None) -> LearningTracker[Any]:
        if known is None and given is not None:
            known = given.learned
        return make_mono_tracker(
            config,
            camera,
            known,
            face=face - 1,
            clicked=clicked,
            landmarks=options.landmarks,
            systematic_sd=systematic_sd,
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
        extra_record=_stated(source, file, face, _scale_from(config, given)),
    )


def make_heads_run(
    source: Recording, config: HeadMonoConfig, options: HeadRunOptions, first_pass: Report
) -> HeadsRun:
    """Return a run that tracks all heads in the images of one camera; see ``HeadsRun``.

    Raises:
        UsageError: an option applies to one person.
    """
    (camera,) = source.cameras
    file = None if config.model.file is None else Path(config.model.file)
    model = load_face_model(file)
    _check_of_all(config, options)

    def make_tracker(known: Learned | None) -> LearningTracker[Any]:
        people: list[Learned | None] = [None] if known is None else [*people_of(known)]
        trackers = [make_mono_tracker(config, camera, one, follows_one=True) for one in people]
        return HeadsTracker(camera, trackers, is_second_pass=known is not None)

    run = HeadsRun(
        source,
        config,
        options,
        name="head-mono",
        subject=mono_subject(camera.name, model),
        flush_frames=config.output.flush_frames,
        make_tracker=make_tracker,
        origin=model.deformation_mean,
        first_pass=first_pass,
        extra_record=_stated(source, file, "all", "prior"),
    )
    run.check_passes()
    return run


def _check_of_all(config: HeadMonoConfig, options: HeadRunOptions) -> None:
    """Raise UsageError for options that apply to one person."""
    given = {
        "--init": options.init,
        "--landmarks": options.landmarks,
        "--load-model": options.load_model,
        "--save-model": options.save_model,
        "--person": options.person,
        "--interpupillary-mm": config.person.interpupillary_mm,
    }
    for name, value in given.items():
        if value is not None:
            raise UsageError(
                f"{name} applies to one face", hint="leave out --faces all, or choose one with --face N"
            )


def guess_note(source: Recording, option: str, *, is_given: bool) -> str:
    """Return a note on the focal length of an uncalibrated camera; empty for a calibrated one.

    Args:
        source: the recording.
        option: name of the option or parameter of the field of view.
        is_given: whether the user gave it.
    """
    if not source.is_guessed:
        return ""
    by = option if is_given else f"field of view of 53 degrees; change it with {option}"
    return (
        f"no calibration: focal length set to {source.cameras[0].fx:.0f} px ({by}); distances are approximate"
    )


def _given_person(options: HeadRunOptions, config: HeadMonoConfig, model: FaceModel) -> GivenPerson | None:
    """Read the person of --person, if given.

    Raises:
        UsageError: --person conflicts with another option.
    """
    if options.person is None:
        return None
    others = {"--load-model": options.load_model, "--init": options.init}
    for name, given in others.items():
        if given is not None:
            what = f"--person and {name} are mutually exclusive"
            raise UsageError(what, found=given, hint="leave one of them out")
    person = read_person(options.person, model, config.adjustment)
    if person.size is not None and config.person.interpupillary_mm is not None:
        raise UsageError(
            "--person and --interpupillary-mm both set the size of the head",
            where=options.person,
            found=f"{config.person.interpupillary_mm:g} mm",
            hint="leave one of them out",
        )
    return person


def _scale_from(config: HeadMonoConfig, given: GivenPerson | None) -> str:
    """Return the source of the head's size, for the run record."""
    if config.person.interpupillary_mm is not None:
        return "interpupillary"
    return "prior" if given is None or given.size is None else "person"


def _stated(source: Recording, face_model: Path | None, face: int | str, scale: str) -> dict[str, str]:
    """Return entries of the run record: assumptions that the images do not determine."""
    stated = {
        "scale": scale,
        "intrinsics": "guessed" if source.is_guessed else "given",
        "face": str(face),
        "face_model": "shipped",
    }
    if face_model is None:
        return stated
    return stated | {"face_model": shown_name(face_model), "face_model.sha256": file_digest(face_model)[1]}
