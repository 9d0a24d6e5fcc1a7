"""Containers of messages, with MCAP's schema, channel and message as the common interface."""

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
    """A file or folder of messages, read as far as possible."""

    @property
    def path(self) -> Path:
        """Path of the file or folder."""

    @property
    def losses(self) -> LossLog:
        """Unreadable data met by the passes made."""

    def messages(self, topics: Topics = None) -> Iterator[McapItem]:
        """Yield schema, channel and message of all messages, or of those on some topics."""

    def counts(self) -> list[tuple[Schema | None, Channel, int]] | None:
        """Return every channel with its number of messages; None if that requires reading the file."""


@dataclass(frozen=True)
class Container:
    """A kind of container.

    Attributes:
        kind: its name in run records and descriptions.
        words: its name as text.
        holds: returns whether an existing path is of this kind.
        open: returns the container; losses go to the given log.
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
FOLDER = Container("ros2", "ROS 2 folder", is_ros2_folder, Ros2Folder)


def container_of(path: Path) -> Container | None:
    """Return the kind of container at a path, None if it is not one.

    Raises:
        RecordingError: the path cannot be read.
    """
    if path.is_dir():
        return FOLDER if FOLDER.holds(path) else None
    try:
        return next((container for container in CONTAINERS if container.holds(path)), None)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def required_container(path: Path) -> Container:
    """Return the kind of container at a path, as ``container_of`` does.

    Raises:
        RecordingError: the path cannot be read, or is not a container.
    """
    container = container_of(path)
    if container is None:
        raise RecordingError("not a file of messages", where=path, expected="MCAP, or a ROS 1 or ROS 2 bag")
    return container


def message_file(path: Path, losses: LossLog | None = None) -> MessageFile:
    """Open a file or folder of messages; unreadable data go to ``losses`` if given.

    Raises:
        RecordingError: the path is not a container.
    """
    return required_container(path).open(path, losses)
