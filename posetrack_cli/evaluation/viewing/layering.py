"""Which results, frames and truth are drawn: what pictures of hands and of heads have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import IntArray
from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.evaluation.result_names import unique_names
from posetrack_cli.evaluation.track import Track, track_of_result
from posetrack_cli.evaluation.truth.loading import load_truth
from posetrack_cli.evaluation.viewing.colours import TONES
from posetrack_cli.evaluation.viewing.drawing import Drawer
from posetrack_cli.evaluation.viewing.frame_choice import chosen_rows
from posetrack_cli.evaluation.viewing.layers import Layer, point_errors
from posetrack_cli.results.reader import Result
from posetrack_cli.results.tracks import FILTERED
from posetrack_cli.units import NS_PER_S

MOST_RESULTS = len(TONES)
MOST_IN_SHEET = 120
SHEET_CHOICE = "spread:6"
USUAL_RATE_HZ = 30.0


@dataclass(frozen=True)
class ViewOptions:
    """How results are drawn.

    Attributes:
        frames: see ``chosen_rows``; None for all, or for six of a sheet.
        layout: one of ``LAYOUTS``; None for beside, or side-by-side for two results.
        crop: ``full``, or ``hand`` or ``head`` for where it goes; None for full, or hand in the layout paper.
        scale: picture pixels per image pixel; None enlarges small images.
        range_mm: depths that are red and blue; None takes them from the hand's.
        truth: whether the truth's contour is drawn.
        skeleton: whether joints, bones and axes are drawn.
        sheet: whether all pictures go onto one, each cut out around the hand by itself.
        tracks: of each result; both tracks of one result are drawn beside each other.
    """

    frames: str | None = None
    layout: str | None = None
    crop: str | None = None
    scale: float | None = None
    range_mm: tuple[float, float] | None = None
    truth: bool = False
    skeleton: bool = False
    sheet: bool = False
    tracks: tuple[str, ...] = (FILTERED,)


def truth_of(result: Result, options: ViewOptions) -> Track | None:
    """The truth that a result carries; one that cannot be used is an error only where it is to be drawn."""
    try:
        truth = load_truth(result, None)
    except PosetrackError:
        if options.truth:
            raise
        return None
    if truth is None and options.truth:
        raise ResultError("carries no truth to draw", where=result.path, hint="leave out --truth")
    return truth


def layers_of(
    results: Sequence[Result],
    tracks: Sequence[str],
    truth: Track | None,
    drawer_of: Callable[[Result], Drawer],
) -> tuple[Layer, ...]:
    """Return what is drawn of results: each of these tracks, by the drawer of its result."""
    names = unique_names([result.path for result in results])
    shown = [
        (result, which, name if len(tracks) == 1 else f"{name} {which}")
        for result, name in zip(results, names, strict=True)
        for which in tracks
    ]
    layers = []
    for (result, which, name), tone in zip(shown, TONES, strict=False):
        track = track_of_result(result, name, which)
        shown_name = name if len(shown) > 1 else ""
        layers.append(Layer(track, drawer_of(result), tone, shown_name, point_errors(track, truth)))
    return tuple(layers)


def rows_to_draw(options: ViewOptions, layer: Layer) -> IntArray:
    """The rows to draw, of the first result."""
    choice = options.frames or (SHEET_CHOICE if options.sheet else "all")
    rows = chosen_rows(choice, layer.track, layer.error_mm)
    if options.sheet and len(rows) > MOST_IN_SHEET:
        expected = f"at most {MOST_IN_SHEET} in one picture"
        raise UsageError("too many frames", found=len(rows), expected=expected, hint="choose with --frames")
    return rows


def not_lost(track: Track, rows: IntArray) -> IntArray:
    """The rows that are tracked; all where none is."""
    if track.lost is None or track.lost[rows].all():
        return rows
    return rows[~track.lost[rows]]


def rate_of(track: Track, rows: IntArray) -> float:
    """Pictures per second that show some rows as fast as they were recorded."""
    steps = np.diff(track.stamp_ns[rows])
    return NS_PER_S / float(np.median(steps)) if steps.size else USUAL_RATE_HZ
