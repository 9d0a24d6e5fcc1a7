"""The hand that an earlier run tracked: its side and shape, as settings of another one."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import ValidationError

from posetrack_cli.errors import ResultError
from posetrack_cli.hand.config import HandSettings
from posetrack_cli.results.reader import read_result


def hand_assignments(path: Path) -> tuple[str, ...]:
    """Return the ``[hand]`` table of a result's run as assignments, such as ``hand.scale=1.05``.

    Args:
        path: of a result of ``hand run``, finished or not.

    Raises:
        ResultError: it is none, or says nothing of a hand.
    """
    run = read_result(path).run
    try:
        settings = HandSettings.model_validate(json.loads(run["configuration"])["hand"])
    except (KeyError, TypeError, ValueError, RecursionError, ValidationError) as error:
        raise ResultError(
            "tells no hand's shape", where=path, expected="a result of posetrack hand run"
        ) from error
    # texts, numbers and lists of numbers are the same in JSON and in TOML
    told = settings.model_dump(mode="json", exclude_none=True)
    return tuple(f"hand.{name}={json.dumps(value)}" for name, value in told.items())
