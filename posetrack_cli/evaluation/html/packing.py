"""Packing of page data, and rendering of pages with inlined styles and scripts."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.build import version
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.html.components import readable
from posetrack_cli.evaluation.html.summary import described
from posetrack_cli.evaluation.reports.table import ABSENT
from posetrack_cli.files import write_output
from posetrack_cli.outputs import check_place, whole_or_nothing

if TYPE_CHECKING:
    from jinja2 import Environment


# Compact encoding of arrays and text


ArrayType: TypeAlias = Literal["u1", "i2", "i4", "u4", "f4"]
Packed: TypeAlias = dict[str, Any]
MISSING = -32768
"""Code of an unknown coordinate."""
LARGEST = 32767
FINEST_STEP_MM = 0.01


def envelope_rows(lines: FloatArray, limit: int) -> IntArray:
    """Select the rows that a plot of several lines needs.

    The rows are divided into equal intervals. Of each interval, the rows with the minimum and maximum of each
    line are kept, and the first row without a value, so that lines are interrupted correctly. The first and
    last row are also kept.

    Args:
        lines: (L, N) values; NaN or infinite for missing values.
        limit: approximate number of rows to keep; if N is not larger, all rows are kept.

    Returns:
        (R,) row numbers, increasing; R <= max(limit, 3 L + 2).
    """
    count = lines.shape[1]
    if count <= limit:
        return np.arange(count, dtype=np.int64)
    per_interval = 2 * len(lines) + int((~np.isfinite(lines)).any(axis=1).sum())
    intervals = max(1, (limit - 2) // per_interval)
    size = -(-count // intervals)
    chosen = [np.array([0, count - 1], dtype=np.int64)]
    for line in lines:
        chosen += _extremes(line, size)
    return np.unique(np.concatenate(chosen))


def _extremes(line: FloatArray, size: int) -> list[IntArray]:
    """Return the rows of minimum, maximum and first missing value of each block of ``size`` rows."""
    padding = -len(line) % size
    values = np.pad(line, (0, padding), constant_values=np.nan).reshape(-1, size)
    valid = np.isfinite(values)
    has_value = valid.any(axis=1)
    missing = ~valid
    # Padding at the end of the last block is not a missing value.
    if padding:
        missing[-1, -padding:] = False
    start = np.arange(len(values), dtype=np.int64) * size
    smallest = start + np.where(valid, values, np.inf).argmin(axis=1)
    largest = start + np.where(valid, values, -np.inf).argmax(axis=1)
    first_missing = start + missing.argmax(axis=1)
    return [smallest[has_value], largest[has_value], first_missing[missing.any(axis=1)]]


def step_for(count: int, limit: int) -> int:
    """Return the smallest k such that every k-th of ``count`` rows is at most ``limit`` rows."""
    return max(1, -(-count // limit))


def packed(values: NDArray[Any], kind: ArrayType) -> Packed:
    """Encode an array as base64 of its little-endian bytes; values too large for float32 become infinite."""
    with np.errstate(over="ignore"):
        data = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    return {"type": kind, "data": base64.b64encode(data.tobytes()).decode("ascii")}


def quantisation(points: FloatArray) -> tuple[FloatArray, float]:
    """Return origin (3,) and step, mm, for the quantisation of points (..., 3) to 16 bits.

    Points can be NaN. The step is at least ``FINEST_STEP_MM``; the rounding error is at most half a step.
    """
    finite = points[np.isfinite(points).all(axis=-1)]
    if not len(finite):
        return np.zeros(3), FINEST_STEP_MM
    low, high = finite.min(axis=0), finite.max(axis=0)
    return 0.5 * (low + high), max(FINEST_STEP_MM, float((high - low).max()) / (2 * LARGEST))


def quantised(points: FloatArray, origin: FloatArray, step: float) -> Packed:
    """Encode points (..., 3) as integer steps from the origin; ``MISSING`` for points that are not finite."""
    finite = np.isfinite(points).all(axis=-1, keepdims=True)
    steps = np.where(finite, np.rint((np.where(finite, points, 0.0) - origin) / step), MISSING)
    return packed(np.where(finite, np.clip(steps, -LARGEST, LARGEST), MISSING), "i2")


def json_text(data: Mapping[str, Any]) -> str:
    """Return JSON for a script element, with ``<``, ``>``, ``&`` escaped; NaN and infinity become null."""
    text = json.dumps(_finite(data), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float):  # includes np.float64
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


# Rendering of pages


HERE = Path(__file__).parent
ENDINGS = (".html", ".htm")


def check_page(path: Path) -> None:
    """Check that a page can be written, before the evaluation starts.

    Raises:
        UsageError: the name does not end with ``.html``, or is a folder.
        ResultError: the parent folder does not exist.
    """
    if path.suffix.lower() not in ENDINGS:
        raise UsageError("not an HTML file name", where=path, expected="a name that ends with .html")
    if path.is_dir():
        raise UsageError("output is a folder", where=path, expected="an HTML file name")
    check_place(path)


def write_page(path: Path, content: str) -> None:
    """Write a page to ``*.html`` atomically; an existing one is overwritten.

    Raises:
        UsageError: the name does not end with ``.html``, or is a folder.
        ResultError: the file cannot be written.
    """
    check_page(path)
    with whole_or_nothing(path) as part:
        write_output(part, content.encode("utf-8", "backslashreplace"))


def rendered(template: str, title: str, names: Iterable[str], /, **context: Any) -> str:
    """Render a template with inlined style and scripts.

    All values are escaped by Jinja2's autoescaping, except style, scripts and ``Markup``.

    Args:
        template: file in ``templates``.
        title: title of the page.
        names: names of the scripts, in execution order.
        context: variables of the template.
    """
    from markupsafe import Markup

    style, script = asset("report.css"), scripts(names)
    shared = {"title": title, "version": version(), "policy": policy(style, script)}
    return (
        _environment()
        .get_template(template)
        .render(shared | context, style=Markup(style), script=Markup(script))
    )


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_finalised,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"minus": _minus, "readable": readable}
    environment.globals |= {"described": described, "absent": ABSENT}
    return environment


def _finalised(value: Any) -> Any:
    """Make control characters in plain text visible; ``Markup`` is unchanged."""
    return visible(value) if type(value) is str else value


def visible(value: str) -> str:
    """Return text with unprintable characters replaced by U+FFFD."""
    return "".join(c if c.isprintable() or c in "\n\u202f\u00a0" else "\ufffd" for c in value)


def _minus(value: object) -> str:
    """Return a number with the typographic minus sign, which is as wide as a plus sign."""
    return str(value).replace("-", "\u2212")


def scripts(names: Iterable[str]) -> str:
    """Return the concatenated scripts."""
    # One script element, so that the security policy needs a single hash.
    return '"use strict";\n' + "\n".join(asset(f"scripts/{name}.js") for name in names)


def asset(name: str) -> str:
    """Return the text of a file in this package."""
    return (HERE / name).read_text(encoding="utf-8")


def policy(style: str, script: str) -> str:
    """Return a content security policy that allows only this script and style, and embedded pictures."""
    style_hash, script_hash = (
        base64.b64encode(hashlib.sha256(source.encode()).digest()).decode() for source in (style, script)
    )
    return (
        f"default-src 'none'; script-src 'sha256-{script_hash}'; style-src 'sha256-{style_hash}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
