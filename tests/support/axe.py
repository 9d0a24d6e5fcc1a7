"""What axe-core finds on a page that a browser shows."""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any

import pytest

SERIOUS = ("serious", "critical")
RUN = """
const [within, without, done] = arguments;
axe.run({include: [within], exclude: without.map((one) => [one])}, {resultTypes: ["violations"]}).then(
  ({violations}) => done(violations.flatMap((one) => one.nodes.map((node) =>
    [one.impact, one.id, node.target.join(" "), node.failureSummary]))),
  (error) => done([["critical", "axe-core", String(error), ""]]));
"""
"""Every place that a rule finds fault with: how bad, which rule, where, what to do."""


@cache
def axe_source() -> str:
    """axe-core's script; skips the test where the package with it is not installed."""
    pytest.importorskip("axe_core_python", reason="axe-core-python is not installed")
    return resources.files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")


def serious_violations(driver: Any, within: str = "html", without: tuple[str, ...] = ()) -> list[str]:
    """Return what axe-core calls serious or critical, one line for each place.

    Args:
        driver: shows the page, whose security policy does not apply to what a debugger runs.
        within: selector of the part that is looked at.
        without: selectors of parts of it that are not.
    """
    driver.execute_cdp_cmd("Runtime.evaluate", {"expression": axe_source()})
    found = driver.execute_async_script(RUN, within, list(without))
    return [" ".join(map(str, one)) for one in found if one[0] in SERIOUS]
