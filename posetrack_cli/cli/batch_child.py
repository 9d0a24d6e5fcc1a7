"""Process of one batch job: runs it, writes the HTML page of the result and reports to the parent.

The task arrives as one line of JSON on standard input. The parent keeps that pipe open while it waits; at its
end the process exits. Reports (progress, remarks, cost) go to the descriptor given as the first argument, one
line of JSON each.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import sys
import threading
import time
from pathlib import Path
from typing import IO, Any

from posetrack_cli.cli.main import run, run_safely
from posetrack_cli.cli.process import leave_process, prepare_process, terminate_as_interrupted
from posetrack_cli.cli.running import Listener, use_listener
from posetrack_cli.cli.terminal import print_note
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_FAILED, PosetrackError, UsageError

_INPUT, _READ_BYTES = 0, 1 << 16
_TOLD_EVERY_S = 0.5


def main() -> None:
    """Run the job read from standard input, and exit with its exit code."""
    prepare_process()
    terminate_as_interrupted()
    task = json.loads(_line())
    threading.Thread(target=_leave_when_alone, daemon=True).start()
    _limit_memory(task["memory_bytes"])
    with os.fdopen(int(sys.argv[1]), "w", encoding="utf-8", buffering=1) as told:
        code = run_safely(lambda: _do(task, told))
        _tell(told, {"cpu_s": time.process_time(), "peak_bytes": _peak_bytes()})
    leave_process(code)


def _line() -> bytes:
    """Read the first line of standard input."""
    read = b""  # not via sys.stdin: its buffer lock would block the thread that waits for the end
    while not read.endswith(b"\n"):
        if not (piece := os.read(_INPUT, _READ_BYTES)):
            break
        read += piece
    return read


def _leave_when_alone() -> None:
    """Exit as soon as the parent has ended: the job may be started elsewhere."""
    while os.read(_INPUT, _READ_BYTES):
        pass
    # sys.exit would only end this thread.
    os._exit(EXIT_FAILED)


def _limit_memory(most_bytes: int | None) -> None:
    """Make allocations fail beyond a limit, so that the kernel's OOM killer does not pick another process."""
    if most_bytes is not None:
        faulthandler.disable()  # libraries abort when out of memory; no traceback for that
        resource.setrlimit(resource.RLIMIT_DATA, (most_bytes, most_bytes))


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _do(task: dict[str, Any], told: IO[str]) -> int:
    """Run the job and write the page of its result; return the job's exit code."""
    from posetrack_cli.build import source_digest
    from posetrack_cli.recording.identity import known_digests, tell_digests

    if task["sources"] != source_digest():
        raise UsageError(
            "posetrack on this worker differs from that of the batch",
            found=source_digest(),
            expected=task["sources"],
            hint="install the same version on all workers, then run the same command again",
        )
    # Digests computed by the split job save reading the whole recording again for each piece.
    if task["digests"]:
        tell_digests(task["digests"])
    if task["kind"] == "split":
        _tell(told, {"pieces": _split(task), "digests": known_digests()})
        return EXIT_DONE
    code = _joined(task) if task["kind"] == "join" else _tracked(task, told)
    if code in (EXIT_DONE, EXIT_DATA_LOST) and task["page"] is not None:
        _write_page(task)
    return code


class _Reporter(Listener):
    """Forwards remarks, the end and, at a limited rate, progress."""

    is_alone = False

    def __init__(self, told: IO[str]) -> None:
        self._told, self._last_s = told, 0.0

    def on_frame(self, pass_name: str, done: int, total: int | None) -> None:
        if (now := time.monotonic()) - self._last_s >= _TOLD_EVERY_S:
            self._last_s = now
            _tell(self._told, {"progress": [pass_name, done, total]})

    def on_remark(self, text: str) -> None:
        _tell(self._told, {"remark": text})

    def on_end(self, tracked: int) -> None:
        _tell(self._told, {"tracked": tracked})


def _tell(told: IO[str], what: dict[str, Any]) -> None:
    told.write(json.dumps(what) + "\n")


def _tracked(task: dict[str, Any], told: IO[str]) -> int:
    if not task["arguments"]:  # the result exists, only its page is missing
        return EXIT_DONE
    with use_listener(_Reporter(told)):
        return run(task["arguments"])


def _split(task: dict[str, Any]) -> list[list[int]]:
    from posetrack_cli.batch.jobs import split_frames
    from posetrack_cli.cli.batch_commands import BATCH_COMMANDS

    command = BATCH_COMMANDS[tuple(task["command"])]
    recording, options = command.opened(Path(task["recording"]), task["options"])
    recording.identity()  # digests the whole recording once, for all pieces
    pieces = split_frames(
        recording,
        task["chunk_s"],
        task["overlap_s"],
        start=options["start"],
        end=options["end"],
        stride=options["stride"],
        looks_ahead=options["smooth"],
    )
    return [[piece.start, piece.end, piece.first, piece.last] for piece in pieces]


def _joined(task: dict[str, Any]) -> int:
    from posetrack_cli.batch.jobs import Piece, join_results

    pieces = [(Path(path), Piece(**piece)) for path, piece in task["pieces"]]
    has_losses = join_results(pieces, Path(task["output"]), task["chunk_s"], task["overlap_s"])
    return EXIT_DATA_LOST if has_losses else EXIT_DONE


def _write_page(task: dict[str, Any]) -> None:
    """Measure the result and write its page; an error does not invalidate the result."""
    from posetrack_cli.cli.eval import write_page
    from posetrack_cli.evaluation.judging.assessment import Request, assess
    from posetrack_cli.evaluation.measuring.evaluate import EvalOptions

    truth = None if task["truth"] is None else Path(task["truth"])
    request = Request((Path(task["output"]),), options=EvalOptions(truth=truth), keep_tracks=True, page=True)
    try:
        write_page(assess(request), Path(task["page"]), Path(task["recording"]))
    except PosetrackError as error:
        print_note(f"{task['page']}: page not written: {error}")


if __name__ == "__main__":
    main()
