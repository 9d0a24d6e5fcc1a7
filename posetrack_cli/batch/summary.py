"""What came of a batch, in three files: CSV, JSON, and a page with one row for each recording."""
from __future__ import annotations
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from posetrack_cli.batch.jobs import Job, Outcome


@dataclass(frozen=True)
class Summary:
    gates_failed: tuple[str, ...]


def write_summary(folder: Path, jobs: Sequence[Job], outcomes: Sequence[Outcome]) -> Summary:
    return Summary(tuple(f"{o.name}: {g['line']}" for o in outcomes for g in o.measured.get("gates", ()) if g["failed"]))
