"""The page's numbers packed, and its styles and scripts."""

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


# Arrays and text as they are embedded in a page: fewer points that look the same, in few bytes


ArrayType: TypeAlias = Literal["u1", "i2", "i4", "u4", "f4"]
Packed: TypeAlias = dict[str, Any]
MISSING = -32768
"""Stored in place of a coordinate that is not known."""
LARGEST = 32767
FINEST_STEP_MM = 0.01


def envelope_rows(lines: FloatArray, limit: int) -> IntArray:
    """Choose the rows that a plot of several lines over the same rows needs.

    The rows are cut into equal intervals; of each interval the rows are kept where a line is smallest and
    largest, and the first at which it has no value, so that lines break where they must. The first and the
    last row are kept too.

    Args:
        lines: (L, N), NaN or infinite where a line has no value.
        limit: about how many rows to keep; all N are kept if they are no more than that.

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
    """Rows of the smallest and largest value and of the first missing one in every ``size`` rows."""
    padding = -len(line) % size
    values = np.pad(line, (0, padding), constant_values=np.nan).reshape(-1, size)
    valid = np.isfinite(values)
    has_value = valid.any(axis=1)
    missing = ~valid
    if padding:
        missing[-1, -padding:] = False
    start = np.arange(len(values), dtype=np.int64) * size
    smallest = start + np.where(valid, values, np.inf).argmin(axis=1)
    largest = start + np.where(valid, values, -np.inf).argmax(axis=1)
    first_missing = start + missing.argmax(axis=1)
    return [smallest[has_value], largest[has_value], first_missing[missing.any(axis=1)]]


def step_for(count: int, limit: int) -> int:
    """Return the k for which every k-th of ``count`` rows are no more than ``limit``."""
    return max(1, -(-count // limit))


def packed(values: NDArray[Any], kind: ArrayType) -> Packed:
    """Return an array as base64 of its little-endian bytes; numbers too large for float32 become infinite."""
    with np.errstate(over="ignore"):
        data = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    return {"type": kind, "data": base64.b64encode(data.tobytes()).decode("ascii")}


def quantisation(points: FloatArray) -> tuple[FloatArray, float]:
    """Return the origin (3,) and the step, mm, with which 16 bits hold points (..., 3), some perhaps NaN.

    The step is no finer than ``FINEST_STEP_MM``; a rounded coordinate is off by half a step at most.
    """
    finite = points[np.isfinite(points).all(axis=-1)]
    if not len(finite):
        return np.zeros(3), FINEST_STEP_MM
    low, high = finite.min(axis=0), finite.max(axis=0)
    return 0.5 * (low + high), max(FINEST_STEP_MM, float((high - low).max()) / (2 * LARGEST))


def quantised(points: FloatArray, origin: FloatArray, step: float) -> Packed:
    """Return points (..., 3) in whole steps from the origin, ``MISSING`` where one is not finite."""
    finite = np.isfinite(points).all(axis=-1, keepdims=True)
    steps = np.where(finite, np.rint((np.where(finite, points, 0.0) - origin) / step), MISSING)
    return packed(np.where(finite, np.clip(steps, -LARGEST, LARGEST), MISSING), "i2")


def json_text(data: Mapping[str, Any]) -> str:
    """Return JSON that can stand in a script element: no ``<``, ``>``, ``&``; NaN and infinity are null."""
    text = json.dumps(_finite(data), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float):  # numpy's float64 is one
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


# What every page is made of and how it is written: templates, style, scripts, security policy, one file


HERE = Path(__file__).parent
ENDINGS = (".html", ".htm")


def check_page(path: Path) -> None:
    """Refuse a name that a page cannot have, before time is spent on what it shows.

    Raises:
        UsageError: it does not end in ``.html``, or is a folder.
        ResultError: its folder does not exist.
    """
    if path.suffix.lower() not in ENDINGS:
        raise UsageError("page is not named as HTML", where=path, expected="a name that ends in .html")
    if path.is_dir():
        raise UsageError("page is a folder", where=path, expected="the name of a file")
    check_place(path)


def write_page(path: Path, content: str) -> None:
    """Write a page to ``*.html``, whole or not at all; an existing one is replaced.

    Raises:
        UsageError: the path is not named as a page, or is a folder.
        ResultError: it cannot be written.
    """
    check_page(path)
    with whole_or_nothing(path) as part:
        write_output(part, content.encode("utf-8", "backslashreplace"))


def rendered(template: str, title: str, names: Iterable[str], /, **context: Any) -> str:
    """Return a page: a template with its head, style and scripts, and what it shows.

    Everything is escaped (Jinja2's autoescape) but style, scripts and what is ``Markup`` already.

    Args:
        template: file in ``templates``.
        title: of the page.
        names: of its scripts, in the order in which they run.
        context: what the template names.
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
    """Text in which control characters can be seen; what is HTML already stays."""
    return visible(value) if type(value) is str else value


def visible(value: str) -> str:
    """Return text in which what has no shape of its own, such as a control character, is a sign."""
    return "".join(c if c.isprintable() or c in "\n\u202f\u00a0" else "\ufffd" for c in value)


def _minus(value: object) -> str:
    """A number with the sign that is as wide as a plus."""
    return str(value).replace("-", "\u2212")


def scripts(names: Iterable[str]) -> str:
    """Return these scripts as one, in this order."""
    return '"use strict";\n' + "\n".join(asset(f"scripts/{name}.js") for name in names)


def asset(name: str) -> str:
    """Return the text of a file beside this module."""
    return (HERE / name).read_text(encoding="utf-8")


def policy(style: str, script: str) -> str:
    """Return a content security policy: the page's own script and style, embedded pictures, nothing else."""
    style_hash, script_hash = (
        base64.b64encode(hashlib.sha256(source.encode()).digest()).decode() for source in (style, script)
    )
    return (
        f"default-src 'none'; script-src 'sha256-{script_hash}'; style-src 'sha256-{style_hash}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
