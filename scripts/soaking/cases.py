"""The trackers' runs: which commands, over which recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2

from benchmarking.commands import POSETRACK
from benchmarking.recordings import link_recording
from posetrack_cli.recording.base import CAMERA_FILE_NAME
from posetrack_cli.rendering.devices import open_device
from posetrack_cli.synthesis.hand.frames import CAMERA, synthesise
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.writing import write_synthetic
from soaking.amounts import FLUSH_FRAMES, Amounts

FPS = 30.0
PIECES = 3
"""Of the recording of a batch, each of the second that is the shortest."""
TRACKERS = ("hand", "stereo", "mono")
_RECORDINGS = {"hand": "hand", "stereo": "head", "mono": "head"}
_SHORT = ("--set", f"output.flush_frames={FLUSH_FRAMES}")


@dataclass(frozen=True)
class Case:
    """A run, as a user starts it.

    Attributes:
        name: of the tracker, as rows say it.
        arguments: all but the output.
        frames: of the recording.
        passes: in which every frame is tracked.
        smoothed: whether a backward pass follows, which no checkpoint covers.
        program: that takes the arguments.
    """

    name: str
    arguments: tuple[str, ...]
    frames: int
    passes: int = 1
    smoothed: bool = False
    program: tuple[str, ...] = POSETRACK

    @property
    def steps(self) -> int:
        """Frames tracked in all passes."""
        return self.passes * self.frames

    def command(self, output: Path, *more: str) -> list[str]:
        """Return the command line that writes this output."""
        return [*self.program, *self.arguments, "-o", str(output), *more]


class Recordings:
    """Synthetic recordings in a folder, made when they are first asked for.

    Args:
        folder: to make them in.
        amounts: how long they are.
    """

    def __init__(self, folder: Path, amounts: Amounts) -> None:
        self._folder, self._amounts = folder, amounts

    def long_case(self, tracker: str) -> Case:
        """The run of many frames, in one pass, with the time of each frame in the result."""
        recording = self._linked(tracker, self._amounts.frames)
        more = {"hand": (), "stereo": (), "mono": ("--cameras", "left", "--passes", "1")}[tracker]
        arguments = (*_command(tracker), str(recording), "--fps", str(FPS), "--timings", *more)
        return Case(" ".join(_command(tracker)), arguments, self._amounts.frames)

    def short_case(self, tracker: str) -> Case:
        """The run that is interrupted: with a smoothed track or in two passes."""
        frames = self._amounts.short
        recording = self._linked(tracker, frames)
        more = {"hand": ("--smooth",), "stereo": (), "mono": ("--cameras", "left")}[tracker]
        passes = () if tracker == "hand" else ("--passes", "2")
        arguments = (*_command(tracker), str(recording), "--fps", str(FPS), *_SHORT, *passes, *more)
        return Case(" ".join(_command(tracker)), arguments, frames, len(passes) or 1, tracker == "hand")

    def batch_case(self) -> Case:
        """The batch of one recording in pieces, of a known hand: its processes start at once."""
        recording = self._linked("hand", self._amounts.short)
        pieces = (
            "--fps",
            str(self._amounts.short / PIECES),
            "--chunk-s",
            "1",
            "--overlap-s",
            ".2",
            "--no-reports",
        )
        known = ("--hand-side", "right", "--shape", "average", "--particles", "32")
        arguments = ("batch", "hand", "run", str(recording), *pieces, *known, *_SHORT)
        return Case("batch hand run", arguments, self._amounts.short)

    def _linked(self, tracker: str, frames: int) -> Path:
        kind = _RECORDINGS[tracker]
        path = self._folder / f"{kind}-{frames}"
        if not path.exists():
            link_recording(path, self._recorded(kind), frames)
        return path

    def _recorded(self, kind: str) -> Path:
        path = self._folder / kind
        if not path.exists():
            {"hand": write_hand_folder, "head": _write_head_folder}[kind](path, self._amounts.recorded)
        return path


def write_hand_folder(path: Path, frames: int) -> None:
    """A folder of depth images of a synthetic hand, with its camera file."""
    device = open_device()
    try:
        path.mkdir()
        for frame in synthesise(SynthOptions(frames=frames), device=device):
            cv2.imwrite(str(path / f"{frame.index:06d}.png"), frame.depth)
    finally:
        device.close()
    _write_camera(path / CAMERA_FILE_NAME, {key: getattr(CAMERA, key) for key in ("fx", "fy", "cx", "cy")})


def _write_camera(path: Path, values: Mapping[str, float]) -> None:
    path.write_text("".join(f"{key} = {value!r}\n" for key, value in values.items()))


def _write_head_folder(path: Path, frames: int) -> None:
    write_synthetic(HeadSynthOptions(frames=frames, fps=FPS), path)


def _command(tracker: str) -> Iterable[str]:
    return ("hand", "run") if tracker == "hand" else ("head", tracker)
