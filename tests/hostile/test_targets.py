"""Some hundred cases of the search, the same in every run; ``scripts/fuzz`` goes on with others."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from hostile.case import Case
from hostile.invariant import violations
from hostile.running import Pool
from hostile.seeds import Seeds
from hostile.targets import TARGETS

EXAMPLES = {"states": 8, "models": 10, "configurations": 8, "meshes": 3, "detectors": 4}
USUAL = 16
"""Cases of a target; those that track take longer, so they are fewer."""
SLACK = 3.0
"""Seconds of CPU are longer while other tests share a core."""


@pytest.mark.parametrize("target", TARGETS)
def test_no_input_breaks_the_invariant(target: str, pool: Pool, seeds: Seeds) -> None:
    cases: list[Case] = []

    @settings(
        max_examples=EXAMPLES.get(target, USUAL),
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(TARGETS[target](seeds))
    def collect(case: Case) -> None:
        cases.append(case)

    collect()
    failures = []
    for case, outcome in zip(cases, pool.run(cases), strict=True):
        said = outcome.error.decode("utf-8", "replace")[-3000:]
        failures += [f"{case!r}: {line}\n{said}" for line in violations(case, outcome, slack=SLACK)]
    assert failures == []
