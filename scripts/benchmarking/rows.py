"""Measured figures, their targets, and a description of the machine."""

from __future__ import annotations

import json
import os
import platform
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.build import build_name
from posetrack_cli.rendering.port import RenderingDevice


@dataclass(frozen=True)
class Row:
    """One measured figure; the unit is empty for a ratio, the target is an upper limit."""

    name: str
    value: float
    unit: str
    target: float | None = None

    @property
    def verdict(self) -> str:
        """Whether the target is met, in words."""
        return "" if self.target is None else ("ok" if self.value <= self.target else "MISSED")

    @property
    def line(self) -> str:
        """Row of the printed table."""
        held = "" if self.target is None else f"target {self.target:g}  {self.verdict}"
        return f"{self.name:66} {self.value:10.3f} {self.unit:9} {held}".rstrip()


def rows_json(machine: Mapping[str, str], rows: Iterable[Row], **more: Any) -> str:
    """Return figures and machine as JSON."""
    table = [asdict(row) | {"verdict": row.verdict} for row in rows]
    return json.dumps({"source": dict(machine), "rows": table, **more}, indent=1) + "\n"


def source(script: str) -> dict[str, str]:
    """Return version, processor and command line of a script, for ``scripts/benchmark_page.py``."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "posetrack": build_name(),
        "processor": models[0] if models else platform.processor(),
        "command": shlex.join([script, *sys.argv[1:]]),
    }


def describe_machine(device: RenderingDevice, script: str) -> dict[str, str]:
    """Return processor, cores, load, Python and renderer."""
    return source(script) | {
        "cores": str(os.cpu_count()),
        "load": f"{os.getloadavg()[0]:.2f}",
        "system": platform.platform(),
        "python": platform.python_version(),
        "renderer": str(device.info),
    }


def median_of_pairs(one: Sequence[float], other: Sequence[float]) -> float:
    """Return the median ratio of times measured alternately."""
    return float(np.median(np.divide(one, other)))
