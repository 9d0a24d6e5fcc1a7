"""Commands that a batch can run, and the progress display of a batch."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from posetrack_cli.cli.hand import hand_run, open_hand_recording
from posetrack_cli.cli.head_run import head_mono, head_stereo, open_mono_recording, open_stereo_recording
from posetrack_cli.cli.terminal import bar, is_quiet, print_note
from posetrack_cli.errors import PosetrackError, UsageError, nearest_name

if TYPE_CHECKING:
    from posetrack_cli.batch.engine import JobProgress
    from posetrack_cli.batch.jobs import Job, Outcome
    from posetrack_cli.recording.recording import Recording


class BatchProgress:
    """Progress of a batch: a bar and failures on a terminal, else one line per recording.

    Args:
        total: number of recordings.
    """

    def __init__(self, total: int) -> None:
        self._total, self._over, self._failed = total, 0, 0
        self._frames: dict[str, int] = {}  # of running jobs, by name
        self._done, self._began_s = 0, time.monotonic()
        self._lock = Lock()  # callbacks come from threads of the engine
        self._stack = ExitStack()
        self._bar = self._stack.enter_context(bar("batch", "recording", total))

    def __enter__(self) -> BatchProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def on_progress(self, told: JobProgress) -> None:
        """Update the frame count of a running job."""
        with self._lock:
            self._frames[told.job] = told.frames
            self._show()

    def on_outcome(self, outcome: Outcome) -> None:
        """Count a finished recording, and print its line."""
        from posetrack_cli.batch.jobs import recording_of

        with self._lock:
            others = {name: n for name, n in self._frames.items() if recording_of(name) != outcome.name}
            self._frames = others
            self._over += 1
            self._done += outcome.frames
            is_failed = outcome.state == "failed"
            self._failed += is_failed
            if is_failed or outcome.reason or not (self._bar.is_drawn or is_quiet()):
                print_note(f"[{self._over}/{self._total}] {line_of(outcome)}")
            self._show(1)

    def note(self, line: str) -> None:
        """Print a note above the bar."""
        with self._lock:
            print_note(line)

    def _show(self, over: int = 0) -> None:
        frames = self._done + sum(self._frames.values())
        rate = frames / max(1e-9, time.monotonic() - self._began_s)
        failed = f"{self._failed} failed, " if self._failed else ""
        self._bar.advance(over, f"{failed}{frames} frames, {rate:.1f}/s")


def line_of(outcome: Outcome) -> str:
    """Return the outcome of a recording as one line."""
    if outcome.state == "failed":
        return f"{outcome.name}: failed: {outcome.reason}"
    if outcome.state == "kept":
        return f"{outcome.name}: kept"
    rate = f" ({outcome.frames / outcome.seconds:.1f} frames/s)" if outcome.seconds and outcome.frames else ""
    done = f"{outcome.frames} frames in {outcome.seconds:.1f} s{rate}"
    reason = f"; {outcome.reason}" if outcome.reason else ""
    return f"{outcome.name}: {outcome.state.value}, {done}{reason}"


# Parameters that a batch sets itself, or that name a single output file
_OWN = ("recording", "output", "resume", "overwrite", "save_model", "quiet", "verbose")
# Applies to the first piece of a recording only
_OF_FIRST = "init"
_FRAMES = ("start", "end")


@dataclass(frozen=True)
class BatchCommand:
    """A command that tracks one recording.

    Attributes:
        words: name of the command, such as ``("hand", "run")``.
        command: the click command.
        open: opens a recording, given the command's options.
        learned: returns options that start a piece from the shape or model of another one, given the
            recording's options and that piece's result.
        shared: option that takes the person's hand or face from a file; empty if the command measures each
            person itself.
        excluding: options that determine the hand or face themselves.
        determining: number of recordings that determine it.
        write_shared: writes the file from their results; None if it is the first result.
        recordings: argument for the examples in the help.
    """

    words: tuple[str, ...]
    command: click.Command
    open: Callable[[Path, dict[str, Any]], Recording]
    learned: Callable[[Sequence[str], Path], tuple[str, ...]]
    recordings: str
    shared: str = ""
    excluding: tuple[str, ...] = ()
    determining: int = 1
    write_shared: Callable[[Sequence[Path], Path], None] | None = None

    @property
    def examples(self) -> tuple[str, ...]:
        """Examples for the help of the batch command."""
        start = f"posetrack batch {' '.join(self.words)}"
        return (
            f"{start} {self.recordings} -o results/",
            f"{start} list.txt -o results/ --fail-if 'coverage < 0.9'",
        )

    @property
    def parameters(self) -> list[click.Parameter]:
        """Parameters that apply to every recording of a batch."""
        return [one for one in self.command.params if one.name not in _OWN]

    def arguments(self, context: click.Context) -> tuple[str, ...]:
        """Return the options given on the command line, one argument each."""
        given = (one for one in self.parameters if _is_given(context, one))
        return tuple(token for one in given for token in _tokens(one, context.params[str(one.name)]))

    def arguments_of(self, options: Mapping[str, Any], where: object) -> tuple[str, ...]:
        """Return the options of a manifest as arguments.

        Args:
            options: values by long name without dashes; booleans for switches, lists for repeatable options.
            where: the manifest, for errors.

        Raises:
            UsageError: an unknown option, or one that a batch sets itself.
        """
        known = {
            name.lstrip("-"): one for one in self.parameters for name in (*one.opts, *one.secondary_opts)
        }
        tokens: list[str] = []
        for name, value in options.items():
            if name not in known:
                raise UsageError(f"unknown option '{name}'", where=where, hint=nearest_name(name, known))
            tokens += _tokens_of_value(name, known[name], value, where)
        return tuple(tokens)

    def check(self, arguments: Iterable[str], where: object = "") -> dict[str, Any]:
        """Parse arguments into parameters.

        Raises:
            UsageError: an invalid value.
        """
        # Placeholders for required arguments; nothing is opened.
        line = [*arguments, "--output=checked.mcap", "--", "checked"]
        try:
            with self.command.make_context(" ".join(self.words), line) as context:
                return dict(context.params)
        except click.ClickException as error:
            message = " ".join(error.format_message().split()).removesuffix(".")
            raise UsageError(message, where=where) from error

    def opened(self, recording: Path, arguments: Iterable[str]) -> tuple[Recording, dict[str, Any]]:
        """Open a recording, and return it with the parsed parameters."""
        parameters = self.check(arguments, recording)
        return self.open(recording, parameters), parameters

    def of_piece(self, arguments: Iterable[str], number: int, learned: Path) -> tuple[str, ...]:
        """Return the options of a piece of a recording, without its frame range.

        Args:
            arguments: options of the recording.
            number: index of the piece; the others start from the shape or model learned in the first.
            learned: result of the first piece.
        """
        left_out = _FRAMES if number == 0 else (*_FRAMES, _OF_FIRST)
        kept = [one for one in arguments if one.partition("=")[0].lstrip("-") not in left_out]
        return tuple(kept) if number == 0 else (*kept, *self.learned(kept, learned))

    def of_person(self, arguments: Sequence[str], first: Job) -> tuple[str, ...]:
        """Return the options of a recording that takes the hand or face from others of the same person.

        Args:
            arguments: its own options.
            first: job of the person's first recording.
        """
        given = {one.partition("=")[0] for one in arguments}
        if not self.shared or given & {self.shared, *self.excluding} or "--faces=all" in arguments:
            return tuple(arguments)
        return (*arguments, f"{self.shared}={self._shared_file(first)}")

    def share(self, learned: Sequence[Job]) -> bool:
        """Write the file that ``of_person`` names; return False if that is not possible."""
        if self.write_shared is not None:
            try:
                self.write_shared([one.output for one in learned], self._shared_file(learned[0]))
            except (PosetrackError, OSError):
                return False
        return True

    def _shared_file(self, first: Job) -> Path:
        return first.output if self.write_shared is None else first.record.with_suffix(".person.toml")


def _is_given(context: click.Context, parameter: click.Parameter) -> bool:
    return context.get_parameter_source(str(parameter.name)) is ParameterSource.COMMANDLINE


def _tokens(parameter: click.Parameter, value: Any) -> list[str]:
    """Convert a parsed option back to arguments."""
    long = max(parameter.opts, key=len)  # "--seed=1" is one argument, and safe for values with a dash
    if isinstance(parameter, click.Option) and parameter.is_flag:
        return [long if value else max(parameter.secondary_opts, key=len)]
    values = value if parameter.multiple else [value]
    return [f"{long}={one}" for one in values]


def _tokens_of_value(name: str, parameter: click.Parameter, value: Any, where: object) -> list[str]:
    """Convert an option of a manifest to arguments."""
    is_flag = isinstance(parameter, click.Option) and parameter.is_flag
    if is_flag != isinstance(value, bool):
        expected = "true or false" if is_flag else "text or a number"
        raise UsageError(f"invalid value of '{name}'", where=where, found=repr(value), expected=expected)
    if is_flag:
        other = parameter.secondary_opts if f"--{name}" in parameter.opts else parameter.opts
        return [f"--{name}"] if value else list(other[:1])
    return [f"--{name}={one}" for one in (value if isinstance(value, list) else [value])]


def _hand_learned(arguments: Sequence[str], result: Path) -> tuple[str, ...]:
    return (f"--shape={result}",)


def _write_mean_shape(results: Sequence[Path], path: Path) -> None:
    from posetrack_cli.hand.shape_fit import write_mean_shape

    write_mean_shape(results, path)


def _head_learned(arguments: Sequence[str], result: Path) -> tuple[str, ...]:
    if any(one.startswith("--person=") for one in arguments):
        return ()  # --person fixes the face of all pieces
    # The model of the first piece replaces the learning pass.
    return ("--passes=1", f"--load-model={result}")


_EVERY = (
    BatchCommand(
        ("hand", "run"),
        hand_run,
        open_hand_recording,
        _hand_learned,
        "'in/**/*.mcap'",
        "--shape",
        ("--scale", "--hand-mesh"),
        2,  # one recording's shape costs the others 29 % of their accuracy, the mean of two hardly anything
        _write_mean_shape,
    ),
    BatchCommand(("head", "stereo"), head_stereo, open_stereo_recording, _head_learned, "'in/**/*.mcap'"),
    BatchCommand(
        ("head", "mono"),
        head_mono,
        open_mono_recording,
        _head_learned,
        "'in/*.mp4'",
        "--person",
        ("--load-model", "--init", "--interpupillary-mm", "--landmarks"),
    ),
)
BATCH_COMMANDS = {one.words: one for one in _EVERY}
