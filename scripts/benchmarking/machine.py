"""What figures were measured on."""

from __future__ import annotations

import os
import platform
from pathlib import Path

from posetrack_cli.build import build_name
from posetrack_cli.rendering.port import RenderingDevice


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
