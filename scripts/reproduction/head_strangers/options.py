"""What the study is asked for, and what its parts have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from reproduction import running
from reproduction.head_strangers.measuring import Measured
from reproduction.heads.people import persons_in
from reproduction.steps import Chain


@dataclass(frozen=True)
class Options:
    """How much is done.

    Attributes:
        output: folder of everything.
        heads: folder of recordings of strangers: left, right, calibration.json and truth.csv each.
        tuned: folder of such recordings on which the defaults were tuned; None leaves them out.
        only: names of those that are tracked; empty for all.
    """

    output: Path
    heads: Path
    tuned: Path | None = None
    only: Sequence[str] = ()

    @property
    def strangers(self) -> list[Path]:
        """Folders of the people whom nothing was tuned on."""
        return self._chosen(self.heads)

    @property
    def familiar(self) -> list[Path]:
        """Folders of the people on whom the defaults were tuned."""
        return [] if self.tuned is None else self._chosen(self.tuned)

    @property
    def everybody(self) -> list[Path]:
        """Folders of all."""
        return [*self.strangers, *self.familiar]

    def _chosen(self, folder: Path) -> list[Path]:
        return [one for one in persons_in(folder) if not self.only or one.name in self.only]


class Part(running.Part[Options, Measured], Protocol):
    """One part of the study: what has to be made, and what it says about it."""

    def chains(self, options: Options) -> list[Chain]:
        """What has to be made."""
