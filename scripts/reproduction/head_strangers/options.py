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
        left_out: folder of what was learned without each stranger, NAME-features.npz and NAME-model.npz; None
            tracks with what is shipped.
    """

    output: Path
    heads: Path
    tuned: Path | None = None
    only: Sequence[str] = ()
    left_out: Path | None = None

    def learned_without(self, person: Path) -> tuple[str, ...]:
        """Arguments of ``posetrack head mono``: what was learned without a person."""
        if self.left_out is None or person.parent != self.heads:
            return ()
        features = self.left_out / f"{person.name}-features.npz"
        model = self.left_out / f"{person.name}-model.npz"
        return ("--set", f"start.detection.features={features}", "--face-model", str(model))

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
