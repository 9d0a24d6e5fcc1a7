"""Tracking results: estimates and run record, written to and read from MCAP.

The names below are imported lazily, as MCAP and protobuf are slow to load.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from posetrack_cli.results.estimate import Estimate, Status, Subject
    from posetrack_cli.results.estimate_json import (
        ESTIMATE_SCHEMA,
        ESTIMATE_SCHEMA_NAME,
        estimate_from_json,
        estimate_to_json,
    )
    from posetrack_cli.results.reader import Result, ResultWarning, load_arrays, read_result
    from posetrack_cli.results.spool import Checkpoint
    from posetrack_cli.results.writer import ResultWriter

__all__ = [
    "ESTIMATE_SCHEMA",
    "ESTIMATE_SCHEMA_NAME",
    "Checkpoint",
    "Estimate",
    "Result",
    "ResultWarning",
    "ResultWriter",
    "Status",
    "Subject",
    "estimate_from_json",
    "estimate_to_json",
    "load_arrays",
    "read_result",
]

_MODULES = {
    "spool": ("Checkpoint",),
    "estimate": ("Estimate", "Status", "Subject"),
    "estimate_json": ("ESTIMATE_SCHEMA", "ESTIMATE_SCHEMA_NAME", "estimate_from_json", "estimate_to_json"),
    "reader": ("Result", "ResultWarning", "load_arrays", "read_result"),
    "writer": ("ResultWriter",),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
