"""Results and truth as they are drawn: which estimate belongs to a frame, its colour, its words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.evaluation.measuring.pose_metrics import distances
from posetrack_cli.evaluation.reading.tracks import (
    Track,
    associate,
    nearest_rows,
    track_of_result,
    unique_names,
)
from posetrack_cli.evaluation.reading.truth import load_truth
from posetrack_cli.evaluation.viewing.drawing import (
    FOUND_ANEW,
    LOST,
    SKIN,
    TONES,
    Canvas,
    Colour,
    Drawer,
    Segments,
    Shown,
    widest,
)
from posetrack_cli.evaluation.viewing.frame_choice import chosen_rows
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.channels import FILTERED
from posetrack_cli.results.reader import Result
from posetrack_cli.units import NS_PER_S

TOLERANCE_NS = 5_000_000
"""How far apart the stamps of a frame and of an estimate of it may be."""


CONFIDENCE_WORDS, ERROR_WORDS = "confidence {:.2f}", "error {:.1f} mm"
STATUS_WORDS = ("tracking", "reinitialised", "LOST", "NO ESTIMATE")
TRUTH_WORDS = "truth green"
MOST_OF_NAME = 41
MOST_RESULTS = len(TONES)
MOST_IN_SHEET = 120
SHEET_CHOICE = "spread:6"
USUAL_RATE_HZ = 30.0


@dataclass(frozen=True, eq=False)
class DrawnTrack:
    """One track as it is drawn.

    Attributes:
        track: its poses.
        drawer: draws them.
        colour: of what has none of its own.
        name: what captions call it; empty where there is only one.
        error_mm: (N,) mean distance of the points from the truth, NaN where there is none.
        segments: tells the subject's pixels from others; None where that is not drawn.
    """

    track: Track
    drawer: Drawer
    colour: Colour = SKIN
    name: str = ""
    error_mm: FloatArray | None = None
    segments: Segments | None = None

    def row(self, stamp_ns: int) -> int | None:
        """The row of the estimate whose stamp is nearest within the tolerance; None without one."""
        stamps = self.track.stamp_ns
        if not stamps.size:
            return None
        row = int(nearest_rows(np.array([stamp_ns]), stamps)[0])
        return row if abs(int(stamps[row]) - stamp_ns) <= TOLERANCE_NS else None

    @property
    def longest_words(self) -> list[str]:
        """The words of a caption that take the most room, see ``DrawnEstimate.words``."""
        words = [_shortened(self.name)] if self.name else []
        words.append(widest(STATUS_WORDS))
        words += [] if self.track.confidence is None else [CONFIDENCE_WORDS.format(1.0)]
        errors = np.empty(0) if self.error_mm is None else self.error_mm[np.isfinite(self.error_mm)]
        return [*words, *([ERROR_WORDS.format(errors.max())] if errors.size else [])]

    def at(self, stamp_ns: int) -> DrawnEstimate:
        """What is drawn at a stamp; nothing where there is no estimate."""
        row = self.row(stamp_ns)
        return DrawnEstimate(self, row, Shown() if row is None else Shown.of_row(self.track, row))


@dataclass(frozen=True, eq=False)
class DrawnEstimate:
    """What is drawn of a track at one instant.

    Attributes:
        of: the track.
        row: of its estimate, None without one.
        shown: of the estimate, in the axes of the camera that it is drawn for.
    """

    of: DrawnTrack
    row: int | None
    shown: Shown

    @property
    def status(self) -> str:
        """``tracking``, ``lost``, ``reinitialised`` or ``no estimate``."""
        return "no estimate" if self.row is None else self.of.track.status(self.row).value

    @property
    def mark(self) -> Colour | None:
        """The colour that marks a frame which is not simply tracked; None for one that is."""
        return {"tracking": None, "reinitialised": FOUND_ANEW}.get(self.status, LOST)

    @property
    def words(self) -> list[str]:
        """What a caption says of the estimate."""
        words = [_shortened(self.of.name)] if self.of.name else []
        words.append(self.status.upper() if self.status in ("lost", "no estimate") else self.status)
        if self.row is not None:
            words += _figure(self.of.track.confidence, self.row, CONFIDENCE_WORDS)
            words += _figure(self.of.error_mm, self.row, ERROR_WORDS)
        return words

    def draw(self, canvas: Canvas) -> None:
        """Paint it in the track's colour."""
        self.of.drawer.draw(canvas, self.shown, self.of.colour)

    def outline(self, canvas: Canvas, colour: Colour) -> None:
        """Paint it as lines."""
        self.of.drawer.outline(canvas, self.shown, colour)


def _shortened(name: str) -> str:
    """A name that leaves room for what is said of it: its beginning and end."""
    if len(name) <= MOST_OF_NAME:
        return name
    half = (MOST_OF_NAME - 3) // 2
    return f"{name[:half]}...{name[-half:]}"


def _figure(values: FloatArray | None, row: int, words: str) -> list[str]:
    return [] if values is None or not np.isfinite(values[row]) else [words.format(float(values[row]))]


@dataclass(frozen=True, eq=False)
class Instant:
    """What is drawn of one frame.

    Attributes:
        frame: what the cameras saw.
        when: what a caption says of the time, and of the truth's colour.
        estimates: of each track.
        truth: drawn over them, None for none.
    """

    frame: Frame
    when: list[str]
    estimates: tuple[DrawnEstimate, ...]
    truth: DrawnEstimate | None

    @property
    def points(self) -> FloatArray | None:
        """(P, 3) mm that its picture is cut out around, where the part that is shown moves."""
        return self.estimates[0].shown.points


def point_errors(track: Track, truth: Track | None) -> FloatArray | None:
    """Mean distance (N,) of the points of each frame from the truth's, mm; NaN without truth at its stamp.

    Of the positions where either knows no points, or they are others; None where there is no such truth.
    """
    if truth is None:
        return None
    for own, true in ((track.points, truth.points), (track.position, truth.position)):
        if own is not None and true is not None and own.shape[1:] == true.shape[1:]:
            errors = np.full(len(track), np.nan)
            pairs = associate(track.stamp_ns, truth.stamp_ns, TOLERANCE_NS)
            apart = distances(own[pairs.estimate], true[pairs.truth])
            errors[pairs.estimate] = apart.reshape(len(apart), -1).mean(axis=1)
            return errors
    return None


@dataclass(frozen=True)
class ViewOptions:
    """How results are drawn.

    Attributes:
        frames: see ``chosen_rows``; None for all, or for six of a sheet.
        layout: one of ``LAYOUTS``; None for beside, or side-by-side for two results.
        crop: ``full``, or ``hand`` or ``head`` for where it goes; None for full, or hand in the layout paper.
        scale: picture pixels per image pixel; None enlarges small images.
        range_mm: depths that are red and blue; None takes them from the hand's.
        truth: whether the truth is drawn.
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


@dataclass(frozen=True, eq=False)
class Drawing:
    """What pictures show.

    Attributes:
        tracks: of results; captions count the time from the first one's first frame.
        truth: drawn over them, None for none.
        around: (N, P, 3) mm, in the axes of the first camera, that pictures are cut out around; None for all
            of the image.
        scale: picture pixels per image pixel; None enlarges small pictures.
        still: whether all pictures show the same part.
        shrunk: factor on the size of pictures whose scale is not told.
    """

    tracks: tuple[DrawnTrack, ...]
    truth: DrawnTrack | None
    around: FloatArray | None = None
    scale: float | None = None
    still: bool = True
    shrunk: float = 1.0

    @property
    def start_ns(self) -> int:
        """The stamp that captions count the time from."""
        return int(self.tracks[0].track.stamp_ns[0])

    @property
    def longest_when(self) -> list[str]:
        """The words of a caption about the time that take the most room."""
        track = self.tracks[0].track
        if not len(track):
            return []
        last = len(track) - 1 if track.frame_index is None else int(track.frame_index.max())
        return self._when(last, int(track.stamp_ns[-1]))

    def _when(self, index: int, stamp_ns: int) -> list[str]:
        words = [f"frame {index}", f"{(stamp_ns - self.start_ns) / NS_PER_S:.3f} s"]
        return words if self.truth is None else [*words, TRUTH_WORDS]

    def at(self, frame: Frame, stamp_ns: int) -> Instant:
        """Return what is drawn of a frame, given the stamp of its estimates."""
        return Instant(
            frame,
            self._when(frame.index, stamp_ns),
            tuple(drawn.at(stamp_ns) for drawn in self.tracks),
            None if self.truth is None else self.truth.at(stamp_ns),
        )


def truth_of(result: Result, options: ViewOptions) -> Track | None:
    """The truth that a result carries; one that cannot be used is an error only where it is to be drawn."""
    try:
        truth = load_truth(result, None)
    except PosetrackError:
        if options.truth:
            raise
        return None
    if truth is None and options.truth:
        raise ResultError("carries no truth to draw", where=result.path, hint="leave out --show-truth")
    return truth


def drawn_tracks(
    results: Sequence[Result],
    tracks: Sequence[str],
    truth: Track | None,
    drawer_of: Callable[[Result], Drawer],
) -> tuple[DrawnTrack, ...]:
    """Return what is drawn of results: each of these tracks, by the drawer of its result."""
    names = unique_names([result.path for result in results])
    shown = [
        (result, which, name if len(tracks) == 1 else f"{name} {which}")
        for result, name in zip(results, names, strict=True)
        for which in tracks
    ]
    drawn = []
    for (result, which, name), tone in zip(shown, TONES, strict=False):
        track = track_of_result(result, name, which)
        shown_name = name if len(shown) > 1 else ""
        drawn.append(DrawnTrack(track, drawer_of(result), tone, shown_name, point_errors(track, truth)))
    return tuple(drawn)


def rows_to_draw(options: ViewOptions, first: DrawnTrack) -> IntArray:
    """The rows to draw, of the first result."""
    choice = options.frames or (SHEET_CHOICE if options.sheet else "all")
    rows = chosen_rows(choice, first.track, first.error_mm)
    if options.sheet and len(rows) > MOST_IN_SHEET:
        expected = f"at most {MOST_IN_SHEET} in one picture"
        raise UsageError("too many frames", found=len(rows), expected=expected, hint="choose with --select")
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
