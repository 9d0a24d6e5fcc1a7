"""Files that options of a manifest name: models and configurations have to lie in its folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_text, real_path
from posetrack_cli.text import parse_toml

_CONFIGURATION, _ASSIGNMENT = "config", "set"
_MODELS = ("detector-model", "face-model", "hand-mesh", "load-model", "person", "shape")


def reachable(manifest: Path, option: str, value: Any) -> Any:
    """Return the value of an option; a file that lies where the manifest does is named from here.

    Raises:
        UsageError: it names a model or a configuration that lies outside the manifest's folder.
    """
    if isinstance(value, list):
        return [reachable(manifest, option, one) for one in value]
    if not isinstance(value, str) or not value:
        return value
    path = manifest.parent / value
    value = str(path) if path.exists() else value
    for file in _read_by(option, value):
        if file.is_file() and not real_path(file).is_relative_to(real_path(manifest.parent)):
            raise UsageError(
                f"option '{option}' names a file outside the manifest's folder",
                where=manifest,
                found=file,
                hint="copy it into that folder, or give it to posetrack batch as an option",
            )
    return value


def _read_by(option: str, value: str) -> Iterator[Path]:
    """Yield files that a tracker may read because of an option, also those that a configuration names."""
    if option in _MODELS or option == _CONFIGURATION:
        yield Path(value)
    with suppress(OSError, ValueError):  # what it is instead is refused when it is read
        if option == _CONFIGURATION:
            texts = _texts(parse_toml(read_text(Path(value), limits.TEXT_BYTES)))
            yield from (Path(value).parent / text for text in texts)
        elif option == _ASSIGNMENT:
            text = value.partition("=")[2].strip()
            yield Path(text)
            yield from map(Path, _texts(parse_toml(f"value = {text}")))


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _texts(one)
