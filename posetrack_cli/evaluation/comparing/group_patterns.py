"""Groups of results by name and file pattern."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Sequence
from pathlib import Path

from posetrack_cli.errors import UsageError
from posetrack_cli.files import real_path

EXAMPLE = "such as rbpf='out/rbpf-*.mcap'"


def expand_groups(texts: Iterable[str]) -> dict[str, tuple[Path, ...]]:
    """Return the files of each ``NAME=PATTERN``, sorted; a name may come more than once.

    Raises:
        UsageError: it is no such text, no file fits, or a file is in two groups.
    """
    groups: dict[str, tuple[Path, ...]] = {}
    for text in texts:
        name, pattern = _split(text)
        found = _matching(pattern)
        if not found:
            hint = f"files of a folder are {pattern.rstrip('/')}/*.mcap" if Path(pattern).is_dir() else ""
            raise UsageError(f"no file fits the pattern of group '{name}'", found=pattern, hint=hint)
        groups[name] = tuple(dict.fromkeys((*groups.get(name, ()), *found)))
    _check_disjoint(groups)
    return groups


def _split(text: str) -> tuple[str, str]:
    name, sign, pattern = (part.strip() for part in text.partition("="))
    if not (name and sign and pattern):
        raise UsageError(f"'{text}' is no group", expected="NAME=PATTERN", hint=EXAMPLE)
    return name, pattern


def _matching(pattern: str) -> Sequence[Path]:
    """Files that fit; a file whose very name has brackets is found by it."""
    if Path(pattern).is_file():
        return [Path(pattern)]
    return [Path(name) for name in sorted(glob.glob(pattern, recursive=True)) if Path(name).is_file()]  # noqa: PTH207


def _check_disjoint(groups: dict[str, tuple[Path, ...]]) -> None:
    home: dict[Path, str] = {}
    for name, paths in groups.items():
        for path in paths:
            other = home.setdefault(real_path(path), name)
            if other != name:
                raise UsageError("file is in two groups", where=path, found=f"{other} and {name}")
