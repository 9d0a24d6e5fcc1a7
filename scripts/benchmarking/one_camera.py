"""What a frame of a head costs with one camera: tracking, adjusting, beginning, from a video to a result."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarking.commands import peak_memory
from benchmarking.head_walker import SETTLING, FrameClock, HeadWalker
from benchmarking.lengths import Lengths
from benchmarking.recordings import there_and_back
from benchmarking.rendering import fitted_line
from benchmarking.rows import Row, median_ms, median_of_pairs
from posetrack_cli.configuration import load_settings
from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.adjustment.adjuster import Adjuster, PersonParameters, PointView
from posetrack_cli.head.config import HeadMonoConfig, RunSettings
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.initialisation.mono import DetectedFace, MonoInitialiser
from posetrack_cli.head.multilinear.face_model import FaceModel, load_face_model
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.subject import mono_subject
from posetrack_cli.head.tracker.mono import make_mono_tracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.opening import open_recording
from stepping import in_turn

ALONE = ("left",)
FPS = 30.0
TRACKING_MS, ADJUSTING_MS, START_MS, FILES_MS, CPU_MS = 3.0, 6.0, 70.0, 10.0, 10.0
VIEWS = (5, 10, 20, 40, 60)
LINEAR_PERCENT = 15.0
NOISE_PX = 0.5
BEGINNINGS = 15


def one_camera(folder: Path, lengths: Lengths) -> Iterator[Row]:
    """Rows of the left camera's images of a synthetic head.

    Args:
        folder: with the recordings ``seen`` and ``long``; gets a video and results.
        lengths: how much is measured.
    """
    recording = open_recording(folder / "seen", "grey", cameras=ALONE)
    camera, frames = recording.cameras[0], list(recording.frames())
    images = [frame.images for frame in frames]
    shown = [images[index] for index in there_and_back(len(images), lengths.head_steps)]
    yield from tracking_alone(camera, shown)
    yield from beginning(camera, frames)
    yield from adjusting(camera, lengths.repeats)
    video = folder / "long.mp4"
    write_video(video, [image for (image,) in shown if image is not None])
    yield from file_to_file(video, folder)
    command = ["head", "mono", str(folder / "long"), "--fps", str(FPS), "--cameras", *ALONE]
    results = folder / "results"
    results.mkdir()
    yield from peak_memory("head mono", command, lengths.head_memory, results)


def configuration(when: str) -> HeadMonoConfig:
    """The defaults, with a face that is adjusted always, at the start or never."""
    return load_settings(HeadMonoConfig, None, {"adjustment.when": when})


def tracking_alone(camera: Camera, shown: Sequence[Any]) -> Iterator[Row]:
    """The same images through two trackers in turn: one adjusts the face at the start only."""
    walkers = {
        when: HeadWalker(make_mono_tracker(configuration(when), camera)) for when in ("start", "always")
    }
    yield from tracking_rows(in_turn(walkers, shown, SETTLING))
    yield Row("  frames in which a head was lost", sum(walker.lost for walker in walkers.values()), "", 0.0)


def tracking_rows(times: Mapping[str, Sequence[float]]) -> Iterator[Row]:
    """Rows of seconds by when the face is adjusted."""
    name = f"head mono, N = {HeadMonoConfig().particles.count}"
    rows = {"start": ("tracking alone", TRACKING_MS), "always": ("tracking and adjusting", ADJUSTING_MS)}
    for when, (what, target) in rows.items():
        value = median_ms(times[when])
        yield Row(f"{name}, {what}", value, "ms", target)
        yield Row("  that is", 1e3 / value, "frames/s")
    ratio = median_of_pairs(times["always"], times["start"])
    yield Row("  adjusting over tracking alone, median of pairs", ratio, "")


def beginning(camera: Camera, frames: Sequence[Frame]) -> Iterator[Row]:
    """The search for a face in one frame, and what follows once it was detected in n."""
    config, model = HeadMonoConfig(), load_face_model(None)
    adjuster = Adjuster(model, camera, config.adjustment)
    initialiser = MonoInitialiser(config, adjuster, FaceDetector(config.start.detection))
    found, searching = [], []
    for frame in frames:
        if frame.images[0] is None:
            continue
        began = time.perf_counter()
        face = initialiser.detect(frame)
        searching.append(time.perf_counter() - began)
        if isinstance(face, DetectedFace):
            found.append(face)
    chosen = found[: config.start.frames]
    times = [seconds_of(lambda: initialiser.initialise(chosen)) for _ in range(BEGINNINGS)]
    yield Row("head mono, search for a face in one frame", median_ms(searching[1:]), "ms")
    count = len(chosen)
    yield Row(f"head mono, start after detection in {count} frames", median_ms(times[1:]), "ms", START_MS)


def adjusting(camera: Camera, repeats: int) -> Iterator[Row]:
    """Time of an adjustment against its n views, in turn, and how far it is from a straight line."""
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
    yield from adjusting_rows(times, 2 * settings.iterations)


def adjusting_rows(times: Mapping[int, Sequence[float]], steps: int) -> Iterator[Row]:
    """Rows of the seconds of a step by the number of views."""
    numbers, milliseconds = np.array(list(times), dtype=float), np.array([*map(median_ms, times.values())])
    for count, value in zip(times, milliseconds, strict=True):
        yield Row(f"head mono, adjustment of n = {count}, {steps} steps", steps * float(value), "ms")
    offset, slope = fitted_line(numbers, milliseconds)
    worst = np.abs((offset + slope * numbers) / milliseconds - 1.0).max()
    yield Row("  a step's largest distance from a line over n", 100.0 * float(worst), "%", LINEAR_PERCENT)


def seen_views(model: FaceModel, camera: Camera, count: int) -> tuple[PointView, ...]:
    """Views of a random person in random poses, with noise on the pixels; they start elsewhere."""
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
        ones = np.ones(len(pixels))
        views.append(PointView(index, pixels, ones, start, model.deformation_mean))
    return tuple(views)


def write_video(path: Path, images: Sequence[Any]) -> None:
    """A video of grey images."""
    height, width = images[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), FPS, (width, height))
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()


def file_to_file(video: Path, folder: Path) -> Iterator[Row]:
    """Whole runs from a video to a finished result, the search for the face included."""
    for passes, title, target in ((1, "one pass", FILES_MS), (2, "two passes", None)):
        run, clock = _run(video, folder, passes), FrameClock(SETTLING)
        began = time.perf_counter()
        frames = run.track(clock.note).tracked / passes
        value = 1e3 * (time.perf_counter() - began) / frames
        yield Row(f"head mono, video to finished MCAP, {title}, per frame", value, "ms", target)
        yield Row("  that is", 1e3 / value, "frames/s")
        cpu = 1e3 * clock.seconds_a_frame
        yield Row("  CPU of all threads, a frame of the last pass, start excluded", cpu, "ms", CPU_MS)


def _run(video: Path, folder: Path, passes: int) -> HeadRun:
    config = HeadMonoConfig(run=RunSettings(passes=passes))
    recording = open_recording(video, "grey", guess=Guess())
    (camera,) = recording.cameras
    return HeadRun(
        recording,
        config,
        HeadRunOptions(folder / f"mono-{passes}.mcap"),
        name="head-mono",
        subject=mono_subject(camera.name, load_face_model(None)),
        flush_frames=config.output.flush_frames,
        make_tracker=lambda known: make_mono_tracker(config, camera, known),
    )


def seconds_of(function: Any) -> float:
    """How long a call takes."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began
