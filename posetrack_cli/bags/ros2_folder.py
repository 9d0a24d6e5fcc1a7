"""Folders that ROS 2 records into: metadata.yaml, and one file of messages after the other."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mcap.records import Channel, Schema

from posetrack_cli import limits
from posetrack_cli.bags.ros2_database import Ros2Database, is_database
from posetrack_cli.errors import RecordingError
from posetrack_cli.files import read_text
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.stream import McapFile, McapItem, Topics, is_mcap

METADATA = "metadata.yaml"
SUFFIXES = (".mcap", ".db3")
COMPRESSED = ".zstd"
MISSING = "file of the recording is missing"
OTHER = "file of the recording is neither MCAP nor SQLite"
DAMAGE = (OSError, UnicodeDecodeError)
"""Errors of metadata.yaml, which is not needed."""
_NAMED = re.compile(
    r"(?<![^\s/\\'\",\[\]])[^\s/\\'\",\[\]]{1,255}+"
    r"(?:(?<=\.mcap)|(?<=\.db3)|(?<=\.mcap\.zstd)|(?<=\.db3\.zstd))(?![/\\\[])"
)
"""A name of at most 255 characters, tried only where a word begins: a text takes time as it is long."""
_NUMBER = re.compile(r"(\d+)(?!.*\d)")


def is_ros2_folder(path: Path) -> bool:
    """Whether a folder holds metadata.yaml and files of messages."""
    return (path / METADATA).is_file() and any(_is_part(part) for part in path.iterdir())


def parts_of(path: Path) -> list[Path]:
    """Return the files of messages in a folder, by their numbers: NAME_0.mcap, NAME_1.mcap ..."""
    return sorted((part for part in path.iterdir() if _is_part(part)), key=_place)


class Ros2Folder:
    """A folder to be read, as far as it can be: its files one after the other, whatever their format.

    Of metadata.yaml only the names of files are taken, to tell which are missing.

    Args:
        path: the folder.
        losses: gets what cannot be read; by default nobody is told.

    Raises:
        RecordingError: files are compressed as a whole.
    """

    def __init__(self, path: Path, losses: LossLog | None = None) -> None:
        self.path, self.losses = path, LossLog() if losses is None else losses
        self._parts = parts_of(path)
        packed = next((part for part in self._parts if part.suffix == COMPRESSED), None)
        if packed is not None:
            hint = "unpack its files with zstd -d first, or convert it with ros2 bag convert"
            raise RecordingError("is compressed as a whole", where=packed, hint=hint)

    def messages(self, topics: Topics = None) -> Iterator[McapItem]:
        """Yield schema, channel and message of all messages, or of those on some topics, file by file.

        Channels of the files that are alike are one, by numbers of its own.

        Raises:
            RecordingError: a file is no recording, or larger than any when decompressed.
        """
        self._tell_missing()
        merged = _Channels()
        for part in self._files():
            for schema, channel, message in part.messages(topics):
                yield *merged.merged(schema, channel), message

    def counts(self) -> list[tuple[Schema | None, Channel, int]] | None:
        """Return every channel with the number of its messages; None where a file does not tell."""
        merged, counted = _Channels(), dict[int, tuple[Schema | None, Channel, int]]()
        for part in self._files():
            told = part.counts()
            if told is None:
                return None
            for schema, channel, count in told:
                own_schema, own = merged.merged(schema, channel)
                before = counted[own.id][2] if own.id in counted else 0
                counted[own.id] = own_schema, own, before + count
        return list(counted.values())

    def _files(self) -> Iterator[McapFile | Ros2Database]:
        for part in self._parts:
            try:
                if is_mcap(part):
                    yield McapFile(part, self.losses)
                elif is_database(part):
                    yield Ros2Database(part, self.losses)
                else:
                    self.losses.add(OTHER, part.name)
            except OSError as error:
                raise RecordingError("cannot be read", where=part, found=error.strerror or error) from error

    def _tell_missing(self) -> None:
        try:
            text = read_text(self.path / METADATA, limits.TEXT_BYTES)
        except DAMAGE:
            return
        there = {part.name for part in self._parts}
        for name in dict.fromkeys(_NAMED.findall(text)):
            if name not in there:
                self.losses.add(MISSING, name)


class _Channels:
    """Channels of several files under numbers of their own: each file has its own."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], tuple[Schema | None, Channel]] = {}

    def merged(self, schema: Schema | None, channel: Channel) -> tuple[Schema | None, Channel]:
        """Return schema and channel as those of all files."""
        of_schema = None if schema is None else (schema.name, schema.encoding, schema.data)
        key = (channel.topic, channel.message_encoding, of_schema)
        if key not in self._known:
            number = len(self._known)
            own = None if schema is None else replace(schema, id=number + 1)
            self._known[key] = own, replace(channel, id=number, schema_id=number + 1 if own else 0)
        return self._known[key]


def _is_part(path: Path) -> bool:
    return path.name.removesuffix(COMPRESSED).endswith(SUFFIXES)


def _place(path: Path) -> tuple[int, str]:
    """By the last number in the name; ROS counts from 0 without leading zeros."""
    found = _NUMBER.search(path.name.removesuffix(COMPRESSED).removesuffix(".db3").removesuffix(".mcap"))
    return (int(found.group(1)) if found else -1, path.name)
