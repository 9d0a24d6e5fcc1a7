"""Runs that begin together on an empty kernel cache, each compiling while the others do."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

from benchmarking.rows import Row
from soaking.cases import Case
from soaking.findings import Findings
from soaking.processes import DONE, started
from soaking.reference import Reference


def soak_cold(case: Case, reference: Reference, at_once: int, folder: Path, findings: Findings) -> None:
    """Start so many equal runs at once with an empty cache; all must come to the result of a warm one."""
    folder.mkdir()
    environment = {"NUMBA_CACHE_DIR": str(folder / "cache")}
    outputs = [folder / f"{number}.mcap" for number in range(at_once)]
    began = time.perf_counter()
    with ExitStack() as stack:
        runs = [
            stack.enter_context(started(case.command(output), output.with_suffix(".txt"), environment))
            for output in outputs
        ]
        ended = [run.end() for run in runs]
    seconds = time.perf_counter() - began
    wrong = 0
    for output, end in zip(outputs, ended, strict=True):
        troubles = list(end.troubles((DONE,)))
        if not troubles and output.read_bytes() != reference.data:
            troubles = ["the result differs from that of a run with compiled kernels"]
        wrong += not findings.troubles_of(f"{case.name}, cold run {output.stem}", troubles)
    findings.add(Row(f"{case.name}, {at_once} at once on an empty kernel cache, total time", seconds, "s"))
    findings.add(Row(f"{case.name}, of them failed or with other bytes", wrong, "", 0.0))
