"""Runs of the head trackers, made from recording, configuration and options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import (
    FaceSettings,
    HeadMonoConfig,
    HeadStereoConfig,
    PersonSettings,
    SkinSettings,
)
from posetrack_cli.head.lens.estimation import estimate_lens
from posetrack_cli.head.lens.lens import EstimatedLens
from posetrack_cli.head.multilinear.face_model import FaceModel, load_face_model
from posetrack_cli.head.run import HeadRun, HeadRunOptions, check_head_run
from posetrack_cli.head.several_run import HeadsRun
from posetrack_cli.head.subject import MONO_TRACK, head_subject, mono_subject, with_dense_face
from posetrack_cli.head.tracker.given_person import GivenPerson, read_person
from posetrack_cli.head.tracker.mono import MonoPeople, MonoTracker, make_mono_people, make_mono_tracker
from posetrack_cli.head.tracker.several import make_heads_tracker, of_head
from posetrack_cli.head.tracker.stereo import StereoTracker, components_of, make_stereo_tracker
from posetrack_cli.recording.camera_of import guess_of_camera
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.estimate import Subject
from posetrack_cli.tracking.run import Report
from posetrack_cli.tracking.two_pass import Learned, LearningTracker


def make_stereo_run(
    source: Recording,
    config: HeadStereoConfig,
    options: HeadRunOptions,
    first_pass: Report,
    *,
    all_faces: bool = False,
) -> HeadRun:
    """Return a run of the tracker for several cameras, of one head or of all; see ``HeadRun``.

    Raises:
        UsageError: an option applies to one head.
    """
    cameras, clicked = source.cameras, None if options.init is None else Path(options.init)

    def make_one(known: Learned | None, trail: FloatArray | None = None) -> StereoTracker:
        return make_stereo_tracker(config, cameras, known, clicked=clicked, landmarks=options.landmarks)

    def make_all(known: Learned | None) -> LearningTracker[Any]:
        return make_heads_tracker(cameras, known, make_one)

    if all_faces:
        _check_of_all(config, options)
    return (HeadsRun if all_faces else HeadRun)(
        source,
        config,
        options,
        name="head-stereo",
        subject=_subject(head_subject(cameras[0].name, components_of(config)), config),
        flush_frames=config.output.flush_frames,
        make_tracker=make_all if all_faces else make_one,
        first_pass=first_pass,
        extra_record={"face": "all"} if all_faces else {},
    )


def make_mono_run(
    source: Recording,
    config: HeadMonoConfig,
    options: HeadRunOptions,
    face: int,
    first_pass: Report,
    *,
    fov_is_given: bool = False,
) -> HeadRun:
    """Return a run of the tracker for one camera.

    Args:
        source: the recording.
        config: of the run.
        options: of the run.
        face: face to track, from 1, the largest first.
        first_pass: see ``HeadRun``.
        fov_is_given: whether the user states the focal length of a camera without calibration; otherwise it
            is estimated.
    """
    file = None if config.model.file is None else Path(config.model.file)
    clicked = None if options.init is None else Path(options.init)
    model = load_face_model(file)
    given = _given_person(options, config, model)
    systematic_sd = MONO_TRACK.systematic_sd if given is None else given.systematic_sd
    source, lens = _with_lens(source, config, options, face, fov_is_given=fov_is_given)
    (camera,) = source.cameras

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
            lens=lens,
        )

    return HeadRun(
        source,
        config,
        options,
        name="head-mono",
        subject=_subject(mono_subject(camera.name, model), config),
        flush_frames=config.output.flush_frames,
        make_tracker=make_tracker,
        origin=model.deformation_mean,
        first_pass=first_pass,
        extra_record=_stated(source, lens, file, face, _scale_from(config, given)),
    )


def _with_lens(
    source: Recording, config: HeadMonoConfig, options: HeadRunOptions, face: int, *, fov_is_given: bool
) -> tuple[Recording, EstimatedLens | None]:
    """Return the recording with an estimated camera if it has no calibration, and that camera."""
    if not (source.is_guessed and config.lens.estimate) or fov_is_given:
        return source, None
    check_head_run(source, options)  # before some seconds of work
    parts = {"skin": SkinSettings(use=True), "face": FaceSettings(use=False)}
    with_skin = config.model_copy(update=parts)
    clicked = None if options.init is None else Path(options.init)

    def make_people(camera: Camera) -> MonoPeople:
        return make_mono_people(
            with_skin, camera, face=face - 1, clicked=clicked, landmarks=options.landmarks
        )

    lens = estimate_lens(source, options, make_people)
    return source.with_camera(lens.camera), lens


def _subject(subject: Subject, config: HeadStereoConfig | HeadMonoConfig) -> Subject:
    return with_dense_face(subject) if config.face.use else subject


def make_heads_run(
    source: Recording,
    config: HeadMonoConfig,
    options: HeadRunOptions,
    first_pass: Report,
    *,
    fov_is_given: bool = False,
) -> HeadsRun:
    """Return a run that tracks all heads in the images of one camera; see ``HeadsRun`` and ``make_mono_run``.

    Raises:
        UsageError: an option applies to one person.
    """
    file = None if config.model.file is None else Path(config.model.file)
    model = load_face_model(file)
    _check_of_all(config, options)
    source, lens = _with_lens(source, config, options, 1, fov_is_given=fov_is_given)
    (camera,) = source.cameras

    def make_one(known: Learned | None, trail: FloatArray) -> MonoTracker:
        return make_mono_tracker(config, camera, known, lens=of_head(lens, trail), follows_one=True)

    return HeadsRun(
        source,
        config,
        options,
        name="head-mono",
        subject=_subject(mono_subject(camera.name, model), config),
        flush_frames=config.output.flush_frames,
        make_tracker=lambda known: make_heads_tracker((camera,), known, make_one),
        origin=model.deformation_mean,
        first_pass=first_pass,
        extra_record=_stated(source, lens, file, "all", "prior"),
    )


def _check_of_all(config: HeadMonoConfig | HeadStereoConfig, options: HeadRunOptions) -> None:
    """Raise UsageError unless there are two passes, and for options that apply to one person."""
    if config.run.passes != 2:
        hint = "add --passes 2, or track one face"
        raise UsageError("all faces require two passes", found=config.run.passes, hint=hint)
    given = {
        "--init": options.init,
        "--landmarks": options.landmarks,
        "--load-model": options.load_model,
        "--save-model": options.save_model,
        "--person": options.person,
        "--interpupillary-mm": getattr(config, "person", PersonSettings()).interpupillary_mm,
    }
    for name, value in given.items():
        if value is not None:
            raise UsageError(f"{name} applies to one face", hint="leave out --faces all")


def guess_note(run: HeadRun, option: str) -> str:
    """Return a note on the focal length of an uncalibrated camera; empty for a calibrated one.

    Args:
        run: the run.
        option: name of the option or parameter of the field of view.
    """
    (camera,), record = run.cameras, run.record
    if record["intrinsics"] == "given":
        return ""
    focal, fov = f"{camera.fx:.0f}", f"{guess_of_camera(camera).fov_deg:.0f} degrees"
    if record["intrinsics"] == "guessed":
        return f"no calibration: focal length set to {focal} px ({fov}); distances are approximate"
    sd = float(record["focal_sd_px"])
    return (
        f"no calibration: focal length estimated as {focal} +- {sd:.0f} px (field of view {fov}); state the "
        f"field of view with {option} if you know it"
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


def _stated(
    source: Recording, lens: EstimatedLens | None, face_model: Path | None, face: int | str, scale: str
) -> dict[str, str]:
    """Return entries of the run record: assumptions that the images do not determine."""
    stated = {
        "scale": scale,
        "intrinsics": "guessed" if source.is_guessed else "given",
        "face": str(face),
        "face_model": "shipped",
        **({} if lens is None else lens.record()),
    }
    if face_model is None:
        return stated
    return stated | {"face_model": shown_name(face_model), "face_model.sha256": file_digest(face_model)[1]}
