"""What measuring a long result costs."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarking.commands import POSETRACK, usage_of
from benchmarking.rows import Row
from long_result import write_long_result


def evaluation(frames: int) -> Iterator[Row]:
    """Time and peak memory of eval over a long result, and the size of the HTML page of a tenth of it."""
    with tempfile.TemporaryDirectory() as folder:
        long, short, page = (Path(folder, name) for name in ("long.mcap", "short.mcap", "page.html"))
        write_long_result(long, frames)
        write_long_result(short, frames // 10)
        began = time.perf_counter()
        seconds, mebibytes = usage_of([*POSETRACK, "eval", str(long)])
        yield Row(f"eval, {frames} frames with truth", time.perf_counter() - began, "s", 20.0)
        yield Row("  of it CPU time", seconds, "s")
        yield Row("  peak memory", mebibytes, "MiB", 476.8)  # 500 MB
        usage_of([*POSETRACK, "eval", str(short), "--html", str(page)])
        yield Row(f"HTML page, {frames // 10} frames", page.stat().st_size * 1e-6, "MB", 10.0)
