"""Heads: time per frame with two cameras and with one, for the tracker alone and from file to file."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarking.processes import peak_memory
from benchmarking.recordings import link_recording, there_and_back
from benchmarking.rows import Row, fitted_line, median_ms, median_of_pairs
from benchmarking.stepping import SETTLING, FrameClock, Walker, in_turn
from posetrack_cli.configuration import load_settings
from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.adjustment.adjuster import Adjuster, PersonParameters, PointView
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig, RunSettings
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.initialisation.mono import DetectedFace, MonoInitialiser
from posetrack_cli.head.multilinear.face_model import FaceModel, load_face_model
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.subject import head_subject, mono_subject
from posetrack_cli.head.tracker import face_learning
from posetrack_cli.head.tracker.mono import make_mono_tracker
from posetrack_cli.head.tracker.stereo import components_of, make_stereo_tracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.writing import write_synthetic
from posetrack_cli.tracking.two_pass import Learned

FPS = 30.0
FEW, MANY = 1000, 5000
STEREO_MS, STEREO_FILES_MS, STEREO_CPU_MS = 1e3 / 150.0, 1e3 / 60.0, 7.0
INDEPENDENT = 1.25  # allowed ratio of frame times with MANY and FEW particles
MONO_MS, ADJUSTING_MS, START_MS, MONO_FILES_MS, MONO_CPU_MS = 3.0, 6.0, 70.0, 10.0, 10.0
VIEWS = (5, 10, 20, 40, 60)
LINEAR_PERCENT = 15.0
NOISE_PX = 0.5
BEGINNINGS = 15


def heads(frames: int, steps: int, memory_frames: int, repeats: int) -> Iterator[Row]:
    """Yield all rows of one synthetic head, whose frames are repeated forwards and backwards.

    Args:
        frames: frames to generate.
        steps: frames to track.
        memory_frames: frames of the long run.
        repeats: repetitions of short timings.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_synthetic(HeadSynthOptions(frames=frames, fps=FPS), folder / "seen")
        yield from stereo_alone(folder / "seen", steps)
        link_recording(folder / "long", folder / "seen", memory_frames)
        yield from stereo_files(folder, steps)
        command = ["head", "stereo", str(folder / "long"), "--fps", str(FPS)]
        yield from peak_memory("head stereo", command, memory_frames, folder)
        recording = open_recording(folder / "seen", "grey", cameras=("left",))
        camera, seen = recording.cameras[0], list(recording.frames())
        shown = [seen[index].images for index in there_and_back(len(seen), steps)]
        yield from mono_alone(camera, shown)
        yield from beginning(camera, seen)
        yield from adjusting(camera, repeats)
        yield from mono_files(folder, [image for (image,) in shown if image is not None])
        command = ["head", "mono", str(folder / "long"), "--fps", str(FPS), "--cameras", "left"]
        (folder / "results").mkdir()
        yield from peak_memory("head mono", command, memory_frames, folder / "results")


def _rated(name: str, value: float, target: float | None) -> Iterator[Row]:
    yield Row(name, value, "ms", target)
    yield Row("  that is", 1e3 / value, "frames/s")


def _lost(walkers: Mapping[Any, Walker]) -> Row:
    lost = sum(walker.lost for walker in walkers.values())
    return Row("  frames in which a head was lost", lost, "", 0.0)


# Two cameras


def stereo_settings(particles: int, **model: float) -> HeadStereoConfig:
    """Return the defaults with a number of particles, and changes of ``model``."""
    changes = {f"model.{name}": value for name, value in model.items()}
    return load_settings(HeadStereoConfig, None, {"particles.count": particles} | changes)


def stereo_alone(path: Path, steps: int) -> Iterator[Row]:
    """Yield times of four trackers on the same images: few and many particles, new and learned face.

    A new face is rigid; a learned one deforms, which takes longer.
    """
    recording = open_recording(path, "grey")
    images = [frame.images for frame in recording.frames()]
    shown = [images[index] for index in there_and_back(len(images), steps)]
    cameras = recording.cameras
    known = learnt_face(cameras, shown)
    walkers = {
        (count, learnt): Walker(
            make_stereo_tracker(stereo_settings(count), cameras, known if learnt else None)
        )
        for count in (FEW, MANY)
        for learnt in (False, True)
    }
    times = in_turn(walkers, shown, SETTLING)
    for learnt, title in ((False, "new, rigid face"), (True, "learnt face")):
        name = f"head stereo, N = {FEW}, tracking alone, {title}"
        yield from _rated(name, median_ms(times[FEW, learnt]), STEREO_MS)
    ratio = median_of_pairs(times[MANY, True], times[FEW, True])
    yield Row(f"head stereo, N = {MANY} / N = {FEW}, learnt face, median of pairs", ratio, "", INDEPENDENT)
    yield Row("  deformations of the learnt face", deformations_of(walkers[FEW, True].last), "")
    yield _lost(walkers)


def learnt_face(cameras: Sequence[Camera], shown: Sequence[Any]) -> Learned:
    """Return a model learned with open gates, since a short recording has hardly any expressions."""
    usual, face_learning.LEAST_MM = face_learning.LEAST_MM, 0.1
    try:
        walker = Walker(make_stereo_tracker(stereo_settings(FEW, rigid_frames=10), cameras))
        for index, images in enumerate(shown):
            walker.step(index, images)
    finally:
        face_learning.LEAST_MM = usual
    learned: Learned = walker.tracker.learned(walker.state)
    return learned


def deformations_of(estimate: Estimate | None) -> int:
    """Return the number of components of the learned model in a frame."""
    if estimate is None or estimate.numbers is None:
        return 0
    return int(np.isfinite(estimate.numbers[: len(estimate.shape)]).sum())  # eigenvalues come first


def stereo_files(folder: Path, frames: int) -> Iterator[Row]:
    """Yield times of a complete run from JPEG files to a result, including face detection."""
    recording, config = open_recording(folder / "long", "grey", fps=FPS), stereo_settings(FEW)
    subject = head_subject(recording.cameras[0].name, components_of(config))
    options = HeadRunOptions(folder / "result.mcap", end=frames)
    run = _run(
        recording,
        config,
        options,
        subject,
        lambda known: make_stereo_tracker(config, recording.cameras, known),
    )
    clock = FrameClock()
    outcome = run.track(clock.note)
    value = 1e3 * outcome.seconds / outcome.tracked
    yield from _rated(f"head stereo, N = {FEW}, JPEG files to finished MCAP", value, STEREO_FILES_MS)
    yield Row("  CPU of all threads, a pair, start excluded", clock.ms_a_frame, "ms", STEREO_CPU_MS)


def _run(recording: Any, config: Any, options: HeadRunOptions, subject: Subject, make: Any) -> HeadRun:
    flush = config.output.flush_frames
    return HeadRun(
        recording, config, options, name="head", subject=subject, flush_frames=flush, make_tracker=make
    )


# One camera


def mono_alone(camera: Camera, shown: Sequence[Any]) -> Iterator[Row]:
    """Yield times of two trackers on the same images, one of which adjusts the face only at the start."""
    configs = {w: load_settings(HeadMonoConfig, None, {"adjustment.when": w}) for w in ("start", "always")}
    walkers = {when: Walker(make_mono_tracker(config, camera)) for when, config in configs.items()}
    times = in_turn(walkers, shown, SETTLING)
    name = f"head mono, N = {HeadMonoConfig().particles.count}, tracking"
    yield from _rated(f"{name} alone", median_ms(times["start"]), MONO_MS)
    yield from _rated(f"{name} and adjusting", median_ms(times["always"]), ADJUSTING_MS)
    ratio = median_of_pairs(times["always"], times["start"])
    yield Row("  adjusting over tracking alone, median of pairs", ratio, "")
    yield _lost(walkers)


def _timed(function: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    found = function()
    return time.perf_counter() - began, found


def beginning(camera: Camera, frames: Sequence[Frame]) -> Iterator[Row]:
    """Yield times of face detection in one frame, and of initialisation after detection in n frames."""
    config = HeadMonoConfig()
    adjuster = Adjuster(load_face_model(None), camera, config.adjustment)
    initialiser = MonoInitialiser(config, adjuster, FaceDetector(config.start.detection))
    searches = [
        _timed(lambda frame=frame: initialiser.detect(frame))  # type: ignore[misc]
        for frame in frames
        if frame.images[0] is not None
    ]
    faces = [face for _, face in searches if isinstance(face, DetectedFace)][: config.start.frames]
    times = [_timed(lambda: initialiser.initialise(faces))[0] for _ in range(BEGINNINGS)]
    yield Row("head mono, search for a face in one frame", median_ms([s for s, _ in searches[1:]]), "ms")
    title = f"head mono, start after detection in {len(faces)} frames"
    yield Row(title, median_ms(times[1:]), "ms", START_MS)


def adjusting(camera: Camera, repeats: int) -> Iterator[Row]:
    """Yield times of an adjustment by number of views n, and their deviation from a linear fit."""
    model, settings = load_face_model(None), HeadMonoConfig().adjustment
    person = PersonParameters(model.identity_mean, np.zeros_like(model.mean))
    views = {count: seen_views(model, camera, count) for count in VIEWS}
    adjuster = Adjuster(model, camera, settings)
    times: dict[int, list[float]] = {count: [] for count in VIEWS}
    for repeat in range(repeats + 1):
        for count in VIEWS:
            began = time.perf_counter()
            found = adjuster.adjust(views[count], person, iterations=settings.iterations)
            if repeat:
                times[count].append((time.perf_counter() - began) / max(found.iterations, 1))
    milliseconds, steps = np.array([*map(median_ms, times.values())]), 2 * settings.iterations
    for count, value in zip(VIEWS, milliseconds.tolist(), strict=True):
        yield Row(f"head mono, adjustment of n = {count}, {steps} steps", steps * value, "ms")
    offset, slope = fitted_line(np.array(VIEWS, dtype=float), milliseconds)
    worst = np.abs((offset + slope * np.array(VIEWS)) / milliseconds - 1.0).max()
    yield Row("  a step's largest distance from a line over n", 100.0 * float(worst), "%", LINEAR_PERCENT)


def seen_views(model: FaceModel, camera: Camera, count: int) -> tuple[PointView, ...]:
    """Return noisy views of a random person in random poses, with other start values."""
    rng = np.random.default_rng(0)
    identity = model.identity_mean + model.identity_deviations * rng.uniform(-1.5, 1.5, model.identity_size)
    views = []
    for index in range(count):
        drawn = rng.uniform(-1.5, 1.5, model.deformation_size)
        deformation = model.deformation_mean + model.deformation_deviations * drawn
        turn = np.radians([10.0, 20.0, 30.0]) * rng.uniform(-1.0, 1.0, 3)
        position = np.array([*rng.uniform(-60.0, 60.0, 2), rng.uniform(600.0, 800.0)])
        pose = HeadPose(position, head_quaternion_from_roll_pitch_yaw(turn))
        pixels, _ = pixels_from_points(camera, pose.points(model.shapes(identity, deformation)))
        pixels += NOISE_PX * rng.standard_normal(pixels.shape)
        start = HeadPose(position + rng.normal(0.0, 5.0, 3), pose.quaternion)
        views.append(PointView(index, pixels, np.ones(len(pixels)), start, model.deformation_mean))
    return tuple(views)


def mono_files(folder: Path, images: Sequence[Any]) -> Iterator[Row]:
    """Yield times of complete runs from a video to a result, including face detection."""
    height, width = images[0].shape
    writer = cv2.VideoWriter(str(folder / "long.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), FPS, (width, height))
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    for passes, title, target in ((1, "one pass", MONO_FILES_MS), (2, "two passes", None)):
        config, clock = HeadMonoConfig(run=RunSettings(passes=passes)), FrameClock()
        began = time.perf_counter()
        recording = open_recording(folder / "long.mp4", "grey", guess=Guess())
        (camera,) = recording.cameras
        options = HeadRunOptions(folder / f"mono-{passes}.mcap")
        run = _run(
            recording,
            config,
            options,
            mono_subject(camera.name, load_face_model(None)),
            lambda known, c=config, camera=camera: make_mono_tracker(c, camera, known),
        )
        frames = run.track(clock.note).tracked / passes
        value = 1e3 * (time.perf_counter() - began) / frames
        yield from _rated(f"head mono, video to finished MCAP, {title}, per frame", value, target)
        name = "  CPU of all threads, a frame of the last pass, start excluded"
        yield Row(name, clock.ms_a_frame, "ms", MONO_CPU_MS)
