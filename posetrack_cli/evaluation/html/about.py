"""What the page says about itself: what was left out to keep it small, and how numbers are stored."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from posetrack_cli import __version__
from posetrack_cli.evaluation.html.markup import details, listed, text
from posetrack_cli.geometry.euler import EULER_ORDER

MOST_LISTED = 4
"""How many results are described without being asked for."""


def plot_remark(data: Mapping[str, Any]) -> str:
    """Say how many frames the lines over time hold, where they do not hold all."""
    return _left_out(data, [(one, one["quantities"].values()) for one in data["results"]])


def component_remark(data: Mapping[str, Any]) -> str:
    """The same of the trajectories."""
    return _left_out(data, [(one, one["components"]) for one in data["results"]])


def about(data: Mapping[str, Any]) -> str:
    """Return what made the page and how its data are reduced and stored."""
    results = [_of_result(result) for result in data["results"]]
    lines = [
        f"Written by posetrack {text(__version__)}. Everything is in this file; it loads nothing.",
        "Tables are made from all frames, plots and the 3-D view from these; lines hold 32-bit numbers.",
        "What the page holds of each result: "
        + (listed(results) if len(results) <= MOST_LISTED else details("show", listed(results))),
        f"Times are stored in steps of {data['tickSeconds'] * 1e3:.3g} ms. {_origins(data)}",
        f"Euler angles: {text(EULER_ORDER)}; of a head, the turn away from looking at the camera.",
    ]
    return listed(lines)


def _left_out(data: Mapping[str, Any], lines: Iterable[tuple[Mapping[str, Any], Iterable[Any]]]) -> str:
    """One sentence if any line of any result holds fewer points than there are frames."""
    reduced = [
        (result["frames"], max(one["points"] for one in of))
        for result, of in ((result, list(of)) for result, of in lines)
        if of and min(one["points"] for one in of) < result["frames"]
    ]
    if not reduced:
        return ""
    frames, points = max(reduced)
    return (
        f"To keep the page small a line shows at most {points} of {frames} frames: in every interval those "
        "with the smallest and the largest value, so that no peak is lost."
    )


def _of_result(result: Mapping[str, Any]) -> str:
    """How much of one result the page holds."""
    lines = [one["points"] for one in (*result["quantities"].values(), *result["components"])]
    scene = result["scene"]
    parts = [f"{result['frames']} frames"]
    if lines:
        parts.append(f"lines of {_between(lines)} points")
    if scene is not None:
        every = "" if scene["every"] == 1 else f", one in {scene['every']} and the worst ones"
        parts.append(f"3-D view of {scene['points']} frames{every}, in steps of {scene['stepMm']:.2g} mm")
    return f"<bdi>{text(result['name'])}</bdi>: {', '.join(parts)}."


def _between(counts: list[int]) -> str:
    low, high = min(counts), max(counts)
    return str(low) if low == high else f"{low} to {high}"


def _origins(data: Mapping[str, Any]) -> str:
    if len(data["results"]) < 2:
        return "Time 0 is the result's first frame."
    if data["sharedTime"]:
        return "Time 0 is the first frame of all results."
    return "The results share no time: time 0 is each one's own first frame."
