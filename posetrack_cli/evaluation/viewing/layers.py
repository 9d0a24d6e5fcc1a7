"""Content of pictures: estimates and ground truth of a frame, with colours and captions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.evaluation.measuring.pose_metrics import distances
from posetrack_cli.evaluation.reading.identities import identities
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
    TOGETHER,
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
from posetrack_cli.results.reader import Result
from posetrack_cli.results.topics import FILTERED
from posetrack_cli.units import NS_PER_S

TOLERANCE_NS = 5_000_000
"""Maximum difference between the stamps of a frame and its estimate."""


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
    """A track with its drawing style.

    Attributes:
        track: the track.
        drawer: draws its estimates.
        colour: default colour.
        name: name in captions; empty if there is only one track.
        error_mm: (N,) mean distance of the points from the ground truth, mm; NaN without ground truth.
        segments: segmentation to draw; None for none.
    """

    track: Track
    drawer: Drawer
    colour: Colour = SKIN
    name: str = ""
    error_mm: FloatArray | None = None
    segments: Segments | None = None

    def row(self, stamp_ns: int) -> int | None:
        """Return the row of the estimate nearest in time within ``TOLERANCE_NS``; None without one."""
        stamps = self.track.stamp_ns
        if not stamps.size:  # nearest_rows requires at least one stamp
            return None
        row = int(nearest_rows(np.array([stamp_ns]), stamps)[0])
        return row if abs(int(stamps[row]) - stamp_ns) <= TOLERANCE_NS else None

    @property
    def longest_words(self) -> list[str]:
        """The widest words that captions can have; see ``DrawnEstimate.words``."""
        words = [_shortened(self.name)] if self.name else []
        words.append(widest(STATUS_WORDS))
        words += [] if self.track.confidence is None else [CONFIDENCE_WORDS.format(1.0)]
        errors = np.empty(0) if self.error_mm is None else self.error_mm[np.isfinite(self.error_mm)]
        return [*words, *([ERROR_WORDS.format(errors.max())] if errors.size else [])]

    def at(self, stamp_ns: int) -> DrawnEstimate:
        """Return the estimate at a stamp, which is empty if there is none."""
        row = self.row(stamp_ns)
        return DrawnEstimate(self, row, Shown() if row is None else Shown.of_row(self.track, row))


@dataclass(frozen=True, eq=False)
class DrawnEstimate:
    """Estimate of a track at one instant.

    Attributes:
        of: the track.
        row: row of the estimate; None without one.
        shown: the estimate in the axes of the camera that it is drawn for.
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
        """Colour of the border of frames that are lost or reinitialised; None for other frames."""
        # Frames without an estimate are marked like lost ones.
        return {"tracking": None, "reinitialised": FOUND_ANEW}.get(self.status, LOST)

    @property
    def words(self) -> list[str]:
        """Words of the caption about the estimate."""
        words = [_shortened(self.of.name)] if self.of.name else []
        words.append(self.status.upper() if self.status in ("lost", "no estimate") else self.status)
        if self.row is not None:
            words += _figure(self.of.track.confidence, self.row, CONFIDENCE_WORDS)
            words += _figure(self.of.error_mm, self.row, ERROR_WORDS)
        return words

    def draw(self, canvas: Canvas) -> None:
        """Draw the estimate in the colour of the track."""
        self.of.drawer.draw(canvas, self.shown, self.of.colour)

    def outline(self, canvas: Canvas, colour: Colour) -> None:
        """Draw the estimate as lines."""
        self.of.drawer.outline(canvas, self.shown, colour)


def _shortened(name: str) -> str:
    """Abbreviate a long name in the middle."""
    if len(name) <= MOST_OF_NAME:
        return name
    half = (MOST_OF_NAME - 3) // 2  # 3 for the ellipsis
    return f"{name[:half]}...{name[-half:]}"


def _figure(values: FloatArray | None, row: int, words: str) -> list[str]:
    return [] if values is None or not np.isfinite(values[row]) else [words.format(float(values[row]))]


@dataclass(frozen=True, eq=False)
class Instant:
    """Content of the picture of one frame.

    Attributes:
        frame: the recorded frame.
        when: words of the caption about frame number, time and colour of the ground truth.
        estimates: estimate of each track.
        truths: ground truth, drawn on top.
    """

    frame: Frame
    when: list[str]
    estimates: tuple[DrawnEstimate, ...]
    truths: tuple[DrawnEstimate, ...]
    is_together: bool = False

    @property
    def points(self) -> FloatArray | None:
        """Points (P, 3), mm, that the picture is cropped around if the viewport moves."""
        if not self.is_together:
            return self.estimates[0].shown.points
        known = [one.shown.points for one in self.estimates if one.shown.points is not None]
        return np.concatenate(known) if known else None


def point_errors(track: Track, truth: Track | None) -> FloatArray | None:
    """Return the mean distance (N,) of the points from the ground truth, mm; NaN in frames without it.

    If the points are unknown or different, the positions are compared; None if that is not possible either.
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
    """Options of a view.

    Attributes:
        frames: selection of frames, see ``chosen_rows``; None for all, or six for a sheet.
        layout: one of ``DEPTH_LAYOUTS``; None for ``beside``, or ``side-by-side`` for two results.
        crop: ``full``, or ``hand`` or ``head`` to crop around the track; None for ``full``, except in the
            layout ``paper``.
        scale: picture pixels per image pixel; None enlarges small images.
        range_mm: depths drawn red and blue, mm; None for a range around the hand.
        truth: draw the ground truth.
        skeleton: draw joints, bones and axes.
        sheet: draw all frames onto one picture, each cropped around the hand.
        tracks: tracks of each result; several tracks are drawn like several results.
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
    """Content of a sequence of pictures.

    Attributes:
        tracks: tracks to draw; times in captions are relative to the first frame of the first track.
        truths: ground truth, drawn on top.
        around: (N, P, 3) points that the pictures are cropped around, mm, in the axes of the first camera;
            None for the whole image.
        scale: picture pixels per image pixel; None enlarges small pictures.
        still: whether all pictures show the same part of the image.
        shrunk: additional factor on the size if ``scale`` is None.
        is_together: whether the tracks are those of several subjects, drawn into one picture.
    """

    tracks: tuple[DrawnTrack, ...]
    truths: tuple[DrawnTrack, ...]
    around: FloatArray | None = None
    scale: float | None = None
    still: bool = True
    shrunk: float = 1.0
    is_together: bool = False

    @property
    def start_ns(self) -> int:
        """Stamp of time 0 in captions, ns."""
        return int(self.tracks[0].track.stamp_ns[0])

    @property
    def longest_when(self) -> list[str]:
        """The widest words that captions can have about frame number and time."""
        track = self.tracks[0].track
        if not len(track):
            return []
        last = len(track) - 1 if track.frame_index is None else int(track.frame_index.max())
        return self._when(last, int(track.stamp_ns[-1]))

    def _when(self, index: int, stamp_ns: int) -> list[str]:
        words = [f"frame {index}", f"{(stamp_ns - self.start_ns) / NS_PER_S:.3f} s"]
        return [*words, TRUTH_WORDS] if self.truths else words

    def at(self, frame: Frame, stamp_ns: int) -> Instant:
        """Return the content of the picture of a frame, given the stamp of its estimates."""
        return Instant(
            frame,
            self._when(frame.index, stamp_ns),
            tuple(drawn.at(stamp_ns) for drawn in self.tracks),
            tuple(truth.at(stamp_ns) for truth in self.truths),
            self.is_together,
        )


def truths_of(whole: Result, labels: Sequence[str], options: ViewOptions) -> list[Track | None]:
    """Return the ground truth in a result; if it is unusable, raise an error only if it is to be drawn.

    Args:
        whole: result with all its subjects.
        labels: labels of the subjects to draw.
        options: view options.
    """
    try:
        known = identities(whole, None)
        of = {} if known is None else {label: one.truth for label, one in known.of.items()}
        truths = [
            None
            if known is not None and of[label] is None
            else load_truth(whole.of(label), label=of.get(label))
            for label in labels
        ]
    except PosetrackError:
        if options.truth:
            raise
        return [None] * len(labels)
    if options.truth and not any(truth is not None for truth in truths):
        raise ResultError("no ground truth in the result", where=whole.path, hint="omit --show-truth")
    return truths


def is_together(results: Sequence[Result]) -> bool:
    """Whether the results are parts of one file, which are drawn into one picture."""
    labels = {(result.path, result.subject.label) for result in results}
    return len(results) > 1 and len(labels) == len(results) and len({path for path, _ in labels}) == 1


def drawn_tracks(
    results: Sequence[Result],
    tracks: Sequence[str],
    truths: Sequence[Track | None],
    drawer_of: Callable[[Result], Drawer],
) -> tuple[DrawnTrack, ...]:
    """Return these tracks of all results with their drawers, colours and names.

    Args:
        results: results of one subject each.
        tracks: names of the tracks.
        truths: ground truth of each result; the last one also of the others.
        drawer_of: returns the drawer of a result.
    """
    together = is_together(results)
    paths = [result.path for result in results]
    names = [result.subject.label for result in results] if together else unique_names(paths)
    of_result = [truths[min(k, len(truths) - 1)] for k in range(len(results))]
    tones = [TOGETHER[k % len(TOGETHER)] for k in range(len(results))] if together else TONES
    shown = [
        (result, which, name if len(tracks) == 1 else f"{name} {which}", truth)
        for result, name, truth in zip(results, names, of_result, strict=True)
        for which in tracks
    ]
    drawn = []
    for (result, which, name, truth), tone in zip(shown, tones, strict=False):  # the layout checks the number
        track = track_of_result(result, name, which)
        shown_name = name if len(shown) > 1 else ""
        drawn.append(DrawnTrack(track, drawer_of(result), tone, shown_name, point_errors(track, truth)))
    return tuple(drawn)


def rows_to_draw(options: ViewOptions, first: DrawnTrack) -> IntArray:
    """Return the rows of the first track to draw."""
    choice = options.frames or (SHEET_CHOICE if options.sheet else "all")
    rows = chosen_rows(choice, first.track, first.error_mm)
    if options.sheet and len(rows) > MOST_IN_SHEET:
        expected = f"at most {MOST_IN_SHEET} in one picture"
        raise UsageError("too many frames", found=len(rows), expected=expected, hint="use --select")
    return rows


def not_lost(track: Track, rows: IntArray) -> IntArray:
    """Return the rows that are not lost, or all rows if all are lost."""
    if track.lost is None or track.lost[rows].all():
        return rows
    return rows[~track.lost[rows]]


def rate_of(track: Track, rows: IntArray) -> float:
    """Return the frame rate of some rows for playback in real time, Hz."""
    # The median ignores gaps between selected ranges.
    steps = np.diff(track.stamp_ns[rows])
    return NS_PER_S / float(np.median(steps)) if steps.size else USUAL_RATE_HZ
