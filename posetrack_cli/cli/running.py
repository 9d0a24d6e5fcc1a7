"""Output shared by the tracking commands: compilation, progress, closing lines, suggested commands."""

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
from posetrack_cli.cli.process import leave_process, watch_signals
from posetrack_cli.cli.terminal import (
    bar,
    close_bars,
    print_detail,
    print_info,
    print_line,
    print_note,
    show_on_bar,
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
    """Open a recording with a command's options, and print the remarks on how it was opened."""
    from posetrack_cli.recording.opening import open_recording

    recording = open_recording(path, pixels, **reading_options(options), **further)
    print_opened(path, recording)
    return recording


def print_opened(path: Path, recording: Recording) -> None:
    """Print the remarks on how a recording was opened."""
    for camera in recording.cameras:
        print_detail(f"{path}: {camera.name or 'camera'} {camera.width}x{camera.height}, fx {camera.fx:.1f}")
    for remark in recording.remarks:
        print_note(f"{path}: {remark}")


@contextmanager
def announce_compiling(resumable: Path | None = None) -> Iterator[Callable[[], bool]]:
    """Announce kernel compilation on standard error, and let signals stop it.

    Yields a function that returns whether a kernel is being compiled.

    Args:
        resumable: output file, if the run can be resumed.
    """
    from posetrack_cli.compiled import announced, watched

    def give_up() -> None:
        close_bars()
        print_note(_interrupted(resumable))
        leave_process(EXIT_INTERRUPTED)

    def check() -> None:
        if stopped.is_set():  # before the first kernel, or between two kernels of a frame
            raise KeyboardInterrupt

    with (
        announced(
            lambda line: print_info(f"{line} ..."),
            lambda count: show_on_bar(f"compiling kernel {count}"),
        ),
        watched(lambda: check()) as is_compiling,
        watch_signals(is_compiling, give_up) as stopped,
    ):
        yield is_compiling


def _interrupted(resumable: Path | None) -> str:
    from posetrack_cli.outputs import part_path, state_path

    if resumable is None or not (state_path(resumable).is_file() and part_path(resumable).is_file()):
        return "posetrack: interrupted"
    return f"interrupted during compilation: {part_path(resumable)}; continue with --resume"


class Listener:
    """Callbacks of the tracking commands, for programs that run them; the default does nothing.

    Attributes:
        is_alone: whether a user runs the command, so that it may suggest the next one.
    """

    is_alone = True

    def on_frame(self, pass_name: str, done: int, total: int | None) -> None:
        """Handle a tracked frame; ``total`` is None if unknown."""

    def on_remark(self, text: str) -> None:
        """Handle a remark on the recording."""

    def on_end(self, tracked: int) -> None:
        """Handle the end, given the number of frames tracked in this run."""


_listener: ContextVar[Listener] = ContextVar("listener", default=Listener())  # noqa: B039 has no state


@contextmanager
def use_listener(listener: Listener) -> Iterator[None]:
    """Use a listener for the commands that run inside."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


def print_remark(recording: Path, text: str) -> None:
    """Print a remark on a recording, and pass it to the listener."""
    _listener.get().on_remark(text)
    print_note(f"{recording}: {text}")


@contextmanager
def progress(total: int | None, start: int, stride: int, name: str) -> Iterator[Any]:
    """Yield a function that moves the progress bar to an estimate's frame.

    The position follows the frame index: a resumed run continues where the interrupted one stopped, and a
    second pass starts again.
    """
    listener, statuses = _listener.get(), [""]
    with bar(name, "frame", total) as shown:

        def report(estimate: Estimate) -> None:
            done = len(range(start, estimate.frame_index + 1, stride))
            if shown.done == 0:
                shown.begin_at(done - 1)  # keeps frames of an earlier run out of the rate
            size = estimate.effective_sample_size
            weights = "" if size is None else f"ESS {size:.0f} "
            shown.advance(done - shown.done, f"{weights}{estimate.status}")
            if estimate.status != statuses[0]:
                statuses[0] = estimate.status
                print_detail(f"{name}: frame {estimate.frame_index}: {estimate.status}")
            listener.on_frame(name, done, total)

        yield report


def print_settings(config: Settings) -> None:
    """Print the settings that differ from the defaults (with --verbose)."""
    for key, value in _differences(config.model_dump(), type(config)().model_dump()):
        print_detail(f"{key} = {value}")


def _differences(given: Mapping[str, Any], usual: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in given.items():
        if isinstance(value, dict):
            yield from ((f"{key}.{within}", one) for within, one in _differences(value, usual.get(key) or {}))
        elif value != usual.get(key):
            yield key, value


@contextmanager
def name_partial_result(output: Path) -> Iterator[None]:
    """Add the path of the partial result to errors; usage errors occur before there is one."""
    from posetrack_cli.outputs import part_path

    try:
        yield
    except PosetrackError as error:
        part = part_path(output)
        if part.is_file() and not isinstance(error, UsageError):
            error.args = (f"{error}; frames tracked so far are kept in {part}",)
        raise


def print_next(*commands: Sequence[str | Path]) -> None:
    """Print suggested next commands, quoted for the shell; nothing within a batch."""
    if _listener.get().is_alone:
        for words in commands:
            line = shlex.join(map(_typed, words))
            if printable(line) == line:  # an escaped name could not be copied
                print_line(f"next: posetrack {line}")


def _typed(word: str | Path) -> str:
    """Return a word of a command line; a path that starts with a dash must not look like an option."""
    return f"./{word}" if isinstance(word, Path) and str(word).startswith("-") else str(word)


def next_of_result(recording: Path, result: Path) -> Iterator[Sequence[str | Path]]:
    """Yield the commands for a report and a video of a result."""
    page, video = result.with_suffix(".html"), result.with_suffix(".mp4")
    yield ("eval", result, "--html", page, *(["--overwrite"] if page.exists() else []))
    # face.mp4 tracked to face.mcap: the video must not replace the recording.
    is_recording = video.exists() and recording.exists() and video.samefile(recording)
    if is_recording:
        video = video.with_stem(f"{video.stem}-tracked")
    yield ("view", result, "-o", video, *(["--overwrite"] if video.exists() else []))


# Shorter compilation is not reported
_LEAST_COMPILING_S = 1.0


def _rate(frames: int, seconds: float) -> str:
    """Format frames per second with at least two digits."""
    rate = frames / seconds if seconds > 0.0 else 0.0
    return f"{rate:.1f}" if rate >= 1.0 else f"{rate:.2g}"


def _lost(outcome: RunOutcome) -> str:
    """Return the number of lost frames, with several subjects that of each."""
    of_each = ", ".join(f"{label}: {count}" for label, count in outcome.lost_by_label.items())
    return f"lost {of_each}" if of_each else f"{outcome.lost} lost"


def close(recording: Path, output: Path, outcome: RunOutcome, passes: int = 1) -> None:
    """Print the closing line, remarks and suggested commands, and set the exit code."""
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
        what += f" over {passes} passes, {outcome.frames} in the last"
    elif outcome.frames != outcome.tracked:
        what += f", {outcome.frames} including earlier runs"
    what += f", {_lost(outcome)}"
    if compiled_s >= _LEAST_COMPILING_S:
        what += f", {compiled_s:.0f} s spent compiling"
    if outcome.stopped:
        print_note(f"interrupted after {what}: {part_path(output)}; continue with --resume")
        click.get_current_context().exit(EXIT_INTERRUPTED)
    # Problems come after the suggested commands, at the end of the output, where they are seen.
    print_line(f"{what}: {output}")
    for remark in outcome.remarks:
        print_remark(recording, remark)
    if not outcome.failure:
        print_next(*next_of_result(recording, output))
    if outcome.losses:
        print_remark(recording, loss_line(outcome.losses))
    if outcome.failure:
        print_remark(recording, outcome.failure)
    if outcome.losses or outcome.failure:
        click.get_current_context().exit(EXIT_DATA_LOST)
