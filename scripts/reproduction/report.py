"""The report: our figures beside what the paper says. Every number in it is measured in the same run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.evaluation.association import associate
from posetrack_cli.results import load_arrays
from reproduction.analysis import Comparison, Figures, adjusted, verdict
from reproduction.figures import TRUTH, Component

SAID = {
    "A": "For small changes without velocity both methods give nearly right estimates for some parts of "
    "the hand (left); other parts neither follows well (right). The methods do not differ visibly (7.2.1, "
    "figure 6).",
    "B": "Hardly different from A: some components are followed, others are not, and the methods do not "
    "differ visibly (7.2.2, figure 7).",
    "real": "Both methods follow slow motion of the hand and of the fingers, but not accurately; they do not "
    "differ much. The cost does not look at how far the image regions agree, which may be why (7.3, figures "
    "8 and 9).",
    "time": "The time per frame of the two methods hardly differs although the state has twice as many "
    "dimensions; a frame takes longer than the sensor's interval (7.4, figure 10).",
    "conclusion": "No evidence that velocity makes tracking more accurate, at almost no additional cost; the "
    "cost function may be the reason (8).",
}
"""The paper's statements, in our words."""

RELIABILITY_ROWS: tuple[tuple[str, str, Callable[[Any], Any], str], ...] = (
    ("coverage, mean", "coverage", np.mean, ".3f"),
    ("NEES, median over recordings (21 is consistent)", "nees", np.median, ".0f"),
    ("truth inside 90 % intervals, mean share", "inside_90", np.mean, ".2f"),
)


def quoted(key: str) -> Iterator[str]:
    """The paper's statement as a block quote."""
    yield f"> **Paper:** {SAID[key]}"
    yield ""


def component_errors(
    rows: Mapping[str, Mapping[str, Path]], components: Sequence[Component]
) -> Iterator[str]:
    """A table: root mean square error of the components that a figure shows."""
    titles = [f"{title}, {kind.upper()}" for title, results in rows.items() for kind in results]
    yield f"| RMS error | {' | '.join(titles)} |"
    yield "|---|" + "---|" * len(titles)
    for component in components:
        errors = [_rms(path, component) for results in rows.values() for path in results.values()]
        yield f"| {component.label} | " + " | ".join(f"{error:.1f}" for error in errors) + " |"
    yield ""


def _rms(path: Path, component: Component) -> float:
    estimate, truth = load_arrays(path), load_arrays(path, TRUTH)
    pairs = associate(estimate["stamp_ns"], truth["stamp_ns"], tolerance_ns=0)
    errors = component.of(estimate)[pairs.estimate] - component.of(truth)[pairs.truth]
    return float(np.sqrt(np.mean(errors**2)))


def time_table(particles: Sequence[int], milliseconds: Mapping[str, Sequence[float]]) -> Iterator[str]:
    """A table: milliseconds per frame, and their ratio."""
    pf, rbpf = milliseconds["pf"], milliseconds["rbpf"]
    yield "| particles | " + " | ".join(str(n) for n in particles) + " |"
    yield "|---|" + "---|" * len(particles)
    yield "| PF, ms | " + " | ".join(f"{value:.1f}" for value in pf) + " |"
    yield "| RBPF, ms | " + " | ".join(f"{value:.1f}" for value in rbpf) + " |"
    yield "| RBPF / PF | " + " | ".join(f"{b / a:.2f}" for a, b in zip(pf, rbpf, strict=True)) + " |"
    yield ""


def reliability_table(measured: Mapping[tuple[str, str], Figures], entrants: Sequence[str]) -> Iterator[str]:
    """A table: how far each entrant kept track, and whether the truth lies inside its stated covariance."""
    yield "| over all recordings | " + " | ".join(entrants) + " |"
    yield "|---|" + "---|" * len(entrants)
    for title, metric, summary, digits in RELIABILITY_ROWS:
        values = [[m[metric] for (_, name), m in measured.items() if name == entrant] for entrant in entrants]
        shown = [format(float(summary(own)), digits) if own else "-" for own in values]
        yield f"| {title} | {' | '.join(shown)} |"
    yield ""


def study_table(comparisons: Sequence[Comparison], unit: str) -> Iterator[str]:
    """A table: a row per condition and pair of entrants."""
    yield (
        f"| motion | speed | first | second | n | first, {unit} | second, {unit} "
        "| difference [95 % interval] | p (Wilcoxon) | p adjusted | |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for comparison, p_value in zip(comparisons, adjusted(comparisons), strict=True):
        said, condition = comparison.summary, comparison.condition
        sd = comparison.values.std(axis=0, ddof=1) if said.count > 1 else np.full(2, np.nan)
        yield (
            f"| {condition.motion} | {condition.speed:g} | {comparison.first} | {comparison.second} "
            f"| {said.count} | {said.mean_first:.1f} ± {sd[0]:.1f} | {said.mean_second:.1f} ± {sd[1]:.1f} "
            f"| {said.difference:+.1f} [{said.low:+.1f}, {said.high:+.1f}] | {said.p_value:.2g} "
            f"| {p_value:.2g} | {verdict(comparison, p_value)} |"
        )
    yield ""
