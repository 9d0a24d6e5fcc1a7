"""What a user reads while a first run compiles, and how it is stopped then."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from posetrack_cli.cli.process import leave_process
from posetrack_cli.cli.signals import signals_watched
from posetrack_cli.cli.standard_output import print_note
from posetrack_cli.errors import EXIT_INTERRUPTED


@contextmanager
def compiling_said(resumable: Path | None = None) -> Iterator[Callable[[], bool]]:
    """Say on standard error, above any progress bar, that kernels are compiled; wait for none to stop.

    Yields a function that tells whether one is being compiled just now.

    Args:
        resumable: output that a stopped run can be resumed to.
    """
    from tqdm import tqdm

    from posetrack_cli.compiled import announced, watched

    def give_up() -> None:
        print_note(_interrupted(resumable))
        leave_process(EXIT_INTERRUPTED)

    def check() -> None:
        if asked.is_set():  # before this kernel, or between two of a frame
            raise KeyboardInterrupt

    with (
        announced(lambda line: tqdm.write(f"{line} ...", file=sys.stderr)),
        watched(lambda: check()) as is_compiling,
        signals_watched(is_compiling, give_up) as asked,
    ):
        yield is_compiling


def _interrupted(resumable: Path | None) -> str:
    from posetrack_cli.outputs import part_path, state_path

    if resumable is None or not (state_path(resumable).is_file() and part_path(resumable).is_file()):
        return "posetrack: interrupted"
    return f"interrupted while kernels were compiled: {part_path(resumable)}; --resume goes on"
