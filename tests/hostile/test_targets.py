"""Some hundred cases of the search, the same in every run; ``scripts/fuzz`` goes on with others."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from hostile.case import Case
from hostile.invariant import violations
from hostile.running import Harness
from hostile.seeds import Seeds
from hostile.targets import TARGETS

EXAMPLES = {"states": 15, "models": 15, "configurations": 12, "meshes": 6}
USUAL = 30
"""Cases of a target; those that track take longer, so they are fewer."""
SLACK = 3.0
"""Seconds of CPU are longer while other tests share a core."""


@pytest.mark.parametrize("target", TARGETS)
def test_no_input_breaks_the_invariant(target: str, harness: Harness, seeds: Seeds) -> None:
    @settings(
        max_examples=EXAMPLES.get(target, USUAL),
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(TARGETS[target](seeds))
    def attempt(case: Case) -> None:
        outcome = harness.run(case)
        broken = violations(case, outcome, slack=SLACK)
        assert not broken, f"{case!r}: {broken}\n{outcome.error.decode('utf-8', 'replace')[-3000:]}"

    attempt()
