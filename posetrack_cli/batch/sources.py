"""Which recordings a batch is of: patterns, a list of names, or a manifest with options of each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field

from posetrack_cli import limits
from posetrack_cli.bags.ros2_folder import is_ros2_folder
from posetrack_cli.batch.manifest_files import reachable
from posetrack_cli.batch.patterns import MAGIC, Search
from posetrack_cli.configuration import Settings, validated
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_text
from posetrack_cli.text import one_line, parse_toml

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
