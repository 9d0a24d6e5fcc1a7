"""Paths that match a pattern, found within bounds: a stranger's list may hold the pattern ``/**``."""

from __future__ import annotations

import fnmatch
import os
import re
import stat
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path

from posetrack_cli import limits
from posetrack_cli.errors import UsageError

MAGIC = "*?["
"""Signs that make a name a pattern."""
_ANY_DEPTH = "**"


class Search:
    """Looks for the recordings of one batch, at no more than ``limits.SEARCH_ENTRIES`` files and folders."""

    def __init__(self) -> None:
        self._left = limits.SEARCH_ENTRIES

    def matches(self, pattern: Path) -> list[Path]:
        """Return the sorted paths that match, as ``glob.glob`` with ``**`` does, but for links.

        Folders below ``**`` count once by where they lie, so that links which form a ring end.

        Raises:
            UsageError: there is too much to look at.
        """
        try:
            found = set(self._expanded("", pattern.parts))
        except RecursionError:
            raise UsageError("pattern of too many parts", where=pattern) from None
        except _TooMuchError:
            raise UsageError(
                "pattern looks at too many files and folders",
                where=pattern,
                expected=f"at most {limits.SEARCH_ENTRIES}",
                hint="begin it with the folder that holds the recordings",
            ) from None
        return [Path(one) for one in sorted(found)]

    def _expanded(self, base: str, parts: Sequence[str]) -> Iterator[str]:
        """The paths below a folder that match the parts of a pattern."""
        if not parts:
            yield base
            return
        part, rest = parts[0], parts[1:]
        if part == _ANY_DEPTH:
            while rest and rest[0] == _ANY_DEPTH:
                rest = rest[1:]
            for folder in self._folders_below(base):
                yield from self._expanded(folder, rest)
                if not rest:
                    yield from (path for path, one in self._entries(folder) if not _is_hidden(one, part))
        elif any(sign in part for sign in MAGIC):
            fits = re.compile(fnmatch.translate(part)).match
            for path, entry in self._entries(base):
                if fits(entry.name) and not _is_hidden(entry, part) and (not rest or _is_folder(entry)):
                    yield from self._expanded(path, rest)
        else:
            path = os.path.join(base, part)  # noqa: PTH118 as Path it would lose nothing but time
            if os.path.isdir(path) if rest else os.path.lexists(path):  # noqa: PTH112 the same
                yield from self._expanded(path, rest)

    def _folders_below(self, base: str) -> Iterator[str]:
        """A folder and those below it; links come last, so that folders keep their own names."""
        folders, links, seen = [base], deque[str](), set[tuple[int, int]]()
        while folders or links:
            folder = folders.pop() if folders else links.popleft()
            try:
                state = os.stat(folder or os.curdir)  # noqa: PTH116 the same
            except (OSError, ValueError):
                continue
            place = state.st_dev, state.st_ino
            if place in seen or not stat.S_ISDIR(state.st_mode):
                continue
            seen.add(place)
            yield folder
            for path, entry in self._entries(folder):
                if _is_folder(entry) and not _is_hidden(entry, _ANY_DEPTH):
                    (links if entry.is_symlink() else folders).append(path)

    def _entries(self, folder: str) -> Iterator[tuple[str, os.DirEntry[str]]]:
        """What lies in a folder, with its path; nothing where the folder cannot be read."""
        self._count()
        try:
            with os.scandir(folder or os.curdir) as entries:
                for entry in entries:
                    self._count()
                    yield os.path.join(folder, entry.name), entry  # noqa: PTH118 the same
        except (OSError, ValueError):
            return

    def _count(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise _TooMuchError


class _TooMuchError(Exception):
    """A search that comes to its bound."""


def _is_hidden(entry: os.DirEntry[str], part: str) -> bool:
    return entry.name.startswith(".") and not part.startswith(".")


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # links that form a ring
        return False
