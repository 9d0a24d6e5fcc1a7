"""What of a run record is JSON or a number in text: checked once, so that whoever reads it can rely on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from pydantic_core import core_schema as schemas

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.recording.base import RUN_RECORD
from posetrack_cli.results.strict_json import reader_of


def check_run_record(run: Mapping[str, str]) -> None:
    """Refuse a run record whose values are not what runs write; those that it lacks are no fault.

    Raises:
        ResultError: names the key.
    """
    for key, check in _CHECKS.items():
        try:
            if key in run:
                check(run[key])
        except ValueError as error:
            raise ResultError(f"metadata {RUN_RECORD}: '{key}' cannot be read", found=error) from error


def _whole(text: str) -> None:
    if not text.isascii() or not text.isdigit() or int(text) > limits.INTEGER:
        raise ValueError(f"{text[:60]!r}, not a whole number from 0")


def _whole_or_none(text: str) -> None:
    if text:
        _whole(text)


def _positive(text: str) -> None:
    if text and not 0.0 < float(text) <= limits.NUMBER:
        raise ValueError(f"{text[:60]!r}, not a number above 0")


def _not_negative(text: str) -> None:
    if text and (not math.isfinite(value := float(text)) or not 0.0 <= value <= limits.NUMBER):
        raise ValueError(f"{text[:60]!r}, not a number from 0")


_OBJECT = reader_of(schemas.dict_schema(schemas.str_schema(), schemas.any_schema()))
_CHECKS: Mapping[str, Callable[[str], object]] = {
    "configuration": _OBJECT,
    "camera": _OBJECT,
    **dict.fromkeys(("start", "stride"), _whole),
    **dict.fromkeys(("seed", "end", "input.bytes"), _whole_or_none),
    **dict.fromkeys(("input.fps", "input.depth_unit_mm"), _positive),
    "input.tolerance_ms": _not_negative,
    "input.missing": _whole_or_none,
}
