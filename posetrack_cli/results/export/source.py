"""What is exported: the estimates of one topic, with or without the frames that were lost."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import chain, islice

from posetrack_cli.errors import ResultError
from posetrack_cli.results.columns import Columns, empty_columns, joined
from posetrack_cli.results.estimate import Status
from posetrack_cli.results.reader import Result


@dataclass(frozen=True)
class ExportSource:
    """Estimates to export.

    Attributes:
        result: the file.
        topic: of the estimates, or of a truth of the same schema.
        lost: whether frames whose status is lost are in.
    """

    result: Result
    topic: str
    lost: bool = True

    def blocks(self, fields: Collection[str] | None = None) -> Iterator[Columns]:
        """Yield columns as ``Result.column_blocks`` does.

        Raises:
            ResultError: as there, or shape entries or points are not those of the result's subject.
        """
        for block in self.result.column_blocks(
            self.topic, {"status", "shape", "points", *(fields or self.result.field_names)}
        ):
            self._check(block)
            if self.lost:
                yield block
            else:
                kept = block["status"] != Status.LOST.value
                yield {name: column[kept] for name, column in block.items()}

    def columns(self) -> Columns:
        """Return all columns at once."""
        return joined(self.blocks()) or empty_columns(
            self.result.field_names, *self._counts, len(self.result.subject.number_names)
        )

    def begun_blocks(self, fields: Collection[str] | None = None) -> Iterator[Columns]:
        """Return ``blocks``, the first of them read: nothing is written yet if that fails."""
        blocks = self.blocks(fields)
        return chain(list(islice(blocks, 1)), blocks)

    @property
    def _counts(self) -> tuple[int, int]:
        return len(self.result.subject.shape_names), len(self.result.subject.point_names)

    def _check(self, block: Columns) -> None:
        found = block["shape"].shape[1], block["points"].shape[1]
        if found != self._counts:
            raise ResultError(
                "estimates of another subject",
                where=f"{self.result.path}, {self.topic}",
                found="{} shape entries and {} points".format(*found),
                expected="{} and {}".format(*self._counts),
            )


def export_source(result: Result, topic: str | None = None, *, lost: bool = True) -> ExportSource:
    """Return what to export of a result.

    Args:
        result: the file.
        topic: any topic of ``posetrack.Estimate``, such as a truth's; by default the result's own.
        lost: whether frames whose status is lost are in.

    Raises:
        ResultError: there is no such topic.
    """
    return ExportSource(result, result.topic_of_estimates(topic), lost)
