"""Many results made up, as rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.evaluation.judging.gates import GateOutcome
from posetrack_cli.evaluation.judging.rows import Baseline, GateReport, ResultSet, result_sets
from posetrack_cli.evaluation.measuring.catalogue import Address
from posetrack_cli.evaluation.measuring.evaluation import Evaluation, distribution, statistics
from posetrack_cli.evaluation.measuring.pooling import make_pools
from support.evaluation import hand_evaluation


class Before:
    """A baseline in which every figure was the same."""

    def __init__(self, value: float) -> None:
        self.value = value

    def figure(self, address: Address) -> float | None:
        return self.value


def result(name: str, error_mm: float, **changes: Any) -> Evaluation:
    """A result of a recording of its own with four frames, whose joint errors are about this large."""
    errors = error_mm * np.array([0.5, 0.75, 1.25, 1.5])
    summary = statistics(errors)
    made: dict[str, Any] = {
        "run": {"input.sha256": name},
        "metrics": {"coverage": 1.0, "frames": 4.0, "joint_error_mm": summary},
        "absent": {},
        "counts": {},
        "distributions": {"joint_error_mm": distribution(errors, summary)},
        "judged": None,
    }
    return hand_evaluation(name, 4, **{**made, **changes})


def many_results(count: int, different: int = 97) -> list[Evaluation]:
    """So many results, ``recording-0000`` and on; after every ``different`` of them only names differ.

    Their errors are 1 mm, 2 mm and so on.
    """
    made = [result(f"recording-{place:04d}", 1.0 + place) for place in range(min(count, different))]
    names = [f"recording-{place:04d}" for place in range(count)]
    return [
        replace(made[place % different], name=name, path=Path(f"{name}.mcap"), run={"input.sha256": name})
        for place, name in enumerate(names)
    ]


def result_set(
    members: Sequence[Evaluation],
    outcomes: Sequence[GateOutcome] = (),
    earlier: Mapping[str, Baseline] | None = None,
) -> ResultSet:
    """The set of results of one kind."""
    gates = GateReport(outcomes, earlier or {}, earlier is not None)
    (made,) = result_sets(members, make_pools(members, {}), gates)
    return made
