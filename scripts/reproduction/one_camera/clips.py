"""Videos of real faces without truth: are they tracked, how much do they shake, do they flip?"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.cli.main import run as posetrack
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE
from posetrack_cli.evaluation.track import Track, track_of_result
from posetrack_cli.geometry import rotations
from posetrack_cli.results.reader import read_result
from reproduction.accuracy.measuring import number
from reproduction.one_camera.entrants import CLIPS
from reproduction.one_camera.figures import pose_columns
from reproduction.one_camera.measuring import Measured, pose_of
from reproduction.one_camera.options import Options
from reproduction.one_camera.population import TRACKED
from reproduction.one_camera.tables import AXES
from reproduction.running import Targets, table
from reproduction.steps import Chain, Step

VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".webm")
LEAST_TRACKED = 0.99
FLIP_DEG = 20.0
"""A head that turns by more between two frames, 600 deg/s at 30 Hz, has not turned: the pose has flipped."""
SECOND_DIFFERENCE = np.sqrt(6.0)
"""White noise of deviation 1 has second differences x- - 2 x + x+ of this deviation."""
NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
PICTURES = "spread:8"


class Clips:
    """Share of frames tracked, jitter, flips, and pictures, of every video of a folder."""

    name = "clips"

    def chains(self, options: Options) -> list[Chain]:
        """One for each video; none without a folder."""
        return [
            Chain(
                clip.stem,
                TRACKED,
                tuple(
                    Step(result_of(clip, entrant.name), ("head", "mono", str(clip), *entrant.arguments))
                    for entrant in CLIPS
                ),
            )
            for clip in clips_in(options)
        ]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A table, then pictures."""
        yield "## Videos of real faces, no truth"
        yield ""
        clips = clips_in(options)
        if not clips:
            yield "Not measured: no videos were given (`--clips`)."
            yield ""
            return
        yield (
            "Jitter: of each component the root mean square of its second differences over frames in a row, "
            "divided by sqrt 6, which is the deviation of white noise on a motion of constant velocity; in "
            "brackets the robust version (1.4826 medians of absolute values), which quick motion does not "
            f"touch. Flips: turns by more than {FLIP_DEG:g} deg from one frame to the next. The cameras are "
            "unknown, so z, mm and all lengths rest on a guess."
        )
        yield ""
        header = (
            "video",
            "",
            "frames",
            "tracked",
            "first frame",
            "flips",
            *(f"jitter {axis}" for axis in AXES),
        )
        yield from table(header, _rows(options, clips))
        for clip in clips:
            yield from _pictures(options, clip)
            _judge(options, clip, targets)


def clips_in(options: Options) -> list[Path]:
    """The videos of the folder."""
    if options.clips is None:
        return []
    return sorted(path.resolve() for path in options.clips.iterdir() if path.suffix.lower() in VIDEOS)


def result_of(clip: Path, entrant: str) -> str:
    """Where a result lies, below the study's folder."""
    return f"runs/{clip.stem}-{entrant}.mcap"


def _rows(options: Options, clips: list[Path]) -> Iterator[list[str]]:
    for clip in clips:
        for entrant in CLIPS:
            path = options.output / result_of(clip, entrant.name)
            if path.exists():
                yield [clip.stem, entrant.title, *_cells(track_of(path))]


def track_of(path: Path) -> Track:
    """The estimates of a result."""
    return track_of_result(read_result(path), path.stem)


def _cells(track: Track) -> list[str]:
    tracked = tracked_of(track)
    first = f"{int(np.argmax(tracked))}" if tracked.any() else "-"
    shares = [f"{len(track)}", number(float(tracked.mean()), 1, percent=True), first, f"{flips(track)}"]
    found = jitter(track)
    return [*shares, *(f"{rms:.3f} ({robust:.3f})" for rms, robust in zip(*found.values(), strict=True))]


def tracked_of(track: Track) -> FloatArray:
    """1 where the head is tracked, else 0, (N,)."""
    lost = np.zeros(len(track), dtype=np.bool_) if track.lost is None else track.lost
    return np.where(lost, 0.0, 1.0)


def jitter(track: Track) -> Mapping[str, FloatArray]:
    """Return of x, y, z (mm), roll, pitch, yaw (deg) how much they shake, (6,) each.

    ``rms`` is the root mean square of |p- - 2 p + p+| / sqrt 6 over three tracked frames in a row, ``robust``
    1.4826 times its median; NaN without such frames.
    """
    columns, tracked = pose_columns(track), tracked_of(track) > 0.0
    three = tracked[:-2] & tracked[1:-1] & tracked[2:]
    second = (columns[:-2] - 2.0 * columns[1:-1] + columns[2:])[three] / SECOND_DIFFERENCE
    if not len(second):
        return dict.fromkeys(("rms", "robust"), np.full(6, np.nan))
    return {
        "rms": np.sqrt(np.mean(second**2, axis=0)),
        "robust": NORMAL_MAD * np.median(np.abs(second), axis=0),
    }


def flips(track: Track) -> int:
    """How often the head is said to turn by more than ``FLIP_DEG`` between two tracked frames."""
    quaternion, tracked = pose_of(track)[1], tracked_of(track) > 0.0
    turned = np.degrees(rotations.angle_between(quaternion[:-1], quaternion[1:]))
    return int((turned > FLIP_DEG)[tracked[:-1] & tracked[1:]].sum())


def _pictures(options: Options, clip: Path) -> Iterator[str]:
    """Points and axes on some frames, by ``posetrack view``."""
    result = options.output / result_of(clip, "two-passes")
    picture = options.output / f"{clip.stem}.png"
    if not result.exists():
        return
    arguments = ["--recording", str(clip), "--select", PICTURES, "--crop", "head", "--overwrite"]
    code = posetrack(["view", str(result), "-o", str(picture), *arguments])
    if code not in (EXIT_DONE, EXIT_DATA_LOST):
        sys.exit(code)
    yield f"{clip.stem}, two passes:"
    yield ""
    yield f"![Points and axes on frames of {clip.stem}]({picture.name})"
    yield ""


def _judge(options: Options, clip: Path, targets: Targets) -> None:
    asked = f">= {LEAST_TRACKED:.0%}"
    for entrant in CLIPS[:2]:
        path, what = options.output / result_of(clip, entrant.name), f"{clip.stem}, {entrant.title}"
        if not path.exists():
            targets.add(f"{what}: frames tracked", asked, "-", None)
            continue
        track = track_of(path)
        share, count = float(tracked_of(track).mean()), flips(track)
        targets.add(f"{what}: frames tracked", asked, f"{share:.1%}", share >= LEAST_TRACKED)
        targets.add(f"{what}: flips of the pose", "0", f"{count}", count == 0)
