"""Detection of side, size and shape of the hand before a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, islice, product, takewhile

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.both import PairFinder, common_side, shape_of_both
from posetrack_cli.hand.config import BOTH, ONE_OF_TWO, SIDES, HandConfig, HandSettings
from posetrack_cli.hand.evidence import DepthEvidence
from posetrack_cli.hand.fit.gauss_newton import STIFF_THUMB
from posetrack_cli.hand.fit.likelihood import fits_frames
from posetrack_cli.hand.keypoints.file import KeypointFile
from posetrack_cli.hand.keypoints.hands import KeypointSide, keypoint_candidates
from posetrack_cli.hand.model.hand import hand_maker
from posetrack_cli.hand.observe.detection import Detection
from posetrack_cli.hand.search import Acquisition, quick_search
from posetrack_cli.hand.shape_fit import (
    Calibration,
    CalibrationOptions,
    length_probability,
    length_warning,
    measures_of,
    shape_of,
)
from posetrack_cli.phases import Advance, phase
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.depth import unit_mm_of
from posetrack_cli.recording.recording import Recording

# Side from the estimated shapes, where the average hand leaves it open

# The frames of a shape count as this many independent ones **[ours]**: they share the shape's error.
_SHAPE_FRAMES = 4.0
# Weight of the shapes' log prior ratio **[ours]**: of two hands that fit alike, the unusual one is wrong in
# eight of nine recordings of quickly closing hands. At 1 a good fit of an unusual hand would not count.
_SHAPE_PRIOR = 0.4


@dataclass(frozen=True)
class SideEstimate:
    """The detected side.

    Attributes:
        side: ``right`` or ``left``.
        log_odds: of that side against the other; infinite if only one was possible.
        found: its shape, if estimated.
    """

    side: str
    log_odds: float
    found: Calibration | None

    @property
    def probability(self) -> float:
        """Return the probability of the side."""
        return float(1.0 / (1.0 + np.exp(-self.log_odds)))

    @property
    def is_sure(self) -> bool:
        """Return whether the side is certain."""
        return self.log_odds >= CLEAR_LOG_ODDS


def decide_side(search: SideAndScaleSearch, estimate: Callable[[str], Calibration | None]) -> SideEstimate:
    """Return the likelier side and its shape.

    A pointing hand or a fist of average shape fits either side at about the same cost; with the shape
    adjusted to the frames the true side costs less. Both shapes are estimated if the search left the side
    open, or decided it with hands of a wrong size.

    Args:
        search: evidence of the frames for side and size.
        estimate: returns the shape of a side's hand; None if too few frames show it.
    """
    shapes = {search.side: estimate(search.side)}
    if len(search.sides) == 1 or (search.is_sure_of_side and not _is_restarted_at_other_size(search, shapes)):
        return SideEstimate(search.side, abs(search.log_odds), shapes[search.side])
    shapes |= {side: estimate(side) for side in search.sides if side not in shapes}
    first, second = search.sides
    one, other = shapes[first], shapes[second]
    log_odds = search.keypoint_log_odds if _is_restarted_at_other_size(search, shapes) else search.log_odds
    if one is not None and other is not None:
        log_odds += _SHAPE_FRAMES * _mean_log_odds(one, other)
        log_odds += _SHAPE_PRIOR * (other.unlikeliness - one.unlikeliness)
    elif _is_restarted_at_other_size(search, shapes):
        log_odds += MAX_PER_FRAME * ((one is not None) - (other is not None))
    return SideEstimate(first, log_odds, one) if log_odds >= 0.0 else SideEstimate(second, -log_odds, other)


def _mean_log_odds(one: Calibration, other: Calibration) -> float:
    """Return the mean log odds of the first shape's side over the frames that show both; 0 without one.

    Frame by frame: medians over frames may belong to different frames, and with one misplaced shape they
    differ by 2 mm where the frames do not differ.
    """
    common = one.frame_costs.keys() & other.frame_costs.keys()
    odds = [side_log_odds(one.frame_costs[k], other.frame_costs[k]) for k in sorted(common)]
    return float(np.mean(odds)) if odds else 0.0


def _is_restarted_at_other_size(search: SideAndScaleSearch, shapes: Mapping[str, Calibration | None]) -> bool:
    """Return whether a shape was started from another size than the search's best."""
    return any(one is not None and one.begun_scale != search.scale(side) for side, one in shapes.items())


# Side and size from the first seconds

NS_PER_S = 10**9
EARLY_S = 10.0
FRAME_STRIDE = 12  # neighbouring frames have correlated errors
MAX_FRAMES = 16

# Log odds of a side from its cost difference, and their bound per frame **[ours]**: with the average hand the
# true side is the cheaper one in four of five frames. Above the usual cost a difference means less.
_COST_PER_LOG_ODD_MM, MAX_PER_FRAME = 0.9, 3.0
_USUAL_COST_MM = 6.0
CLEAR_LOG_ODDS = 4.0  # probability .98

# The configured hand itself fits at 1-2 mm, other people's at 3 mm and more. One frame of it may decide
# the side.
KNOWN_HAND_MM = 2.2

_SCALE_RATIO, _SCALE_STEPS = 1.16, range(-5, 6)  # 0.48 to 2.1 of the configured size
_FAR_SIZES_ABOVE_MM = 8.0  # above this cost also far sizes are tried: costs between need not be monotonic
_FAR_STEPS = (-4, -3, -2, 2, 3, 4)
_FRAMES_FOR_SIZE = 3
_SAME_SIZE_MM, _SAME_SIZE = 4.0, 0.03  # cost, and relative difference, at which the configured size is kept

# Prior of the log size above and below the average adult: few men are much larger, children are smaller. It
# counters the bias to large hands, which also cover the sensor's blur. The bound allows for depth in a wrong
# unit.
_SIZE_SD, _MAX_SIZE_PENALTY_MM = (0.12, 0.15), 2.5

_HOPELESS_MM = 4.0  # a side this much worse is not tried in other sizes
_OPEN_MM = 10.0  # a size is tried until its costs sum up to this much more than the cheapest's
# A hand this much worse after a rough fit decides nothing. Rough costs exceed full ones by as much as half.
_FAR_WORSE, _FAR_WORSE_MM = 1.5, 3.0


def search_early_frames(
    recording: Recording,
    config: HandConfig,
    start: int,
    sides: Sequence[str],
    keypoints: KeypointFile | None = None,
) -> SideAndScaleSearch:
    """Search the first seconds of a run for side and size, until the frames agree.

    Args:
        recording: depth frames.
        config: of hand and search.
        start: first frame.
        sides: candidates.
        keypoints: from another program.

    Raises:
        UsageError: the configured mesh is not a usable hand.
    """
    search = SideAndScaleSearch(
        config, recording.cameras[0], sides, keypoints, has_sizes=is_size_unknown(config)
    )
    return _add_frames(search, early_frames(recording, start))


def search_recording(
    recording: Recording, config: HandConfig, start: int, sides: Sequence[str]
) -> SideAndScaleSearch:
    """Search the whole recording for side and size, whatever is configured.

    A short sequence of separate images is used completely, until the images agree; a hand may appear late.

    Raises:
        RecordingError: unreadable image.
        UsageError: the configured mesh is not a usable hand.
    """
    count = recording.frame_count
    stride = FRAME_STRIDE if count is None else min(max((count - start) // MAX_FRAMES, 1), FRAME_STRIDE)
    search = SideAndScaleSearch(config, recording.cameras[0], sides, has_sizes=True)
    return _add_frames(search, recording.frames(start=start, end=None, stride=stride))


def _add_frames(search: SideAndScaleSearch, frames: Iterator[Frame]) -> SideAndScaleSearch:
    """Add frames to a search until they agree."""
    with phase("detecting side and size", "search") as advance:
        for frame in frames:
            search.add_frame(frame, advance)
            if search.is_clear:
                break
    return search


def is_size_unknown(config: HandConfig) -> bool:
    """Return whether the shape is not configured and matters, as the tracker fits frames."""
    is_given = config.init.shape == "given" or config.hand.mesh is not None
    is_given = is_given or config.hand.shape != HandSettings().shape
    return not is_given and fits_frames(config)


class SideAndScaleSearch:
    """Costs of frames for hands of several sides and sizes.

    If the configured hand fits well, other sizes are not tried. Otherwise sizes are a factor of
    ``_SCALE_RATIO`` apart; after the first frame only those next to the cheapest are tried again.

    Args:
        config: of hand and search.
        camera: of the depth images.
        sides: candidates.
        keypoints: from another program.
        has_sizes: whether to try sizes other than the configured one.
    """

    def __init__(
        self,
        config: HandConfig,
        camera: Camera,
        sides: Sequence[str],
        keypoints: KeypointFile | None = None,
        *,
        has_sizes: bool,
    ) -> None:
        self._keypoints, self._keypoint_side = keypoints, KeypointSide(keypoints, camera)
        self._quick, self._config, self._camera = quick_search(config), config, camera
        self._make_hand = hand_maker(config.hand.mesh)
        self.sides, self.frame_count, self._log_odds = sides, 0, 0.0
        own = config.hand.scale
        self._scales = tuple(own * _SCALE_RATIO**k for k in _SCALE_STEPS) if has_sizes else (own,)
        off = np.log(np.array(self._scales) / own)
        penalty = 0.5 * np.square(off / np.where(off > 0.0, *_SIZE_SD))
        self._size_penalty = np.minimum(penalty, _MAX_SIZE_PENALTY_MM)  # (K,) mm, of a frame
        self._tried: Sequence[int] = ()
        self._costs = np.zeros((len(sides), len(self._scales)))
        self._finders: dict[tuple[int, int, bool], Acquisition] = {}

    def add_frame(self, frame: Frame, advance: Advance = lambda count: None) -> None:
        """Add the costs of a frame, unless it shows no candidate; ``advance`` counts the searches."""
        own = len(self._scales) // 2
        detections = self._finder(0, own).detect(frame.depth)
        if not detections and not keypoint_candidates(
            self._keypoints, self._camera, self._finder(0, own), frame
        ):
            return
        self._add_keypoints(frame)

        def cost_of(side: int, k: int, detections: Sequence[Detection]) -> tuple[float, list[Detection]]:
            # sizes are compared roughly, but sides and the configured hand itself are not
            finder = self._finder(side, k, quick=k != own or costs.min() <= KNOWN_HAND_MM)
            extra = keypoint_candidates(self._keypoints, self._camera, finder, frame)
            advance(1)
            return finder.appraise(frame.depth, detections, extra, _FAR_WORSE * costs.min() + _FAR_WORSE_MM)

        costs = np.full(self._costs.shape, self._config.observation.clamp_mm)
        costs[0, own], likely = cost_of(0, own, detections)

        @cache
        def detected(k: int) -> list[Detection]:
            """Detection depends on the palm's size, so far sizes need their own."""
            near = abs(k - own) <= 1
            return likely if near else self._finder(0, k, quick=True).detect(frame.depth, is_sized=True)

        def appraise(side: int, k: int) -> None:
            costs[side, k] = cost_of(side, k, detected(k))[0]

        for side in range(1, len(self.sides)):
            appraise(side, own)
        least = costs[:, own].min()
        possible = [side for side in range(len(self.sides)) if costs[side, own] < least + _HOPELESS_MM]
        if not self._tried:
            self._tried = [own]
            if len(self._scales) > 1 and least > _SAME_SIZE_MM:
                self._tried = sorted(
                    {k for side in possible for k in self._climb_scale(side, costs, appraise)}
                )
        else:
            costs[:, self._tried] = costs[:, [own]]  # of a side whose size remains unknown
            for side, k in product(possible, set(self._tried) - {own}):
                appraise(side, k)
        self._costs += costs
        self.frame_count += 1
        if len(self.sides) > 1:
            most = CLEAR_LOG_ODDS if costs.min() <= KNOWN_HAND_MM else MAX_PER_FRAME
            self._log_odds += side_log_odds(float(costs[0].min()), float(costs[1].min()), most)
        self._tried = self._open_sizes()

    def _open_sizes(self) -> list[int]:
        """Return the cheapest size, and of those tried its neighbours and any that costs little more."""
        side, best = self._best
        more = self._total_costs[side] - self._total_costs[side, best]
        return [k for k in {*self._tried, best} if abs(k - best) <= 1 or more[k] < _OPEN_MM]

    def _add_keypoints(self, frame: Frame) -> None:
        """Add the evidence of the frame's keypoints for the side."""
        if len(self.sides) > 1:
            right, left = (self._finder(side, len(self._scales) // 2).observer.anatomy for side in (0, 1))
            self._keypoint_side.add_frame(frame, right, left)

    def _climb_scale(self, side: int, costs: FloatArray, appraise: Callable[[int, int], None]) -> set[int]:
        """Evaluate sizes of a side until the cheapest lies between two others; return those evaluated."""
        own, best = len(self._scales) // 2, -1
        tried = {own}
        if costs[side, own] > _FAR_SIZES_ABOVE_MM:
            for k in (own + step for step in _FAR_STEPS):
                appraise(side, k)
                tried.add(k)
        while True:
            before, best = best, int(np.argmin(costs[side] + self._size_penalty))
            if best == before:
                return tried
            for k in {best - 1, best + 1} & set(range(len(self._scales))) - tried:
                appraise(side, k)
                tried.add(k)

    @property
    def log_odds(self) -> float:
        """Return the log odds of the first side, from costs and keypoints; infinite if it is the only one."""
        return np.inf if len(self.sides) == 1 else self._log_odds + self.keypoint_log_odds

    @property
    def keypoint_log_odds(self) -> float:
        """Return the part of the log odds from keypoints."""
        return self._keypoint_side.log_odds

    @property
    def _best(self) -> tuple[int, int]:
        """Return the indices of the side and size that cost least so far."""
        side = 0 if self.log_odds >= 0.0 else 1
        return side, int(np.argmin(self._total_costs[side]))

    @property
    def _total_costs(self) -> FloatArray:
        """Return the costs (S, K) of sides and sizes, with the size penalty."""
        return np.asarray(self._costs + max(self.frame_count, 1) * self._size_penalty)

    @property
    def cost(self) -> float:
        """Return the mean cost per frame of the likeliest hand, mm."""
        return float(self._costs[self._best] / max(self.frame_count, 1))

    @property
    def side(self) -> str:
        """Return the likelier side."""
        return self.sides[self._best[0]]

    @property
    def is_sure_of_side(self) -> bool:
        """Return whether the frames agree on the side."""
        return abs(self.log_odds) >= CLEAR_LOG_ODDS

    @property
    def is_clear(self) -> bool:
        """Return whether no further frame is needed."""
        enough = self.frame_count >= (_FRAMES_FOR_SIZE if len(self._tried) > 1 else 1)
        return self.frame_count >= MAX_FRAMES or (enough and self.is_sure_of_side)

    def scale(self, of: str) -> float:
        """Return a side's size: the vertex of the parabola through the cheapest size and its neighbours."""
        side = self.sides.index(of)
        k = int(np.argmin(self._total_costs[side]))
        if not 0 < k < len(self._scales) - 1 or not len(self._tried) > 1:
            return self._scales[k]
        before, here, after = self._total_costs[side, k - 1 : k + 2]
        shift = 0.5 * (before - after) / max(before - 2.0 * here + after, 1e-9)
        found = round(float(self._scales[k] * _SCALE_RATIO ** np.clip(shift, -0.5, 0.5)), 3)
        own = self._config.hand.scale
        return own if abs(found / own - 1.0) < _SAME_SIZE else found

    def _finder(self, side: int, k: int, quick: bool = False) -> Acquisition:
        """Return the search for a hand of one side and size.

        The thumb is rigid and not expected to rest: with inner angles a hand of another side or size fits as
        well, and the rest prior pulls both thumbs away from the image, which weakens the evidence for the
        side.
        """
        if (side, k, quick) not in self._finders:
            shape = replace(self._config.hand.shape, scale=self._scales[k])
            hand = self._make_hand(self.sides[side], shape)
            config = self._quick if quick else self._config
            self._finders[side, k, quick] = Acquisition(config, hand, self._camera, STIFF_THUMB)
        return self._finders[side, k, quick]


def side_log_odds(cost_mm: float, other_mm: float, most: float = MAX_PER_FRAME) -> float:
    """Return the log odds of a side in one frame from the costs of both."""
    strange = max(1.0, min(cost_mm, other_mm) / _USUAL_COST_MM)
    return float(np.clip((other_mm - cost_mm) / _COST_PER_LOG_ODD_MM, -most, most)) / strange


def early_frames(recording: Recording, start: int) -> Iterator[Frame]:
    """Yield every ``FRAME_STRIDE``-th frame of the first seconds: between them the hand turns and opens."""
    frames = recording.frames(start=start, end=None, stride=FRAME_STRIDE)
    first = next(frames, None)
    if first is None:
        return iter(())
    last = first.stamp_ns + int(EARLY_S * NS_PER_S)
    return takewhile(lambda frame: frame.stamp_ns <= last, chain((first,), _until_unreadable(frames)))


def _until_unreadable(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Yield frames up to the first unreadable one, which the run itself will report."""
    with suppress(RecordingError):
        yield from frames


# Detection before a run, and calibration

_DESCRIBED_FRAMES = 8
_RESIZE_COST_RATIO = 0.8  # largest cost of a shape of another size, relative to the average hand
# Likewise for any shape **[ours]**. It is adjusted to other residuals than the cost, so a better shape may
# cost somewhat more.
_MAX_COST_RATIO = 1.25


FEW_FRAMES, SHAPE_DOUBT = 4, 4.4
"""A shape from fewer frames also explains wrong fingers; reduction of the log odds of such an estimate.

Fitted to single frames of 19 rendered people: fingertips of likelier ones are within 9 mm.
"""


@dataclass(frozen=True)
class DetectedHand:
    """The hand at the start of a run.

    Attributes:
        config: with its side and the estimated shape.
        line: summary for the user; empty if everything was configured.
        is_doubtful: whether the summary is a warning.
    """

    config: HandConfig
    line: str = ""
    is_doubtful: bool = False


def detect_hand(
    recording: Recording,
    config: HandConfig,
    start: int,
    keypoints: KeypointFile | None = None,
) -> DetectedHand:
    """Determine side, size and shape of the hand where the configuration leaves them open.

    Side and size come from the first seconds of the run, the shape from frames between its start and the end
    of the recording, wherever the run ends. The result depends on recording and configuration only, so that a
    resumed run detects the same hand.

    Args:
        recording: depth frames.
        config: ``hand.side`` and ``init.shape`` may be ``auto``.
        start: the run's first frame.
        keypoints: from another program: further candidates, and evidence of the side.

    Raises:
        UsageError: the configured mesh is not a usable hand.
    """
    is_open = is_size_unknown(config)
    is_any_side = config.hand.side == "auto" and config.hand.count != BOTH
    if not is_any_side and not is_open:
        return DetectedHand(_counted(recording, config, start, config.hand.scale))
    sides = SIDES if config.hand.side == "auto" else (config.hand.side,)
    search = search_early_frames(recording, config, start, sides, keypoints)
    if not search.frame_count:
        line = _line_without_hand(recording, config, start, sides[0]) if len(sides) > 1 else ""
        return DetectedHand(_with_hand(config, {"side": sides[0]}), line, bool(line))

    config = _counted(recording, config, start, search.scale(search.side))
    is_unknown = is_open and search.cost > KNOWN_HAND_MM
    if is_unknown and recording.frame_count is not None and recording.frame_count - start < FEW_FRAMES:
        doubted = config.status.model_copy(update={"shape_doubt": SHAPE_DOUBT})
        config = config.model_copy(update={"status": doubted})
    if config.hand.count in (BOTH, ONE_OF_TWO):
        return _both_hands(recording, config, start, search, is_open=is_open)
    estimate = _shapes(recording, config, search, CalibrationOptions(start=start))
    likelier = decide_side(search, estimate if is_unknown else lambda side: None)
    sized, found = _with_scale(config, search, likelier.side), likelier.found
    if found is not None and not _is_usable(found):
        found = None
    hand = f"a {likelier.side} hand"
    warning = ""
    if not likelier.is_sure:
        warning = f", but uncertain (probability {likelier.probability:.2f}); set --hand-side"
    if found is not None:
        line = f"{hand}, {found.length_mm:.0f} mm long{warning}{found.warning}"
        config = _with_baseline(_with_hand(sized, found.settings), found)
        config = _with_probability(config, likelier, found.length_mm)
        return DetectedHand(config, line, bool(warning or found.warning))
    changed = sized.hand.scale != config.hand.scale
    length_mm = _length_mm(sized) if changed else None  # makes the hand, from a file if there is one
    warning += "" if length_mm is None else _size_warning(length_mm, recording)
    sized = _with_probability(sized, likelier, length_mm)
    line = hand + (f" of scale {sized.hand.scale:.2f}" if changed else "") + warning
    return DetectedHand(sized, line if len(sides) > 1 or changed else "", bool(warning))


def _length_mm(config: HandConfig) -> float:
    """Return the length of the configured hand."""
    return float(measures_of(hand_maker(config.hand.mesh)(config.hand.side, config.hand.shape).anatomy)[0])


def _size_warning(length_mm: float, recording: Recording) -> str:
    """Return a clause about a hand whose size is none of a person's, with its length; else empty."""
    doubt = length_warning(length_mm, unit_mm_of(recording.pixels[0]))
    return f", {length_mm:.0f} mm long{doubt}" if doubt else ""


def _counted(recording: Recording, config: HandConfig, start: int, scale: float) -> HandConfig:
    """Return the configuration with the number of hands in view; one if the tracker fits no frames."""
    count, fits = config.hand.count, fits_frames(config)
    if count == BOTH and not fits:
        raise UsageError(
            "two hands cannot be tracked",
            found=f"--filter {config.filter.kind} --proposal {config.filter.proposal}, which fits no frames",
            expected="--filter rbpf or pf with --proposal guided",
        )
    if count in (BOTH, ONE_OF_TWO):
        return config
    is_given = count == "auto" and config.hand.side != "auto" and not is_size_unknown(config)
    if not fits or config.init.method != "auto" or is_given:
        return _with_hand(config, {"count": "1"})
    is_one = count == "1" or config.hand.side != "auto"
    shows_two = PairFinder(recording, config, scale, start).shows_two
    return _with_hand(config, {"count": (ONE_OF_TWO if is_one else BOTH) if shows_two else "1"})


def _both_hands(
    recording: Recording, config: HandConfig, start: int, search: SideAndScaleSearch, *, is_open: bool
) -> DetectedHand:
    """Estimate the shape that two hands share, if it is open; of two hands of one side, one is tracked."""
    side = search.side if config.hand.side == "auto" else config.hand.side
    scale = search.scale(search.side)
    config, found, common = _with_hand(config, {"side": side, "scale": scale}), None, None
    if is_open:
        frames = PairFinder(recording, config, scale, start).frames
        if (common := common_side(frames)) is not None:
            config = _with_hand(config, {"side": common, "count": ONE_OF_TWO})
            frames = [one.only(common) for one in frames]
        found = shape_of_both(recording, config, frames, _is_usable)
    hands = "two hands" if config.hand.count == BOTH else f"the {side} one of two hands"
    if common is not None:
        hands = f"two {common} hands, of two people, which is not supported: only one is tracked"
    if found is None:
        length_mm = _length_mm(config)
        warning = _size_warning(length_mm, recording)
        config = _with_probability(config, None, length_mm)
        return DetectedHand(config, f"{hands} of scale {scale:.2f}{warning}", bool(warning or common))
    config = _with_baseline(_with_hand(config, found.settings), found)
    config = _with_probability(config, None, found.length_mm)
    line = f"{hands}, {found.length_mm:.0f} mm long{found.warning}"
    return DetectedHand(config, line, bool(found.warning or common))


def _line_without_hand(recording: Recording, config: HandConfig, start: int, side: str) -> str:
    """Describe the first seconds, and the hand that is assumed for later frames."""
    frames = list(islice(early_frames(recording, start), _DESCRIBED_FRAMES))
    line = f"no hand in the first {EARLY_S:g} s"
    if not frames:
        return line
    seen = DepthEvidence(recording, config, frames)
    line = f"{line}: {seen.line}"
    later = f"; assuming a {side} hand for later frames, set --hand-side to change it"
    return f"{line}{later if seen.is_in_range else ''}"


def calibrate(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration:
    """Estimate side, size and shape of the hand in a recording, whatever is configured.

    Args:
        recording: depth frames.
        config: of window, segmentation and fits; of its hand only the mesh is used.
        options: the rest.

    Raises:
        RecordingError: no frame, or no hand found in four frames (or all of fewer).
        UsageError: the configured mesh is not a usable hand.
    """
    sides = (options.side,) if options.side else SIDES
    bare = config.model_copy(update={"hand": HandSettings(mesh=config.hand.mesh)})
    search = search_recording(recording, bare, options.start, sides)
    likelier = decide_side(search, _shapes(recording, bare, search, options))
    # without a shape, estimate it again to raise its error
    return likelier.found or shape_of(recording, _with_scale(bare, search, likelier.side), options)


def _shapes(
    recording: Recording,
    config: HandConfig,
    search: SideAndScaleSearch,
    options: CalibrationOptions,
) -> Callable[[str], Calibration | None]:
    """Return a function that estimates the shape of a side's hand, starting from the best known size."""
    scales = {side: search.scale(side) for side in search.sides}

    def estimate(side: str) -> Calibration | None:
        sized = _with_hand(config, {"side": side, "scale": scales[side]})
        found = _shape_at_own_size(recording, sized, replace(options, side=side))
        if found is not None and found.begun_scale != scales[side]:
            scales.update(dict.fromkeys(scales, found.begun_scale))  # both sides have the same size
        return found

    return estimate


def _shape_at_own_size(
    recording: Recording, config: HandConfig, options: CalibrationOptions
) -> Calibration | None:
    """Estimate the shape; if it leaves the start size far behind, start again from its own size.

    Sizes are searched in few frames and quickly, which may fail for small hands in front of a forearm.
    """
    found = _shape(recording, config, options)
    if found is None or not found.is_of_another_size:
        return found
    again = _shape(recording, _with_hand(config, {"scale": found.likely_scale}), options)
    if again is None or again.is_of_another_size:
        return found
    return again if again.costs_mm[1] < _RESIZE_COST_RATIO * found.costs_mm[0] else found


def _shape(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration | None:
    """Estimate the shape; None if too few frames show the hand."""
    try:
        return shape_of(recording, config, options)
    except RecordingError:
        return None


def _is_usable(found: Calibration) -> bool:
    """Return whether a shape fits about as well as the average hand or better, at about its start size."""
    average, own = found.costs_mm
    return own <= _MAX_COST_RATIO * average and not found.is_of_another_size


def _with_scale(config: HandConfig, search: SideAndScaleSearch, side: str) -> HandConfig:
    return _with_hand(config, {"side": side, "scale": search.scale(side)})


def _with_hand(config: HandConfig, changes: dict[str, object]) -> HandConfig:
    return config.model_copy(update={"hand": config.hand.model_copy(update=changes)})


def _with_baseline(config: HandConfig, found: Calibration) -> HandConfig:
    """Set the cost of good fits from the calibration, unless it is configured."""
    if config.status.baseline_cost_mm > 0.0:
        return config
    status = config.status.model_copy(update={"baseline_cost_mm": round(found.baseline_cost_mm, 4)})
    return config.model_copy(update={"status": status})


def _with_probability(config: HandConfig, side: SideEstimate | None, length_mm: float | None) -> HandConfig:
    """Set the probability of a detected side and an estimated length; None for what was given."""
    is_right = 1.0 if side is None or side.is_sure else side.probability
    is_right *= 1.0 if length_mm is None else length_probability(length_mm)
    status = config.status.model_copy(update={"hand_probability": round(is_right, 4)})
    return config.model_copy(update={"status": status})
