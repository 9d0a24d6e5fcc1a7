"""What every command that tracks shows: compiling, progress, what is kept after a failure, the end."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.command import seconds_since_start
from posetrack_cli.cli.options import reading_options
from posetrack_cli.cli.process import leave_process, signals_watched
from posetrack_cli.cli.terminal import (
    bar,
    close_bars,
    print_aside,
    print_detail,
    print_line,
    print_note,
    say_meanwhile,
)
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_INTERRUPTED, PosetrackError, UsageError
from posetrack_cli.text import printable

if TYPE_CHECKING:
    from posetrack_cli.configuration import Settings
    from posetrack_cli.recording.pixels import PixelKind
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.results.estimate import Estimate
    from posetrack_cli.tracking.options import RunOutcome


def open_for_reading(
    path: Path, options: Mapping[str, Any], pixels: PixelKind = "depth", **further: Any
) -> Recording:
    """Open a recording as a command's options say; tell what was taken of several things that would do."""
    from posetrack_cli.recording.opening import open_recording

    recording = open_recording(path, pixels, **reading_options(options), **further)
    for camera in recording.cameras:
        print_detail(f"{path}: {camera.name or 'camera'} {camera.width}x{camera.height}, fx {camera.fx:.1f}")
    for remark in recording.remarks:
        print_note(f"{path}: {remark}")
    return recording


@contextmanager
def compiling_said(resumable: Path | None = None) -> Iterator[Callable[[], bool]]:
    """Say on standard error, above any progress bar, that kernels are compiled; wait for none to stop.

    Yields a function that tells whether one is being compiled just now.

    Args:
        resumable: output that a stopped run can be resumed to.
    """
    from posetrack_cli.compiled import announced, watched

    def give_up() -> None:
        close_bars()
        print_note(_interrupted(resumable))
        leave_process(EXIT_INTERRUPTED)

    def check() -> None:
        if asked.is_set():  # before this kernel, or between two of a frame
            raise KeyboardInterrupt

    with (
        announced(
            lambda line: print_aside(f"{line} ..."), lambda count: say_meanwhile(f"compiling kernel {count}")
        ),
        watched(lambda: check()) as is_compiling,
        signals_watched(is_compiling, give_up) as asked,
    ):
        yield is_compiling


def _interrupted(resumable: Path | None) -> str:
    from posetrack_cli.outputs import part_path, state_path

    if resumable is None or not (state_path(resumable).is_file() and part_path(resumable).is_file()):
        return "posetrack: interrupted"
    return f"interrupted while kernels were compiled: {part_path(resumable)}; --resume goes on"


class Listener:
    """What is told of commands that track, besides what they print; a subclass keeps what it is after.

    Attributes:
        is_alone: whether somebody has typed the command, and may type the next one.
    """

    is_alone = True

    def on_frame(self, pass_name: str, done: int, total: int | None) -> None:
        """A frame is tracked: so many of so many, where that is known."""

    def on_remark(self, text: str) -> None:
        """A user should know this of the recording."""

    def on_end(self, tracked: int) -> None:
        """All frames are done, or it was stopped: so many were tracked now."""


_listener: ContextVar[Listener] = ContextVar("listener", default=Listener())  # noqa: B039 has no state


@contextmanager
def told_to(listener: Listener) -> Iterator[None]:
    """Have a listener told of the commands that run inside."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


def print_remark(recording: Path, text: str) -> None:
    """Print what a user should know of a recording once it is tracked."""
    _listener.get().on_remark(text)
    print_note(f"{recording}: {text}")


@contextmanager
def progress(total: int | None, start: int, stride: int, name: str) -> Iterator[Any]:
    """Yield a function that shows an estimate on the progress bar; a bar only where a person looks.

    The bar stands at the estimate's frame, so a resumed run begins where the interrupted one ended, and a
    second pass begins anew.
    """
    listener, statuses = _listener.get(), [""]
    with bar(name, "frame", total) as shown:

        def report(estimate: Estimate) -> None:
            done = len(range(start, estimate.frame_index + 1, stride))
            if shown.done == 0:
                shown.begin_at(done - 1)  # frames before this run took it no time
            size = estimate.effective_sample_size
            weights = "" if size is None else f"ESS {size:.0f} "
            shown.advance(done - shown.done, f"{weights}{estimate.status}")
            if estimate.status != statuses[0]:
                statuses[0] = estimate.status
                print_detail(f"{name}: frame {estimate.frame_index}: {estimate.status}")
            listener.on_frame(name, done, total)

        yield report


def tell_settings(config: Settings) -> None:
    """Say which settings differ from the defaults, if --verbose asks for it."""
    for key, value in _differences(config.model_dump(), type(config)().model_dump()):
        print_detail(f"{key} = {value}")


def _differences(given: Mapping[str, Any], usual: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in given.items():
        if isinstance(value, dict):
            yield from ((f"{key}.{within}", one) for within, one in _differences(value, usual.get(key) or {}))
        elif value != usual.get(key):
            yield key, value


@contextmanager
def kept(output: Path) -> Iterator[None]:
    """When the run fails, its line also says what can still be read; what is refused has tracked nothing."""
    from posetrack_cli.outputs import part_path

    try:
        yield
    except PosetrackError as error:
        part = part_path(output)
        if part.is_file() and not isinstance(error, UsageError):
            error.args = (f"{error}; kept: {part} holds what was tracked before",)
        raise


def tell_next(*commands: Sequence[str | Path]) -> None:
    """Say what can be typed next, as a shell takes it.

    Nothing is said of names that no terminal shows as they are, nor where a batch runs the command.
    """
    if _listener.get().is_alone:
        for words in commands:
            line = shlex.join(map(_typed, words))
            if printable(line) == line:
                print_line(f"next: posetrack {line}")


def _typed(word: str | Path) -> str:
    """A word of a command line; a path that begins with a dash is no option."""
    return f"./{word}" if isinstance(word, Path) and str(word).startswith("-") else str(word)


def next_of_result(recording: Path, result: Path) -> Iterator[Sequence[str | Path]]:
    """Yield what makes a report, and a video."""
    page, video = result.with_suffix(".html"), result.with_suffix(".mp4")
    yield ("eval", result, "--html", page, *(["--overwrite"] if page.exists() else []))
    is_recording = video.exists() and recording.exists() and video.samefile(recording)
    if is_recording:
        video = video.with_stem(f"{video.stem}-tracked")
    yield ("view", result, "-o", video, *(["--overwrite"] if video.exists() else []))


_LEAST_SAID_S = 1.0
"""Time of compiling that is worth a word."""


def _rate(frames: int, seconds: float) -> str:
    """Frames per second, with two digits at least."""
    rate = frames / seconds if seconds > 0.0 else 0.0
    return f"{rate:.1f}" if rate >= 1.0 else f"{rate:.2g}"


def close(recording: Path, output: Path, outcome: RunOutcome, passes: int = 1) -> None:
    """Print the closing line and what there is to remark, and set the exit code."""
    from posetrack_cli.compiled import compiling_s
    from posetrack_cli.losses import loss_line
    from posetrack_cli.outputs import part_path

    _listener.get().on_end(outcome.tracked)
    whole_s, compiled_s = seconds_since_start(), compiling_s()
    what = (
        f"{outcome.tracked} frames in {whole_s:.1f} s ({_rate(outcome.tracked, whole_s)} frames/s; "
        f"tracking alone {_rate(outcome.tracked, outcome.seconds)} frames/s)"
    )
    if passes > 1:
        what += f" of {passes} passes, {outcome.frames} in the last"
    elif outcome.frames != outcome.tracked:
        what += f", {outcome.frames} with those before"
    what += f", {outcome.lost} lost"
    if compiled_s >= _LEAST_SAID_S:
        what += f", {compiled_s:.0f} s spent compiling"
    if outcome.stopped:
        print_note(f"interrupted after {what}: {part_path(output)}; --resume goes on")
        click.get_current_context().exit(EXIT_INTERRUPTED)
    print_line(f"{what}: {output}")
    for remark in outcome.remarks:
        print_remark(recording, remark)
    if not outcome.failure:
        tell_next(*next_of_result(recording, output))
    if outcome.losses:
        print_remark(recording, loss_line(outcome.losses))
    if outcome.failure:
        print_remark(recording, outcome.failure)
    if outcome.losses or outcome.failure:
        click.get_current_context().exit(EXIT_DATA_LOST)
