"""The hand that a result's run tracked, from what the result states of it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

from posetrack_cli.configuration import validated
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.hand.anatomy import HandAnatomy, make_anatomy
from posetrack_cli.hand.config import HandConfig, HandSettings
from posetrack_cli.hand.model import MESH_DIGEST, HandModel, hand_model
from posetrack_cli.hand.shape import reshaped_anatomy
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.results.reader import Result


def hand_of(result: Result) -> HandModel:
    """Return the hand that a run tracked, from the configuration in its record.

    A hand from a file is looked for by the end of the path that the record states: beside the result, one
    folder up, and in the working folder. A result may be a stranger's, so what it states leads nowhere else,
    and only to a file of the digest that it states.

    Raises:
        ResultError: the record holds no configuration of a hand run, or the hand's file is not found.
        UsageError: the hand's file cannot be used.
    """
    settings = _settings(result)
    if settings.mesh is not None:
        settings = settings.model_copy(update={"mesh": str(_found_mesh(result, settings.mesh))})
    return hand_model(settings)


def anatomy_of(result: Result) -> HandAnatomy:
    """Return the bones of the hand that a run tracked: those of ``hand_of``, without the time its skin takes.

    Raises:
        ResultError, UsageError: as ``hand_of``.
    """
    settings = _settings(result)
    right = make_anatomy() if settings.mesh is None else _anatomy_of_file(_found_mesh(result, settings.mesh))
    return reshaped_anatomy(right, "left" if settings.side == "left" else "right", settings.shape)


def _anatomy_of_file(path: Path) -> HandAnatomy:
    from posetrack_cli.hand.webxr import load_hand  # takes long to import, and few hands are from a file

    return load_hand(path).anatomy


def _settings(result: Result) -> HandSettings:
    try:
        stated: Any = json.loads(result.run["configuration"])["hand"]
        return validated(HandSettings, stated, "run record")
    except (KeyError, TypeError, ValueError, RecursionError, UsageError) as error:
        what = "run record holds no hand's configuration"
        expected = "the record of a hand run"
        raise ResultError(what, where=result.path, found=error, expected=expected) from error


def _found_mesh(result: Result, stated: str) -> Path:
    # imports all that opens recordings
    from posetrack_cli.evaluation.recording_of import folders_of, places_of

    files = [path for path in places_of(stated, folders_of(result)) if os.path.isfile(path)]  # noqa: PTH113 never raises
    for path in files:
        if file_digest(path)[1] == result.run.get(MESH_DIGEST):
            return path
    if files:
        raise ResultError("not the hand that the run tracked: its file has changed", where=files[0])
    raise ResultError(
        "the hand that the run tracked is not found",
        where=result.path,
        found=f"no {PurePath(stated).name} beside it or in the working folder",
        hint="copy the file there",
    )


def configuration_of(run: Mapping[str, str]) -> HandConfig:
    """The configuration of a hand run, from its record.

    Raises:
        ResultError: the record holds none.
    """
    try:
        return validated(HandConfig, json.loads(run["configuration"]), "run record")
    except (KeyError, TypeError, ValueError, UsageError) as error:
        what = "run record holds no hand's configuration"
        raise ResultError(what, found=error, expected="the record of a hand run") from error
