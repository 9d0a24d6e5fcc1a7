"""What a frame of a head costs: in the tracker alone, against the number of particles, from file to file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarking.commands import peak_memory
from benchmarking.head_walker import SETTLING, FrameClock, HeadWalker
from benchmarking.lengths import Lengths
from benchmarking.one_camera import one_camera
from benchmarking.recordings import link_recording, there_and_back
from benchmarking.rows import Row, median_ms, median_of_pairs
from posetrack_cli.configuration import load_settings
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.subject import head_subject
from posetrack_cli.head.tracker.stereo import components_of, make_stereo_tracker
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.writing import write_synthetic
from posetrack_cli.tracking.smoothing import Learned
from stepping import in_turn

FEW, MANY = 1000, 5000
FPS = 30.0
TRACKING_MS = 1e3 / 150.0
FILES_MS, CPU_MS = 1e3 / 60.0, 7.0
INDEPENDENT = 1.25
"""Five times the particles may cost a quarter more."""


def deformations_of(estimate: Estimate | None) -> int:
    """How many components a learnt head's model had in a frame."""
    if estimate is None:
        return 0
    components = len(estimate.shape)
    numbers = np.array([]) if estimate.numbers is None else estimate.numbers
    return int(np.isfinite(numbers[:components]).sum())  # eigenvalues come first


def heads(lengths: Lengths) -> Iterator[Row]:
    """Rows of a synthetic head, which is made once."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_synthetic(HeadSynthOptions(frames=lengths.head_frames, fps=FPS), folder / "seen")
        yield from tracking_alone(folder / "seen", lengths.head_steps)
        link_recording(folder / "long", folder / "seen", lengths.head_memory)
        yield from file_to_file(folder, lengths.head_steps)
        command = ["head", "stereo", str(folder / "long"), "--fps", str(FPS)]
        yield from peak_memory("head stereo", command, lengths.head_memory, folder)
        yield from one_camera(folder, lengths)


def configuration(particles: int, **model: float) -> HeadStereoConfig:
    """The defaults with so many particles, and changes of ``model``."""
    changes = {f"model.{name}": value for name, value in model.items()}
    return load_settings(HeadStereoConfig, None, {"particles.count": particles} | changes)


def tracking_alone(path: Path, steps: int) -> Iterator[Row]:
    """The same images through four trackers in turn: few and many particles, a new face and a learnt one.

    A new face is rigid. A learnt one deforms, which costs more.
    """
    recording = open_recording(path, "grey")
    images = [frame.images for frame in recording.frames()]
    shown = [images[index] for index in there_and_back(len(images), steps)]
    known = learnt_face(recording.cameras, shown)
    walkers = {
        (count, learnt): HeadWalker(
            make_stereo_tracker(configuration(count), recording.cameras, known if learnt else None)
        )
        for count in (FEW, MANY)
        for learnt in (False, True)
    }
    yield from tracking_rows(in_turn(walkers, shown, SETTLING))
    yield Row("  deformations of the learnt face", deformations_of(walkers[FEW, True].last), "")
    yield Row("  frames in which a head was lost", sum(walker.lost for walker in walkers.values()), "", 0.0)


def learnt_face(cameras: Sequence[Camera], shown: Sequence[Any]) -> Learned:
    """What a tracker learns with gates wide open, for a short recording has no expressions to speak of."""
    walker = HeadWalker(make_stereo_tracker(configuration(FEW, rigid_frames=10, least_mm=0.1), cameras))
    for index, images in enumerate(shown):
        walker.step(index, images)
    return walker.learned()


def tracking_rows(times: Mapping[tuple[int, bool], Sequence[float]]) -> Iterator[Row]:
    """Rows of seconds by number of particles and whether the face was learnt before."""
    name = f"head stereo, N = {FEW}, tracking alone"
    for learnt, face in ((False, "new, rigid face"), (True, "learnt face")):
        value = median_ms(times[FEW, learnt])
        yield Row(f"{name}, {face}", value, "ms", TRACKING_MS)
        yield Row("  that is", 1e3 / value, "frames/s")
    ratio = median_of_pairs(times[MANY, True], times[FEW, True])
    yield Row(f"head stereo, N = {MANY} / N = {FEW}, learnt face, median of pairs", ratio, "", INDEPENDENT)


def file_to_file(folder: Path, frames: int) -> Iterator[Row]:
    """A whole run from JPEG files to a finished result, the search for the face included."""
    recording, config = open_recording(folder / "long", "grey", fps=FPS), configuration(FEW)
    options = HeadRunOptions(folder / "result.mcap", end=frames)
    run = HeadRun(
        recording,
        config,
        options,
        name="head-stereo",
        subject=head_subject(recording.cameras[0].name, components_of(config)),
        flush_frames=config.output.flush_frames,
        make_tracker=lambda known: make_stereo_tracker(config, recording.cameras, known),
    )
    clock = FrameClock(SETTLING)
    outcome = run.track(clock.note)
    value = 1e3 * outcome.seconds / outcome.tracked
    yield Row(f"head stereo, N = {FEW}, JPEG files to finished MCAP", value, "ms", FILES_MS)
    yield Row("  that is", 1e3 / value, "frames/s")
    cpu = 1e3 * clock.seconds_a_frame
    yield Row("  CPU of all threads, a pair, start excluded", cpu, "ms", CPU_MS)
