"""Recordings of a batch, given as paths, glob patterns, lists or manifests."""

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
from typing import Any, TypeAlias

from pydantic import Field

from posetrack_cli import limits
from posetrack_cli.bags.ros2 import is_ros2_folder
from posetrack_cli.batch.remote import find, is_url
from posetrack_cli.configuration import Settings, validated
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_text, real_path
from posetrack_cli.text import one_line, parse_toml

# Glob patterns. The search is bounded, as an untrusted list may contain the pattern ``/**``.


MAGIC = "*?["
"""Characters that make a name a pattern."""
_ANY_DEPTH = "**"


class Search:
    """Glob search of one batch, bounded by ``limits.SEARCH_ENTRIES`` files and folders in total."""

    def __init__(self) -> None:
        self._left = limits.SEARCH_ENTRIES

    def matches(self, pattern: Path) -> list[Path]:
        """Return the sorted paths that match, like a recursive ``glob.glob``.

        Unlike there, ``**`` visits each folder once, even if several symbolic links lead to it, so that
        cyclic links end.

        Raises:
            UsageError: the pattern has too many parts or visits too many files.
        """
        try:
            found = set(self._expanded("", pattern.parts))
        except RecursionError:
            raise UsageError("pattern has too many parts", where=pattern) from None
        except _TooMuchError:
            raise UsageError(
                "pattern visits too many files and folders",
                where=pattern,
                expected=f"at most {limits.SEARCH_ENTRIES}",
                hint="start it with the folder of the recordings",
            ) from None
        return [Path(one) for one in sorted(found)]

    def _expanded(self, base: str, parts: Sequence[str]) -> Iterator[str]:
        """Yield the paths below a folder that match the parts of a pattern."""
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
            path = os.path.join(base, part)  # noqa: PTH118 strings are faster than Path here and below
            if os.path.isdir(path) if rest else os.path.lexists(path):  # noqa: PTH112
                yield from self._expanded(path, rest)

    def _folders_below(self, base: str) -> Iterator[str]:
        """Yield a folder and all folders below it, each once."""
        # Symbolic links are visited last, so that a folder reached both ways is reported by its real path.
        folders, links, seen = [base], deque[str](), set[tuple[int, int]]()
        while folders or links:
            folder = folders.pop() if folders else links.popleft()
            try:
                state = os.stat(folder or os.curdir)  # noqa: PTH116
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
        """Yield the entries of a folder with their paths; none if the folder cannot be read."""
        self._count()
        try:
            with os.scandir(folder or os.curdir) as entries:
                for entry in entries:
                    self._count()
                    yield os.path.join(folder, entry.name), entry  # noqa: PTH118
        except (OSError, ValueError):
            return

    def _count(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise _TooMuchError


class _TooMuchError(Exception):
    """The search has reached its limit."""


def _is_hidden(entry: os.DirEntry[str], part: str) -> bool:
    return entry.name.startswith(".") and not part.startswith(".")


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # cyclic symbolic link
        return False


# Files named by options of a manifest. Models and configurations must be inside the manifest's folder, so
# that an untrusted manifest cannot make the tracker read other files.


_CONFIGURATION, _ASSIGNMENT = "config", "set"
_MODELS = ("detector-model", "face-model", "hand-mesh", "load-model", "person", "shape")


def resolved_option(manifest: Path, option: str, value: Any) -> Any:
    """Return the value of an option, with file names relative to the manifest resolved.

    Raises:
        UsageError: the value names a model or a configuration outside the manifest's folder.
    """
    if isinstance(value, list):
        return [resolved_option(manifest, option, one) for one in value]
    if not isinstance(value, str) or not value:
        return value
    path = manifest.parent / value
    value = str(path) if path.exists() else value
    for file in _files_read_by(option, value):
        if file.is_file() and not real_path(file).is_relative_to(real_path(manifest.parent)):
            raise UsageError(
                f"option '{option}' refers to a file outside the manifest's folder",
                where=manifest,
                found=file,
                hint="copy the file into that folder, or pass the option to posetrack batch",
            )
    return value


def _files_read_by(option: str, value: str) -> Iterator[Path]:
    """Yield the files that an option makes the tracker read, including those named in a configuration."""
    if option in _MODELS or option == _CONFIGURATION:
        yield Path(value)
    with suppress(OSError, ValueError):  # an invalid configuration is reported when the tracker reads it
        if option == _CONFIGURATION:
            texts = _strings(parse_toml(read_text(Path(value), limits.TEXT_BYTES)))
            yield from (Path(value).parent / text for text in texts)
        elif option == _ASSIGNMENT:
            text = value.partition("=")[2].strip()
            yield Path(text)
            yield from map(Path, _strings(parse_toml(f"value = {text}")))


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _strings(one)


# Recordings from paths and patterns, lists and manifests


_LIST_ENDINGS = (".txt", ".list")


@dataclass(frozen=True)
class Source:
    """A recording of a batch.

    Attributes:
        path: file or folder.
        name: path of its result relative to the results folder, without extension.
        options: command options by long name without dashes; strings, numbers, true for flags, or lists.
        truth: ground-truth file for its result.
        gates: gates for its result.
        person: whom it shows; recordings of one person share the shape of the hand or face. Empty if unknown.
        manifest: manifest that lists the recording; None if it was given otherwise.
        url: of a remote recording, whose ``path`` is its file name; empty for a local one.
    """

    path: Path
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    truth: Path | None = None
    gates: tuple[str, ...] = ()
    person: str = ""
    manifest: Path | None = None
    url: str = ""


class ManifestRecording(Settings):
    """A table ``[[recordings]]`` of a manifest.

    Attributes:
        path: file, folder or pattern, relative to the manifest.
        name: name of the result; defaults to the name of the recording. Invalid for several recordings.
        options: command options.
        truth: ground-truth file, relative to the manifest; defaults to ground truth in the recording.
        gates: gates for the result.
        person: whom it shows; its first recordings determine the shape of the hand or face for the others.
    """

    path: str
    name: str | None = None
    options: dict[str, bool | int | float | str | list[str]] = Field(default_factory=dict)
    truth: str | None = None
    gates: tuple[str, ...] = ()
    person: str = ""


class Manifest(Settings):
    """A manifest: a TOML file that lists recordings and their options.

    Attributes:
        options: command options for all recordings; a recording's own options take precedence.
        gates: gates for all recordings, in addition to their own.
        recordings: one table per recording or pattern.
    """

    options: dict[str, bool | int | float | str | list[str]] = Field(default_factory=dict)
    gates: tuple[str, ...] = ()
    recordings: tuple[ManifestRecording, ...]


def find_sources(given: Sequence[str], results: Path | None = None, *, remote: bool = False) -> list[Source]:
    """Return the recordings of a batch.

    Args:
        given: paths of recordings, glob patterns (``**`` matches folders recursively), lists (``.txt``, one
            path or pattern per line), manifests (``.toml``) or URLs.
        results: results folder; patterns do not match files in it.
        remote: accept URLs also in lists and manifests, which may come from others.

    Raises:
        UsageError: no recording is found, a list or manifest is invalid, or result names collide.
    """
    scope = _SearchScope(Search(), results, remote)
    found = [source for one in given for source in _sources_of(one, scope)]
    _check_names(found)
    return found


@dataclass(frozen=True)
class _SearchScope:
    """Search state shared by all arguments of a batch."""

    search: Search
    results: Path | None
    remote: bool


def _sources_of(given: str, scope: _SearchScope) -> list[Source]:
    if is_url(given):
        return [_source(*one) for one in _remote(given, given)]
    path = Path(given)
    if path.suffix == ".toml":
        return _read_manifest(path, scope)
    if path.suffix in _LIST_ENDINGS and not path.is_dir():
        return _read_list(path, scope)
    return [_source(*one) for one in _matching(given, None, scope)]


_Found: TypeAlias = tuple[Path, str, str]  # path, name and URL of a recording


def _source(path: Path, name: str, url: str) -> Source:
    return Source(path, name, url=url)


def _remote(url: str, where: object) -> list[_Found]:
    return [(Path(one.file), _checked_name(where, one.name), one.url) for one in find(url)]


def _matching(pattern: str, base: Path | None, scope: _SearchScope) -> list[_Found]:
    """Return the recordings that match a path or pattern, named relative to its part without wildcards."""
    if is_url(pattern):
        if not scope.remote:
            hint = "--remote reads them; only do so for lists that you trust"
            raise UsageError("URL in a list or manifest", where=base, found=pattern, hint=hint)
        return _remote(pattern, base)
    path = Path(pattern) if base is None else base / pattern
    if not any(sign in pattern for sign in MAGIC) or path.exists():
        if not path.exists():
            raise UsageError("no such recording", where=path)
        return [(path, _plain_name(path), "")]
    fixed = _fixed_part(path)
    found = scope.search.matches(path)
    whole = {one for one in found if is_ros2_folder(one)}
    above = {folder for one in found for folder in one.parents}
    recordings = [
        one
        for one in found
        if one != fixed and _is_recording(one, above, whole) and not _is_in(one, scope.results)
    ]
    if not recordings:
        raise UsageError(
            "no matching recording", where=path, hint="quote the pattern so that the shell does not expand it"
        )
    return [(one, str(one.relative_to(fixed).with_suffix("")), "") for one in recordings]


def _fixed_part(pattern: Path) -> Path:
    """Return the leading folders without wildcards."""
    parts: list[str] = []
    for part in pattern.parts[:-1]:
        if any(sign in part for sign in MAGIC):
            break
        parts.append(part)
    return Path(*parts)


def _is_recording(path: Path, above: Set[Path], whole: Set[Path]) -> bool:
    """Whether a matched path is a recording rather than a folder of recordings or a part of one.

    Args:
        path: matched path; ``**`` also matches folders.
        above: all parents of matched paths.
        whole: matched folders that are one recording each (ROS 2 bags).
    """
    if path in whole or not whole.isdisjoint(path.parents):
        return path in whole
    return path not in above or not path.is_dir()


def _is_in(path: Path, folder: Path | None) -> bool:
    return folder is not None and folder.resolve() in (path.resolve(), *path.resolve().parents)


def _plain_name(path: Path) -> str:
    name = path.resolve().name if path.name in ("", "..") else path.name
    return Path(name).stem if path.is_file() else name


def _read_list(path: Path, scope: _SearchScope) -> list[Source]:
    """Read a list with one path or pattern per line, relative to the list; ``#`` starts a comment."""
    lines = [line.partition("#")[0].strip() for line in _read(path).splitlines()]
    found = [_source(*one) for line in lines if line for one in _matching(line, path.parent, scope)]
    if not found:
        raise UsageError("list is empty", where=path, expected="one path or pattern per line")
    return found


def _read_manifest(path: Path, scope: _SearchScope) -> list[Source]:
    try:
        values = parse_toml(_read(path))
    except ValueError as error:
        raise UsageError("not a TOML file", where=path, found=error) from error
    manifest = validated(Manifest, values, path)
    if not manifest.recordings:
        raise UsageError("manifest lists no recording", where=path, expected="[[recordings]] tables")
    return [source for one in manifest.recordings for source in _manifest_sources(path, manifest, one, scope)]


def _manifest_sources(
    path: Path, manifest: Manifest, one: ManifestRecording, scope: _SearchScope
) -> Iterable[Source]:
    found = _matching(one.path, path.parent, scope)
    if one.name is not None and len(found) > 1:
        raise UsageError(f"name '{one.name}' is given to several recordings", where=path, found=one.path)
    truth = None if one.truth is None else path.parent / one.truth
    if truth is not None and not truth.exists():
        raise UsageError("no such ground-truth file", where=path, found=one.truth)
    given = {**manifest.options, **one.options}
    options = {key: resolved_option(path, key, value) for key, value in given.items()}
    gates = (*manifest.gates, *one.gates)
    for recording, name, url in found:
        place = _checked_name(path, one.name or name)
        yield Source(recording, place, options, truth, gates, one.person, path, url)


def _checked_name(path: object, name: str) -> str:
    """Return the normalised name; raise an error if it would lead out of the results folder."""
    parts = Path(name).parts
    if not parts or Path(name).is_absolute() or ".." in parts:
        raise UsageError(
            "invalid result name", where=path, found=repr(name), expected="a relative path without '..'"
        )
    return str(Path(name))


def _read(path: Path) -> str:
    try:
        return read_text(path, limits.TEXT_BYTES)
    except OSError as error:
        raise UsageError("cannot be read", where=path, found=error.strerror or error) from error
    except UnicodeDecodeError as error:
        raise UsageError("not a UTF-8 text file", where=path, found=error) from error


def _check_names(sources: Sequence[Source]) -> None:
    """Raise an error if two recordings would write the same result file."""
    first: dict[str, Source] = {}
    for source in sources:
        # Job names are printable, so names that differ only in control characters also collide.
        other = first.setdefault(one_line(source.name), source)
        if other is not source:
            raise UsageError(
                f"two recordings have the same result name, {source.name}.mcap",
                found=f"{other.url or other.path} and {source.url or source.path}",
                hint="set names in a manifest, or use a pattern that starts at a common parent folder",
            )
