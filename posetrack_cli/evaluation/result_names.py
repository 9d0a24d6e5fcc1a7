"""What results are called that are shown beside each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from posetrack_cli.outputs import part_path
from posetrack_cli.results.tracks import FILTERED

_PART = part_path(Path("x")).suffix


def plain_name(path: Path) -> str:
    """Return a file's name without folder and ending; NAME.part of an unfinished run counts as NAME.

    Line ends, control codes and bytes of no encoding, which a terminal would obey, are written as escapes.
    """
    return _printable(Path(path.name.removesuffix(_PART)).stem)


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Return a name for each path: its plain name, with the folder's where plain names are alike.

    What is still alike, such as one file given twice, is numbered.
    """
    plain = [plain_name(path) for path in paths]
    counts = Counter(plain)
    with_folder = [
        name if counts[name] == 1 else f"{_printable(path.absolute().parent.name)}/{name}"
        for name, path in zip(plain, paths, strict=True)
    ]
    unique: list[str] = []
    for name in with_folder:
        unique.append(_free(name, unique))
    return unique


def track_name(name: str, which: str, taken: Sequence[str]) -> str:
    """Return what a track is called beside others of its result: the filtered one as the result itself."""
    return name if which == FILTERED else _free(f"{name} {which}", taken)


def _printable(name: str) -> str:
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in name)


def _free(name: str, taken: Sequence[str]) -> str:
    """The name, or the first ``name (2)``, ``name (3)``, ... that is not taken."""
    number = 2
    free = name
    while free in taken:
        free, number = f"{name} ({number})", number + 1
    return free
