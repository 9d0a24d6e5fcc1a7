"""Which file holds messages, and what all of them give: schema, channel and message, as MCAP calls them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mcap.records import Channel, Schema

from posetrack_cli.bags.ros1_bag import Ros1Bag, is_ros1_bag
from posetrack_cli.bags.ros2 import Ros2Database, Ros2Folder, is_database, is_ros2_folder
from posetrack_cli.errors import RecordingError
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.stream import McapFile, McapItem, Topics, is_mcap


class MessageFile(Protocol):
    """A file or folder of messages, read as far as it can be."""

    @property
    def path(self) -> Path:
        """Where it is."""

    @property
    def losses(self) -> LossLog:
        """What could not be read so far."""

    def messages(self, topics: Topics = None) -> Iterator[McapItem]:
        """Yield schema, channel and message of all messages, or of those on some topics."""

    def counts(self) -> list[tuple[Schema | None, Channel, int]] | None:
        """Return every channel with the number of its messages; None where only reading all of it tells."""


@dataclass(frozen=True)
class Container:
    """A kind of such files.

    Attributes:
        kind: as run records and descriptions call it.
        words: as people do.
        holds: whether a path that exists is one.
        open: returns it; losses go to the log given.
    """

    kind: str
    words: str
    holds: Callable[[Path], bool]
    open: Callable[[Path, LossLog | None], MessageFile]


CONTAINERS = (
    Container("mcap", "MCAP", is_mcap, McapFile),
    Container("bag", "ROS 1 bag", is_ros1_bag, Ros1Bag),
    Container("db3", "ROS 2 database", is_database, Ros2Database),
)
"""All that are files."""
FOLDER = Container("ros2", "ROS 2 folder", is_ros2_folder, Ros2Folder)
"""Of files of these containers."""


def container_of(path: Path) -> Container | None:
    """Return what kind of messages a path holds, None for none.

    Raises:
        RecordingError: it cannot be read.
    """
    if path.is_dir():
        return FOLDER if FOLDER.holds(path) else None
    try:
        return next((container for container in CONTAINERS if container.holds(path)), None)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def required_container(path: Path) -> Container:
    """As ``container_of``, but that it holds none is an error.

    Raises:
        RecordingError: it cannot be read, or holds no messages.
    """
    container = container_of(path)
    if container is None:
        raise RecordingError("holds no messages", where=path, expected="MCAP, or a bag of ROS 1 or ROS 2")
    return container


def message_file(path: Path, losses: LossLog | None = None) -> MessageFile:
    """Open a file or folder of messages; what cannot be read goes to ``losses``, by default to nobody.

    Raises:
        RecordingError: it is none.
    """
    return required_container(path).open(path, losses)
