"""Recordings of a batch: patterns, lists, manifests."""

from __future__ import annotations

import fnmatch
import os
import re
import stat
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field

from posetrack_cli import limits
from posetrack_cli.bags.ros2 import is_ros2_folder
from posetrack_cli.configuration import Settings, validated
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_text, real_path
from posetrack_cli.text import one_line, parse_toml

# Paths that match a pattern, found within bounds: a stranger's list may hold the pattern ``/**``


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


# Files that options of a manifest name: models and configurations have to lie in its folder


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


# Which recordings a batch is of: patterns, a list of names, or a manifest with options of each


_LIST_ENDINGS = (".txt", ".list")


@dataclass(frozen=True)
class Source:
    """A recording of a batch.

    Attributes:
        path: file or folder.
        name: of its result, below the folder of results and without ending.
        options: of the command, by long name without dashes: text, numbers, true for switches, or lists.
        truth: that its result is measured with.
        gates: conditions under which that fails.
        manifest: that it is of, if any.
    """

    path: Path
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    truth: Path | None = None
    gates: tuple[str, ...] = ()
    manifest: Path | None = None


class ManifestRecording(Settings):
    """A table ``[[recordings]]`` of a manifest.

    Attributes:
        path: file, folder or pattern, relative to the manifest.
        name: of the result; by default the recording's. Not of a pattern.
        options: of the command.
        truth: file that the result is measured with; by default what the recording carries.
        gates: conditions under which it fails.
    """

    path: str
    name: str | None = None
    options: dict[str, bool | int | float | str | list[str]] = Field(default_factory=dict)
    truth: str | None = None
    gates: tuple[str, ...] = ()


class Manifest(Settings):
    """A file of recordings.

    Attributes:
        options: of the command, for all recordings; those of a recording come first.
        gates: for all recordings, besides their own.
        recordings: each with what differs.
    """

    options: dict[str, bool | int | float | str | list[str]] = Field(default_factory=dict)
    gates: tuple[str, ...] = ()
    recordings: tuple[ManifestRecording, ...]


def find_sources(given: Sequence[str], results: Path | None = None) -> list[Source]:
    """Return the recordings that arguments stand for.

    Args:
        given: each a file or folder, a pattern (``**`` goes through folders), a list of those (``.txt``) with
            one a line, or a manifest (``.toml``).
        results: folder of results; what a pattern finds in it is no recording.

    Raises:
        UsageError: nothing is there, or what is there cannot be meant.
    """
    look = _Look(Search(), results)
    found = [source for one in given for source in _sources_of(one, look)]
    _check_names(found)
    return found


@dataclass(frozen=True)
class _Look:
    """How recordings of one batch are looked for: within the bounds of one search, not among its results."""

    search: Search
    results: Path | None


def _sources_of(given: str, look: _Look) -> list[Source]:
    path = Path(given)
    if path.suffix == ".toml":
        return _read_manifest(path, look)
    if path.suffix in _LIST_ENDINGS and not path.is_dir():
        return _read_list(path, look)
    return [Source(path, name) for path, name in _matched(given, None, look)]


def _matched(pattern: str, base: Path | None, look: _Look) -> list[tuple[Path, str]]:
    """The files and folders of a pattern, with names relative to the part of it without wildcards."""
    path = Path(pattern) if base is None else base / pattern
    if not any(sign in pattern for sign in MAGIC) or path.exists():
        if not path.exists():
            raise UsageError("no such recording", where=path)
        return [(path, _plain_name(path))]
    fixed = _fixed_part(path)
    found = look.search.matches(path)
    whole = {one for one in found if is_ros2_folder(one)}
    above = {folder for one in found for folder in one.parents}
    recordings = [
        one
        for one in found
        if one != fixed and _may_be_recording(one, above, whole) and not _is_in(one, look.results)
    ]
    if not recordings:
        raise UsageError(
            "no recording matches", where=path, hint="quote the pattern, so that ** is seen by posetrack"
        )
    return [(one, str(one.relative_to(fixed).with_suffix(""))) for one in recordings]


def _fixed_part(pattern: Path) -> Path:
    """The folders before the first wildcard."""
    parts: list[str] = []
    for part in pattern.parts[:-1]:
        if any(sign in part for sign in MAGIC):
            break
        parts.append(part)
    return Path(*parts)


def _may_be_recording(path: Path, above: Set[Path], whole: Set[Path]) -> bool:
    """Whether a path is no folder in which others were found, unless it is one recording, and in none such.

    Args:
        path: found by a pattern; ``**`` finds folders, too.
        above: the folders that others were found in.
        whole: the folders among those found that are one recording each, of ROS 2.
    """
    if path in whole or not whole.isdisjoint(path.parents):
        return path in whole
    return path not in above or not path.is_dir()


def _is_in(path: Path, folder: Path | None) -> bool:
    return folder is not None and folder.resolve() in (path.resolve(), *path.resolve().parents)


def _plain_name(path: Path) -> str:
    name = path.resolve().name if path.name in ("", "..") else path.name
    return Path(name).stem if path.is_file() else name


def _read_list(path: Path, look: _Look) -> list[Source]:
    """The recordings of a file with one name or pattern a line, relative to it; # begins a remark."""
    lines = [line.partition("#")[0].strip() for line in _text_of(path).splitlines()]
    found = [
        Source(recording, name)
        for line in lines
        if line
        for recording, name in _matched(line, path.parent, look)
    ]
    if not found:
        raise UsageError("names no recording", where=path)
    return found


def _read_manifest(path: Path, look: _Look) -> list[Source]:
    """The recordings of a manifest."""
    try:
        values = parse_toml(_text_of(path))
    except ValueError as error:
        raise UsageError("not a TOML file", where=path, found=error) from error
    manifest = validated(Manifest, values, path)
    if not manifest.recordings:
        raise UsageError("names no recording", where=path, expected="tables [[recordings]]")
    return [source for one in manifest.recordings for source in _of_manifest(path, manifest, one, look)]


def _of_manifest(path: Path, manifest: Manifest, one: ManifestRecording, look: _Look) -> Iterable[Source]:
    found = _matched(one.path, path.parent, look)
    if one.name is not None and len(found) > 1:
        raise UsageError(f"name '{one.name}' of several recordings", where=path, found=one.path)
    truth = None if one.truth is None else path.parent / one.truth
    if truth is not None and not truth.exists():
        raise UsageError("no such truth", where=path, found=one.truth)
    given = {**manifest.options, **one.options}
    options = {key: reachable(path, key, value) for key, value in given.items()}
    gates = (*manifest.gates, *one.gates)
    for recording, name in found:
        yield Source(recording, _checked_name(path, one.name or name), options, truth, gates, path)


def _checked_name(path: Path, name: str) -> str:
    """A name that stays below the folder of results."""
    parts = Path(name).parts
    if not parts or Path(name).is_absolute() or ".." in parts:
        raise UsageError("name of a result cannot be used", where=path, found=repr(name))
    return str(Path(name))


def _text_of(path: Path) -> str:
    try:
        return read_text(path, limits.TEXT_BYTES)
    except OSError as error:
        raise UsageError("cannot be read", where=path, found=error.strerror or error) from error
    except UnicodeDecodeError as error:
        raise UsageError("is no text", where=path, found=error) from error


def _check_names(sources: Sequence[Source]) -> None:
    """Refuse two recordings whose results would be one file."""
    first: dict[str, Source] = {}
    for source in sources:
        other = first.setdefault(one_line(source.name), source)
        if other is not source:
            raise UsageError(
                f"two recordings would write one result, {source.name}.mcap",
                found=f"{other.path} and {source.path}",
                hint="give each a name in a manifest, or pass a folder above both as a pattern",
            )
