"""What no input may bring about: the rules that every outcome is held to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from hostile.case import Case
from hostile.running import CPU_S, Outcome, work_s
from posetrack_cli.errors import DAMAGED_HERE
from posetrack_cli.text import printable

MEMORY_BYTES = 1 << 30
"""Above the idle process."""
ENDINGS = ("", ".part", ".part.state", ".part.state.tmp")
"""Of names that the command may make beside its output while it is unfinished."""

_CONTROLS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]"
)
_BUGS = ("Traceback", "internal error", DAMAGED_HERE)
"""Said of what no adapter declares: a user reads one line, the search looks for its cause."""
_SAID = (*_BUGS, "Warning:", "[ WARN:", "[ERROR", "[mov,", "libpng", "TIFF")


def violations(case: Case, outcome: Outcome, *, slack: float = 1.0) -> list[str]:
    """Return what an outcome breaks, one line each; none for an outcome that is as it must be.

    Args:
        case: what was run.
        outcome: of it.
        slack: factor on the seconds of CPU, for a machine on which they are long.
    """
    return [
        *_ending(outcome),
        *_lines(case, outcome),
        *_characters(outcome),
        *_resources(case, outcome, slack),
        *_files(case, outcome),
        *(f"imported {name}" for name in outcome.modules),
        *outcome.events,
    ]


def _ending(outcome: Outcome) -> Iterator[str]:
    if outcome.ended:
        yield f"hang: {outcome.ended}"
    elif outcome.code not in (0, 1, 2, 3):
        yield f"exit code {outcome.code}"


def _lines(case: Case, outcome: Outcome) -> Iterator[str]:
    lines = outcome.error.decode("utf-8", "replace").splitlines()
    own = [line for line in lines if line.startswith("posetrack: ")]
    failed = outcome.code in (1, 2)
    gates = [line for line in lines if ": gate '" in line]  # how ``eval`` says that it judged, and how
    if failed and len(own) != 1 and not gates:
        yield f"{len(own)} lines 'posetrack: ...' for one failure"
    if outcome.code == 0 and own:
        yield "a line 'posetrack: ...' without a failure"
    if any("out of memory" in line for line in own):
        yield "out of memory: nothing else had stopped it"
    foreign = [line for line in lines if line not in own and not _is_remark(case, line)]
    if any(line.startswith("Traceback") for line in foreign):
        foreign = foreign[-1:]
    for line in foreign[:4]:
        yield f"a foreign line on standard error: {line[:300]}"
    both = lines + outcome.out.decode("utf-8", "replace").splitlines()
    for word in _SAID:
        if any(word in line for line in both if not line.startswith("posetrack: ") or word in _BUGS):
            yield f"'{word}' is said"


def _is_remark(case: Case, line: str) -> bool:
    """Whether a line has one of the forms that commands remark something in."""
    given = [argument for argument in case.command if not argument.startswith("-")]
    names = [printable(name) for argument in given for name in (argument, Path(argument).stem)]
    about = any(line.startswith(f"{name}: ") for name in names)
    return about or line.endswith(" ...")


def _characters(outcome: Outcome) -> Iterator[str]:
    for name, data in (("output", outcome.out), ("error", outcome.error)):
        try:
            text = data.decode()
        except UnicodeDecodeError:
            yield f"standard {name} is not UTF-8"
            continue
        found = _CONTROLS.search(text)
        if found:
            yield f"control character U+{ord(found.group()):04X} on standard {name}"


def _resources(case: Case, outcome: Outcome, slack: float) -> Iterator[str]:
    most_s = slack * (CPU_S + work_s(case))
    if outcome.cpu_s > most_s:
        yield f"{outcome.cpu_s:.1f} s of CPU, more than {most_s:.0f}"
    if outcome.peak_bytes > MEMORY_BYTES:
        yield f"{outcome.peak_bytes / 2**20:.0f} MiB of memory above the idle process"


def _files(case: Case, outcome: Outcome) -> Iterator[str]:
    for name in sorted(outcome.before.keys() | outcome.after.keys()):
        if outcome.before.get(name) == outcome.after.get(name):
            continue
        what = "gone" if name not in outcome.after else "changed" if name in outcome.before else "made"
        if what == "gone" and _is_kept(case, outcome, name):
            yield f"file {name} was deleted while resuming"
        elif not _is_output(case, name):
            yield f"file {name} was {what}"


def _is_output(case: Case, name: str) -> bool:
    made = {f"{output}{ending}" for output in case.outputs for ending in ENDINGS}
    return name in made or any(name.startswith(f"{output}/") for output in case.outputs)


def _is_kept(case: Case, outcome: Outcome, name: str) -> bool:
    """Whether a file holds what an interrupted run had tracked, and the run did not end well."""
    return "--resume" in case.command and name.endswith(".part") and outcome.code not in (0, 3)
