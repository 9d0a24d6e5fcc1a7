"""ROS 2 bags: .db3 databases, and folders with metadata.yaml."""

from __future__ import annotations

import os
import re
import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import zstandard
from mcap.records import Channel, Message, Schema

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError
from posetrack_cli.files import begins_with, read_text
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.decoding import NO_DEFINITION
from posetrack_cli.mcap.records import ExpansionBudget, bounded_content, check_size
from posetrack_cli.mcap.stream import DAMAGED, McapFile, McapItem, Topics, is_mcap, wanted_names

# ROS 2 recordings in SQLite (``.db3``)
#
# A hostile database can have endless views, computed columns, virtual tables and triggers. None of them is
# executed: only stored columns of stored tables are read, with a step limit derived from the file size.


MAGIC = b"SQLite format 3\0"
# Exceptions of damaged databases; Python's sqlite3 also fails to decode names and messages.
DAMAGE = (sqlite3.Error, zstandard.ZstdError, TypeError, ValueError, LookupError)
# Columns read from each table; older recordings lack the last table.
COLUMNS = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("topic_id", "timestamp", "data"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition"),
}
_READS = frozenset((table, column) for table, columns in COLUMNS.items() for column in columns)
_MASTER = ("type", "name", "rootpage")
_ALLOWED = frozenset({sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ})
# Pragma whose last value is not 0 for computed columns.
_COLUMNS_OF = "table_xinfo"
_STEPS = 1000  # steps between two calls of the progress handler
# First bytes of compressed messages; others begin with the zero of CDR's header.
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
WAL = "-wal"
UNREADABLE = "message skipped, invalid time, topic or size"
NOT_MERGED = "the latest messages are in the write-ahead log of the database, which is not read"


def is_database(path: Path) -> bool:
    """Return whether a file begins like an SQLite database.

    Raises:
        OSError: the file cannot be read.
    """
    return begins_with(path, MAGIC)


class Ros2Database:
    """A database, read as far as possible.

    Args:
        path: the file.
        losses: receives unreadable data.
    """

    def __init__(self, path: Path, losses: LossLog | None = None) -> None:
        self.path, self.losses = path, LossLog() if losses is None else losses

    def messages(self, topics: Topics = None) -> Iterator[McapItem]:
        """Yield schema, channel and message, of all or some topics, in stored order.

        Raises:
            RecordingError: the file is not a ROS 2 database, or messages expand beyond ``limits``.
        """
        wants = wanted_names(topics)
        with self._opened() as database:
            known = self._channels(database)
            wanted = {number: (s, c) for number, (s, c) in known.items() if wants(c.topic)}
            if not wanted:
                return
            budget = ExpansionBudget(self.path, self.path.stat().st_size)
            for number, stamp, data in self._rows(database, "messages", wanted):
                try:
                    message = _message(number, stamp, data, budget)
                    schema, channel = wanted[number]
                except DAMAGE:
                    where = f"on {wanted[number][1].topic}" if number in wanted else "of no topic"
                    self.losses.add(UNREADABLE, where)
                    continue
                yield schema, channel, message

    def counts(self) -> list[tuple[Schema | None, Channel, int]] | None:
        """Return every channel with its number of messages."""
        with self._opened() as database:
            known = self._channels(database)
            counted = Counter(row[0] for row in self._rows(database, "messages", (), ("topic_id",)))
        return [(schema, channel, counted[number]) for number, (schema, channel) in known.items()]

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        if not is_database(self.path):
            raise RecordingError("not an SQLite database", where=self.path)
        if _log_bytes(self.path):
            self.losses.add(NOT_MERGED, f"{self.path.name}{WAL}")
        # immutable: no journal, lock or log merge is written next to the file
        name = f"file:{quote(os.fsencode(self.path.absolute()))}?mode=ro&immutable=1"
        try:
            with closing(sqlite3.connect(name, uri=True, check_same_thread=False)) as database:
                _bound(database, self.path.stat().st_size)
                yield database
        except DAMAGE as error:
            what = "not a readable database"
            raise RecordingError(what, where=self.path, found=error) from error

    def _channels(self, database: sqlite3.Connection) -> dict[int, tuple[Schema, Channel]]:
        """Return schema and channel by topic number.

        Raises:
            RecordingError: the tables of ROS 2 are missing.
        """
        rows = self._rows(database, "sqlite_master", (), _MASTER)
        tables = {_text(row[1]) for row in rows if _is_stored(row)}
        stored = {table for table in COLUMNS if table in tables and not _computes(database, table)}
        if not {"topics", "messages"} <= stored:
            raise RecordingError(
                "not a ROS 2 recording",
                where=self.path,
                found=f"tables {', '.join(sorted(tables)) or 'none'}",
                expected="tables topics and messages without computed columns",
            )
        definitions: dict[str, tuple[str, bytes]] = {}
        if "message_definitions" in stored:
            for name, language, text in self._rows(database, "message_definitions"):
                definitions[_text(name)] = _text(language), text if isinstance(text, bytes) else b""
        known = {}
        for number, name, kind, serialised in self._rows(database, "topics"):
            if isinstance(number, int):
                language, text = definitions.get(_text(kind), (NO_DEFINITION, b""))
                schema = Schema(id=number, name=_text(kind), encoding=language, data=text)
                known[number] = schema, Channel(number, _text(name), _text(serialised), {}, number)
        return known

    def _rows(
        self,
        database: sqlite3.Connection,
        table: str,
        topics: Collection[int] = (),
        columns: Collection[str] | None = None,
    ) -> Iterator[tuple[Any, ...]]:
        """Yield columns of a table; damage in the messages table ends it with a loss.

        Args:
            database: open database.
            table: a stored table.
            topics: numbers of the wanted topics; empty for all.
            columns: by default those in ``COLUMNS``.
        """
        words = f"SELECT {', '.join(columns or COLUMNS[table])} FROM {table}"
        if topics:
            words += f" WHERE topic_id IN ({', '.join(str(number) for number in topics)})"
        try:
            yield from database.execute(words)
        except DAMAGE as error:
            if table != "messages":
                raise
            self.losses.add(DAMAGED, f"{table}: {error}")


def _bound(database: sqlite3.Connection, size: int) -> None:
    """Restrict a database to reading its tables, within a step limit."""
    left = (limits.SPARE_DATABASE_STEPS + limits.DATABASE_STEPS_PER_BYTE * size) // _STEPS

    def spent() -> int:
        nonlocal left
        left -= 1
        return left < 0

    database.text_factory = bytes
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limits.CHUNK_BYTES)
    database.execute("PRAGMA trusted_schema = OFF")
    database.set_progress_handler(spent, _STEPS)
    database.set_authorizer(_authorised)


def _authorised(
    action: int, table: str | None, column: str | None, name: str | None, view: str | None
) -> int:
    """Allow reading table columns and listing columns; deny functions, views and triggers."""
    if action == sqlite3.SQLITE_PRAGMA and table == _COLUMNS_OF:
        return sqlite3.SQLITE_OK
    if action not in _ALLOWED or view is not None:
        return sqlite3.SQLITE_DENY
    if action == sqlite3.SQLITE_READ and (table, column) not in _READS:
        of_master = table in ("sqlite_master", "sqlite_schema") and column in _MASTER
        return sqlite3.SQLITE_OK if of_master else sqlite3.SQLITE_DENY
    return sqlite3.SQLITE_OK


def _is_stored(row: tuple[Any, ...]) -> bool:
    """Return whether a row of the master table is a table with pages, not a view or virtual table."""
    kind, _, page = row
    return bool(kind == b"table" and isinstance(page, int) and page > 0)


def _computes(database: sqlite3.Connection, table: str) -> bool:
    """Return whether a table has computed columns, which may run arbitrary functions."""
    return any(row[-1] for row in database.execute(f"PRAGMA {_COLUMNS_OF}({table})"))


def _message(number: int, stamp: Any, data: Any, budget: ExpansionBudget) -> Message:
    if not isinstance(stamp, int) or not isinstance(data, bytes):
        raise TypeError("invalid time or data")
    budget.spend(len(data))
    if data.startswith(ZSTD_MAGIC):
        size = zstandard.frame_content_size(data)
        check_size(size)
        budget.spend(max(size, 0))
        data = bounded_content("zstd", data, size)
    return Message(number, stamp, data, stamp, 0)


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else ""


def _log_bytes(path: Path) -> int:
    """Return the size of a database's write-ahead log, bytes."""
    log = path.with_name(path.name + WAL)
    try:
        return log.stat().st_size
    except OSError:
        return 0


# ROS 2 bag folders: metadata.yaml, and a sequence of message files
METADATA = "metadata.yaml"
SUFFIXES = (".mcap", ".db3")
COMPRESSED = ".zstd"
MISSING = "file of the recording is missing"
OTHER = "file of the recording is neither MCAP nor SQLite"
METADATA_DAMAGE = (OSError, UnicodeDecodeError)  # ignored: metadata.yaml only serves to find missing files
# A file name of at most 255 characters, matched only at word starts so that the search stays linear.
_NAMED = re.compile(
    r"(?<![^\s/\\'\",\[\]])[^\s/\\'\",\[\]]{1,255}+"
    r"(?:(?<=\.mcap)|(?<=\.db3)|(?<=\.mcap\.zstd)|(?<=\.db3\.zstd))(?![/\\\[])"
)
_NUMBER = re.compile(r"(\d+)(?!.*\d)")


def is_ros2_folder(path: Path) -> bool:
    """Return whether a folder has metadata.yaml and message files."""
    return (path / METADATA).is_file() and any(_is_part(part) for part in path.iterdir())


def parts_of(path: Path) -> list[Path]:
    """Return the message files of a folder, sorted by number: NAME_0.mcap, NAME_1.mcap ..."""
    return sorted((part for part in path.iterdir() if _is_part(part)), key=_place)


class Ros2Folder:
    """A folder, read as far as possible: its files in sequence, whatever their format.

    metadata.yaml only serves to find missing files.

    Args:
        path: the folder.
        losses: receives unreadable data.

    Raises:
        RecordingError: files are compressed as a whole.
    """

    def __init__(self, path: Path, losses: LossLog | None = None) -> None:
        self.path, self.losses = path, LossLog() if losses is None else losses
        self._parts = parts_of(path)
        packed = next((part for part in self._parts if part.suffix == COMPRESSED), None)
        if packed is not None:
            hint = "unpack its files with zstd -d, or convert the bag with ros2 bag convert"
            raise RecordingError("file compression is not supported", where=packed, hint=hint)

    def messages(self, topics: Topics = None) -> Iterator[McapItem]:
        """Yield schema, channel and message, of all or some topics, file by file.

        Equal channels of different files are merged under new numbers.

        Raises:
            RecordingError: a file is not a recording, or expands beyond ``limits``.
        """
        self._report_missing()
        merged = _Channels()
        for part in self._files():
            for schema, channel, message in part.messages(topics):
                yield *merged.merged(schema, channel), message

    def counts(self) -> list[tuple[Schema | None, Channel, int]] | None:
        """Return every channel with its number of messages; None if a file has no index."""
        merged, counted = _Channels(), dict[int, tuple[Schema | None, Channel, int]]()
        for part in self._files():
            known = part.counts()
            if known is None:
                return None
            for schema, channel, count in known:
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

    def _report_missing(self) -> None:
        try:
            text = read_text(self.path / METADATA, limits.TEXT_BYTES)
        except METADATA_DAMAGE:
            return
        there = {part.name for part in self._parts}
        for name in dict.fromkeys(_NAMED.findall(text)):
            if name not in there:
                self.losses.add(MISSING, name)


class _Channels:
    """Channels of several files under common numbers, as each file has its own."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], tuple[Schema | None, Channel]] = {}

    def merged(self, schema: Schema | None, channel: Channel) -> tuple[Schema | None, Channel]:
        """Return schema and channel with common numbers."""
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
    """Return a sort key by the last number in the name; ROS counts from 0 without leading zeros."""
    found = _NUMBER.search(path.name.removesuffix(COMPRESSED).removesuffix(".db3").removesuffix(".mcap"))
    return (int(found.group(1)) if found else -1, path.name)
