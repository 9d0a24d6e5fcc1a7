"""Databases and folders of ROS 2 that rosbags wrote; and databases that ask for more than their tables."""

from __future__ import annotations

import sqlite3
import time
from collections import Counter
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import Reader

from posetrack_cli import limits
from posetrack_cli.bags.message_file import container_of, message_file
from posetrack_cli.bags.ros2 import Ros2Database, Ros2Folder, parts_of
from posetrack_cli.errors import RecordingError
from support.bags import COLOUR, COUNT, DEPTH, START_NS, write_folder

TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
TOPIC = "INSERT INTO topics VALUES (1, '/value', 'std_msgs/msg/Float32', 'cdr')"
DATA = b"\0\1\0\0\0\0\x80\x3f"


def database(path: Path, *statements: str) -> Path:
    connection = sqlite3.connect(path)
    for statement in statements:
        connection.execute(statement)
    connection.commit()
    connection.close()
    return path


def with_messages(path: Path, *rows: tuple[object, object, object]) -> Path:
    connection = sqlite3.connect(database(path, TOPICS, MESSAGES, TOPIC))
    connection.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    connection.commit()
    connection.close()
    return path


@pytest.mark.parametrize(
    ("storage", "compression", "version"),
    [("sqlite3", "none", 9), ("sqlite3", "none", 8), ("sqlite3", "message", 9), ("mcap", "none", 9)],
)
def test_messages_are_those_that_rosbags_reads(
    tmp_path: Path, storage: str, compression: str, version: int
) -> None:
    path = write_folder(tmp_path / "r", storage, compression, version)
    with Reader(path) as reader:
        expected = sorted((c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages())
    folder = message_file(path)
    assert (container := container_of(path)) is not None and container.kind == "ros2"
    found = [(channel.topic, message.log_time, message.data) for _, channel, message in folder.messages()]
    assert sorted(found) == expected
    assert {c.topic: n for _, c, n in folder.counts() or ()} == Counter(topic for topic, _, _ in expected)
    assert folder.losses.losses == ()
    (part,) = parts_of(path)
    alone = message_file(part)
    assert [(c.topic, m.data) for _, c, m in alone.messages([DEPTH])] == [
        (topic, data) for topic, _, data in found if topic == DEPTH
    ]


def test_several_files_are_one_recording(tmp_path: Path) -> None:
    """Each file numbers its topics anew: here they are exchanged between the second and the others."""
    path = write_folder(tmp_path / "r", "sqlite3")
    (part,) = parts_of(path)
    names = [f"{part.stem.removesuffix('_0')}_{number}.db3" for number in (0, 2, 10)]
    data = part.read_bytes()
    part.unlink()
    for name in names:
        (path / name).write_bytes(data)
    second = sqlite3.connect(path / names[1])
    for old, new in ((3, 99), (4, 3), (99, 4)):
        second.execute("UPDATE topics SET id = ? WHERE id = ?", (new, old))
        second.execute(
            "UPDATE messages SET topic_id = ?, timestamp = timestamp + 1 WHERE topic_id = ?", (new, old)
        )
    second.commit()
    second.close()
    assert [one.name for one in parts_of(path)] == names
    folder = Ros2Folder(path)
    stamps = [message.log_time for _, channel, message in folder.messages([DEPTH])]
    assert len(stamps) == 3 * COUNT and stamps[COUNT] > START_NS == stamps[0] == stamps[2 * COUNT]
    numbers = {(channel.id, channel.topic) for _, channel, _ in folder.messages()}
    assert len(numbers) == 4 == len({number for number, _ in numbers})
    assert {c.topic: n for _, c, n in folder.counts() or ()}[COLOUR] == 3 * COUNT


def test_files_that_are_missing_or_none_are_told(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "r", "mcap")
    (part,) = parts_of(path)
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace(part.name, f"{part.name}\n  - r_1.mcap"))
    (path / "r_2.db3").write_bytes(b"no database")
    folder = Ros2Folder(path)
    assert len(list(folder.messages())) == 2 * COUNT + 2
    assert {loss.what: loss.first for loss in folder.losses.losses} == {
        "file of the recording is missing": "r_1.mcap",
        "file of the recording is neither MCAP nor SQLite": "r_2.db3",
    }


def test_a_folder_compressed_as_a_whole_says_what_to_do(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "r", "sqlite3", "file")
    with pytest.raises(
        RecordingError, match=r"\.zstd: file compression is not supported; unpack its files with zstd -d"
    ):
        message_file(path)


# What a database may ask for

ENDLESS = "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n FROM c) SELECT n"
ATTACKS = {
    "endless view": [
        TOPICS,
        TOPIC,
        f"CREATE VIEW messages AS {ENDLESS} AS topic_id, n AS timestamp, n AS data FROM c",
    ],
    "endless topics": [MESSAGES, f"CREATE VIEW topics AS {ENDLESS} AS id, n AS name FROM c"],
    "virtual table": [TOPICS, TOPIC, "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)"],
    "no tables": ["CREATE TABLE other(x)"],
}


@pytest.mark.parametrize("name", ATTACKS)
def test_only_stored_tables_are_read(tmp_path: Path, name: str) -> None:
    path = database(tmp_path / "r.db3", *ATTACKS[name])
    with pytest.raises(RecordingError, match=r"r\.db3: not a ROS 2 recording, found tables"):
        list(Ros2Database(path).messages())


@pytest.mark.parametrize(
    "expression", ["randomblob(9e8)", "load_extension('x')", "length(hex(zeroblob(6e7)))"]
)
def test_no_function_is_called(tmp_path: Path, expression: str) -> None:
    """A computed column of a stored table, of one row."""
    computed = MESSAGES.replace("data BLOB", "data AS (1)")
    row = "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1)"
    path = database(tmp_path / "r.db3", TOPICS, TOPIC, computed, row)
    writable = sqlite3.connect(path)
    writable.execute("PRAGMA writable_schema = ON")
    writable.execute("UPDATE sqlite_master SET sql = replace(sql, '(1)', ?)", (f"({expression})",))
    writable.commit()
    writable.close()
    with pytest.raises(RecordingError, match=r"(not a ROS 2 recording|readable database).*, found"):
        list(Ros2Database(path).messages())


def test_a_table_that_never_ends_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As pages that lead to each other again and again: no more steps than so many bytes can take."""
    path = with_messages(tmp_path / "r.db3", *[(2, k, b"") for k in range(50_000)], (1, 5, DATA))
    assert len(list(Ros2Database(path).messages())) == 1
    monkeypatch.setattr(limits, "SPARE_DATABASE_STEPS", 0)
    monkeypatch.setattr(limits, "DATABASE_STEPS_PER_BYTE", 0.01)
    reader = Ros2Database(path)
    assert list(reader.messages()) == []
    (loss,) = reader.losses.losses
    assert (loss.what, loss.first) == ("file is damaged, the rest is lost", "messages: interrupted")


def test_values_of_other_types_are_skipped_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bomb = zstandard.compress(bytes(2 << 20))
    rows = [
        (1, 1, DATA),
        (1, "x", DATA),
        (1, 3, None),
        (1, 4, 5.0),
        ("x", 5, DATA),
        (1, 6, bomb),
        (1, 7, DATA),
    ]
    monkeypatch.setattr(limits, "CHUNK_BYTES", 1 << 20)
    reader = Ros2Database(with_messages(tmp_path / "r.db3", *rows))
    assert [message.log_time for _, _, message in reader.messages()] == [1, 7]
    (loss,) = reader.losses.losses
    assert (loss.count, loss.first) == (4, "on /value")


def test_messages_whose_topic_is_no_number_are_counted(tmp_path: Path) -> None:
    """A column of text makes text of the topics' numbers, which SQLite still finds by number."""
    table = MESSAGES.replace("topic_id INTEGER", "topic_id TEXT")
    row = f"INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 5, x'{DATA.hex()}')"
    reader = Ros2Database(database(tmp_path / "r.db3", TOPICS, TOPIC, table, row))
    assert list(reader.messages()) == []
    (loss,) = reader.losses.losses
    assert (loss.count, loss.first) == (1, "of no topic")
    assert [count for _, _, count in reader.counts() or ()] == [0]


def test_a_definition_that_is_not_utf8_is_one_line(tmp_path: Path) -> None:
    """SQLite's error has the bytes in it, which Python's module decodes."""
    path = with_messages(tmp_path / "r.db3", (1, 1, DATA))
    path.write_bytes(path.read_bytes().replace(b"CREATE TABLE topics", b"CREATE \xff\xff\xff\xff\xff topics"))
    with pytest.raises(RecordingError, match=r"r\.db3: not a readable database, found 'utf-8' codec"):
        list(Ros2Database(path).messages())


@pytest.mark.parametrize("text", ["a" * 1_000_000, ".db3" * 250_000, "a.db3/" * 160_000, "a.mcap" * 160_000])
def test_metadata_takes_time_as_it_is_long(tmp_path: Path, text: str) -> None:
    """Half an hour, when each character began a search to the end of the word."""
    (tmp_path / "metadata.yaml").write_text(f"{text}\n- gone_1.db3\n")
    (tmp_path / "r_0.db3").write_bytes(b"")
    folder, began = Ros2Folder(tmp_path), time.process_time()
    assert list(folder.messages()) == []
    assert time.process_time() - began < 2.0
    missing = [loss for loss in folder.losses.losses if loss.what == "file of the recording is missing"]
    assert [(loss.count, loss.first) for loss in missing] == [(1, "gone_1.db3")]


def test_pages_that_are_damaged_end_the_reading(tmp_path: Path) -> None:
    path = with_messages(tmp_path / "r.db3", *[(1, k, bytes(500)) for k in range(400)])
    data = bytearray(path.read_bytes())
    data[100_000:140_000] = b"\xa5" * 40_000
    path.write_bytes(data)
    reader = Ros2Database(path)
    assert 0 < len(list(reader.messages())) < 400
    assert reader.losses.losses[0].what == "file is damaged, the rest is lost"


def test_nothing_is_written_beside_and_a_log_that_is_left_is_told(tmp_path: Path) -> None:
    path = with_messages(tmp_path / "r #?%.db3", (1, 1, DATA))
    (tmp_path / f"{path.name}-wal").write_bytes(b"rest")
    before = sorted(one.name for one in tmp_path.iterdir())
    reader = Ros2Database(path)
    assert len(list(reader.messages())) == 1
    assert reader.losses.losses[0].what.startswith(
        "the latest messages are in the write-ahead log of the database"
    )
    assert sorted(one.name for one in tmp_path.iterdir()) == before
