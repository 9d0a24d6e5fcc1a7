"""Runs of the trackers as processes, findings, and uninterrupted reference runs."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import cv2

from benchmarking.processes import POSETRACK
from benchmarking.recordings import link_recording
from benchmarking.rows import Row, rows_json
from posetrack_cli.cli.terminal import print_note
from posetrack_cli.errors import ResultError
from posetrack_cli.outputs import state_path
from posetrack_cli.recording.base import CAMERA_FILE_NAME, TRUTH_PREFIX
from posetrack_cli.rendering.devices import open_device
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME
from posetrack_cli.results.spool import load
from posetrack_cli.results.topics import SMOOTHED_PREFIX
from posetrack_cli.synthesis.hand.frames import CAMERA, synthesise
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.writing import write_synthetic
from posetrack_cli.tracking.two_pass import learned_before

FLUSH_FRAMES = 10  # between two checkpoints of a short run
FPS = 30.0
PIECES = 3  # of the recording of a batch, each of the second that is the shortest
TRACKERS = ("hand", "stereo", "mono")
DONE, FAILED, DATA_LOST = 0, 1, 3
LINE = "posetrack: "
POLL_S = 0.01
_SHORT = ("--set", f"output.flush_frames={FLUSH_FRAMES}")


class Amounts(NamedTuple):
    """Extent of a soak test."""

    frames: int  # of each tracker's long run
    kills: int  # of runs, and of batches
    disks: int  # disk sizes per tracker
    at_once: int  # simultaneous runs with an empty kernel cache
    recorded: int  # synthetic frames, which long recordings repeat forwards and backwards
    short: int  # frames of the runs that are killed or run out of disk; a multiple of FLUSH_FRAMES

    def __str__(self) -> str:
        return f"{self.frames} frames, {self.kills} kills, {self.disks} disks, {self.at_once} at once"


FULL = Amounts(20_000, 100, 10, 4, 90, 60)
QUICK = Amounts(90, 3, 1, 2, 20, 20)


class Findings:
    """Figures and failed checks, printed immediately on standard output and standard error."""

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.troubles: list[str] = []

    def add(self, row: Row) -> None:
        """Record a figure; one above its target is a failed check."""
        self.rows.append(row)
        print(row.line, flush=True)
        if row.verdict == "MISSED":
            unit = f" {row.unit}" if row.unit else ""
            self.trouble(f"{row.name}: {row.value:.4g}{unit}, at most {row.target:g}{unit}")

    def trouble(self, line: str) -> None:
        """Record a failed check, in one line."""
        self.troubles.append(line)
        print_note(f"soak: {line}")

    def troubles_of(self, name: str, lines: Iterable[str]) -> bool:
        """Record the failed checks of one run; return whether there were none."""
        troubles = [f"{name}: {line}" for line in lines]
        for line in troubles:
            self.trouble(line)
        return not troubles

    def as_json(self, machine: Mapping[str, str]) -> str:
        """Return all findings as JSON, in the format of scripts/bench plus failed checks."""
        return rows_json(machine, self.rows, troubles=self.troubles)

    def as_markdown(self, machine: Mapping[str, str]) -> str:
        """Return Markdown tables: the machine, then every figure."""
        lines = ["| machine | |", "|---|---|", *(f"| {key} | {value} |" for key, value in machine.items())]
        lines += ["", "| what | figure | at most |", "|---|---:|---:|"]
        for row in self.rows:
            most = "" if row.target is None else f"{row.target:g}"
            missed = " **MISSED**" if row.verdict == "MISSED" else ""
            figure = f"{row.value:,.2f}".removesuffix(".00")
            lines.append(f"| {row.name} | {figure} {row.unit}".rstrip() + f"{missed} | {most} |")
        return "\n".join(lines) + "\n"


# Cases and their recordings


class Case(NamedTuple):
    """A run, as a user starts it."""

    name: str  # of the tracker, for row names
    arguments: tuple[str, ...]  # without the output
    frames: int  # of the recording
    passes: int = 1  # over all frames
    smoothed: bool = False  # whether a backward pass follows, which has no checkpoints
    program: tuple[str, ...] = POSETRACK

    @property
    def steps(self) -> int:
        """Number of frames tracked in all passes."""
        return self.passes * self.frames

    def command(self, output: Path, *more: str) -> list[str]:
        """Return the command line with an output and further arguments."""
        return [*self.program, *self.arguments, "-o", str(output), *more]


class Recordings:
    """Synthetic recordings in a folder, generated on first use."""

    def __init__(self, folder: Path, amounts: Amounts) -> None:
        self._folder, self._amounts = folder, amounts

    def long_case(self, tracker: str) -> Case:
        """Return the long run: one pass, with the time of each frame in the result."""
        more = {"hand": (), "stereo": (), "mono": ("--cameras", "left", "--passes", "1")}[tracker]
        frames = self._amounts.frames
        command, reading = self._reading(tracker, frames)
        return Case(" ".join(command), (*command, *reading, "--timings", *more), frames)

    def short_case(self, tracker: str) -> Case:
        """Return the run to interrupt: with a smoothed track or two passes."""
        more = {"hand": ("--smooth",), "stereo": (), "mono": ("--cameras", "left")}[tracker]
        passes, frames = () if tracker == "hand" else ("--passes", "2"), self._amounts.short
        command, reading = self._reading(tracker, frames)
        arguments = (*command, *reading, *_SHORT, *passes, *more)
        return Case(" ".join(command), arguments, frames, len(passes) or 1, tracker == "hand")

    def batch_case(self) -> Case:
        """Return the batch of one recording in pieces, with a given hand so that jobs start immediately."""
        frames = self._amounts.short
        command, (recording, *_) = self._reading("hand", frames)
        pieces = ("--fps", str(frames / PIECES), "--chunk-s", "1", "--overlap-s", ".2", "--no-reports")
        known = ("--hand-side", "right", "--shape", "average", "--particles", "32")
        return Case("batch hand run", ("batch", *command, recording, *pieces, *known, *_SHORT), frames)

    def _reading(self, tracker: str, frames: int) -> tuple[tuple[str, str], tuple[str, ...]]:
        """Return a tracker's command, and the arguments that read its recording."""
        kind = "hand" if tracker == "hand" else "head"
        path, recorded = (self._folder / name for name in (f"{kind}-{frames}", kind))
        if not recorded.exists() and kind == "hand":
            write_hand_folder(recorded, self._amounts.recorded)
        elif not recorded.exists():
            write_synthetic(HeadSynthOptions(frames=self._amounts.recorded, fps=FPS), recorded)
        if not path.exists():
            link_recording(path, recorded, frames)
        return ("hand", "run") if kind == "hand" else ("head", tracker), (str(path), "--fps", str(FPS))


def write_hand_folder(path: Path, frames: int) -> None:
    """Write a folder of depth images of a synthetic hand, with a camera file."""
    device = open_device()
    try:
        path.mkdir()
        for frame in synthesise(SynthOptions(frames=frames), device=device):
            cv2.imwrite(str(path / f"{frame.index:06d}.png"), frame.depth)
    finally:
        device.close()
    lines = (f"{key} = {getattr(CAMERA, key)!r}\n" for key in ("fx", "fy", "cx", "cy"))
    (path / CAMERA_FILE_NAME).write_text("".join(lines))


# Processes


class Ended(NamedTuple):
    """Exit code and standard error of a process."""

    code: int
    said: str

    def troubles(self, codes: Sequence[int]) -> Iterator[str]:
        """Yield failed checks: wrong exit code, a traceback, or not exactly one line for a failure."""
        lines = self.said.splitlines()
        reported = [line for line in lines if line.startswith(LINE)]
        wanted = 1 if self.code == FAILED else 0
        last = f"; said: {lines[-1][:300]}" if lines else ""
        if self.code not in codes:
            yield f"exit code {self.code}, expected {' or '.join(map(str, codes))}{last}"
        if any("Traceback" in line or "Warning:" in line for line in lines):
            yield f"a traceback or a Python warning{last}"
        if self.code in codes and len(reported) != wanted:
            yield f"{len(reported)} lines '{LINE}...', expected {wanted}{last}"


class Started:
    """A running process with its standard error in a file."""

    def __init__(self, process: subprocess.Popen[bytes], said: Path) -> None:
        self.process, self._said = process, said

    @property
    def said(self) -> str:
        """Standard error until now."""
        return self._said.read_text(errors="replace")

    @property
    def running(self) -> bool:
        """Whether the process is still running."""
        return self.process.poll() is None

    def wait_until(self, reached: Callable[[], bool]) -> bool:
        """Wait for a condition; return False if the process ended before."""
        while not reached():
            if not self.running:
                return False
            time.sleep(POLL_S)
        return True

    def end(self) -> Ended:
        """Wait for the end of the process."""
        return Ended(self.process.wait(), self.said)


@contextmanager
def started(
    command: Sequence[str],
    said: Path,
    environment: Mapping[str, str] | None = None,
    *,
    file_bytes: int | None = None,
) -> Iterator[Started]:
    """Start a command with standard error in a file; kill it if it still runs at the end of the context.

    ``environment`` is added to that of this process; ``file_bytes`` limits the size of files.
    """
    null, variables = subprocess.DEVNULL, {**os.environ, **(environment or {})}
    with said.open("wb") as stream:
        process = subprocess.Popen(command, stdin=null, stdout=null, stderr=stream, env=variables)
    try:
        if file_bytes is not None:  # set well before the process has loaded its libraries and writes
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
        yield Started(process, said)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def run_to_end(command: Sequence[str], said: Path, *, file_bytes: int | None = None) -> Ended:
    """Run a command to its end."""
    with started(command, said, file_bytes=file_bytes) as run:
        return run.end()


def frames_readable(path: Path) -> tuple[int, Ended]:
    """Return the number of frames in an unfinished result by ``posetrack info``; 0 if unreadable."""
    listed = subprocess.run([*POSETRACK, "info", str(path), "--json", "-"], capture_output=True, text=True)
    ended = Ended(listed.returncode, listed.stderr)
    if ended.code not in (DONE, DATA_LOST):
        return 0, ended
    topics = json.loads(listed.stdout)["topics"]
    estimates = [topic for topic in topics if topic["type"] == ESTIMATE_SCHEMA_NAME]
    others = (SMOOTHED_PREFIX, TRUTH_PREFIX)
    return sum(t["messages"] for t in estimates if not t["topic"].startswith(others)), ended


# Progress of a run, read from its checkpoint


class Standing(NamedTuple):
    """Checkpoint: frames tracked in all passes, and frames in the result."""

    steps: int
    written: int


def standing_of(case: Case, output: Path) -> Standing | None:
    """Return the last checkpoint of a run; None before the first one."""
    try:
        checkpoint, _ = load(state_path(output))
    except ResultError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise
    written = checkpoint.frames_written
    first_pass = checkpoint.state.get("first_pass_frame")  # key of tracking.two_pass
    if first_pass is not None:
        return Standing(int(first_pass) + 1, 0)
    in_second = case.passes == 2 and bool(learned_before(checkpoint))
    return Standing(written + (case.frames if in_second else 0), written)


class Looker:
    """Cached reader of a run's checkpoint."""

    def __init__(self, case: Case, output: Path) -> None:
        self._case, self._output = case, output
        self._seen: tuple[int, int] | None = None
        self._steps = -1

    @property
    def steps(self) -> int:
        """Number of frames tracked in all passes; -1 before the first checkpoint."""
        try:
            status = state_path(self._output).stat()
        except FileNotFoundError:
            return self._steps
        if (seen := (status.st_mtime_ns, status.st_ino)) != self._seen:
            standing = standing_of(self._case, self._output)
            self._seen, self._steps = seen, -1 if standing is None else standing.steps
        return self._steps


class Reference(NamedTuple):
    """An uninterrupted run."""

    data: bytes  # of the result
    # seconds from the start to the first checkpoint, end of the first pass, last checkpoint and end
    first: float
    second: float
    last: float
    end: float
    room: (
        int  # largest size of its files, bytes, with two checkpoints: a new one is written before it replaces
    )


def reference_of(case: Case, folder: Path, findings: Findings) -> Reference | None:
    """Run a case twice, first to compile the kernels; return None if a run fails."""
    folder.mkdir()
    results = []
    for number in range(2):
        output = folder / f"reference-{number}.mcap"
        looker, marks, room, began = Looker(case, output), dict[int, float](), 0, time.perf_counter()
        with started(case.command(output), output.with_suffix(".txt")) as run:
            while run.running:
                steps, now = looker.steps, time.perf_counter() - began
                for threshold in (0, case.frames, case.steps):
                    if steps >= threshold:
                        marks.setdefault(threshold, now)
                room = max(room, _room_of(output))
                time.sleep(POLL_S)
            ended, end = run.end(), time.perf_counter() - began
        if not findings.troubles_of(f"{case.name}, uninterrupted", ended.troubles((DONE,))):
            return None
        first, second, last = (marks.get(threshold, end) for threshold in (0, case.frames, case.steps))
        data = output.read_bytes()
        results.append(Reference(data, first, second, last, end, max(room, len(data))))
    if results[0].data != results[1].data:
        findings.trouble(f"{case.name}: two runs that nothing happened to differ")
    return results[1]


def _room_of(output: Path) -> int:
    """Return the bytes of a run's files, counting the checkpoint twice."""
    sizes = {}
    for path in output.parent.glob(f"{output.name}*"):
        try:
            sizes[path] = path.stat().st_size
        except FileNotFoundError:
            continue  # renamed since the listing
    temporary = sum(size for path, size in sizes.items() if path.name.endswith(".tmp"))
    return sum(sizes.values()) - temporary + sizes.get(state_path(output), 0)
