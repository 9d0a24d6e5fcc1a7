"""Measured figures, what they are held against, and what they were measured on."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.build import build_name
from posetrack_cli.rendering.port import RenderingDevice


@dataclass(frozen=True)
class Row:
    """One measured figure; its unit is empty for a ratio, its target what it should be at most."""

    name: str
    value: float
    unit: str
    target: float | None = None

    @property
    def verdict(self) -> str:
        """Whether the target is met."""
        return "" if self.target is None else ("ok" if self.value <= self.target else "MISSED")

    @property
    def line(self) -> str:
        """The row of the printed table."""
        held = "" if self.target is None else f"target {self.target:g}  {self.verdict}"
        return f"{self.name:66} {self.value:10.3f} {self.unit:9} {held}".rstrip()


def rows_json(machine: Mapping[str, str], rows: Iterable[Row], **more: Any) -> str:
    """Return figures as JSON, with what they were measured on."""
    table = [asdict(row) | {"verdict": row.verdict} for row in rows]
    return json.dumps({"machine": dict(machine), "rows": table, **more}, indent=1) + "\n"


def describe_machine(device: RenderingDevice) -> dict[str, str]:
    """Processor, cores, load, Python, renderer."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "posetrack": build_name(),
        "processor": models[0] if models else platform.processor(),
        "cores": str(os.cpu_count()),
        "load": f"{os.getloadavg()[0]:.2f}",
        "system": platform.platform(),
        "python": platform.python_version(),
        "renderer": str(device.info),
    }


def median_ms(seconds: Sequence[float]) -> float:
    """The median of times, in ms."""
    return 1e3 * float(np.median(seconds))


def median_of_pairs(one: Sequence[float], other: Sequence[float]) -> float:
    """The median ratio of times that were measured in turn."""
    return float(np.median(np.divide(one, other)))


def fitted_line(numbers: FloatArray, milliseconds: FloatArray) -> tuple[float, float]:
    """Offset and slope with the least squared relative residuals: every number counts alike."""
    design = np.stack([np.ones_like(numbers), numbers], axis=1) / milliseconds[:, None]
    (offset, slope), *_ = np.linalg.lstsq(design, np.ones_like(numbers), rcond=None)
    return float(offset), float(slope)
