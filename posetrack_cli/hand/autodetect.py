"""What is found out before a run: side, size and shape of the hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, islice, product, takewhile

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig, HandSettings
from posetrack_cli.hand.evidence import DepthEvidence
from posetrack_cli.hand.fit.gauss_newton import STIFF_THUMB
from posetrack_cli.hand.fit.likelihood import PROPOSALS
from posetrack_cli.hand.keypoints.file import KeypointFile
from posetrack_cli.hand.keypoints.told import ToldSide, told_candidates
from posetrack_cli.hand.model.hand import hand_maker
from posetrack_cli.hand.observe.detection import Detection
from posetrack_cli.hand.search import Acquisition
from posetrack_cli.hand.shape_fit import Calibration, CalibrationOptions, doubts_of, shape_of
from posetrack_cli.phases import Advance, phase
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording

# Right or left, decided again where a hand of average shape did not tell: by hands of the shapes found


_COUNTED = 4.0
"""Independent frames that those of a shape count as: it is fitted to all of them, and errs in all alike."""


@dataclass(frozen=True)
class SideFound:
    """Which hand it is.

    Attributes:
        side: ``right`` or ``left``.
        log_odds: of that side against the other; infinite where no other was possible.
        found: its shape, where it was estimated.
    """

    side: str
    log_odds: float
    found: Calibration | None

    @property
    def probability(self) -> float:
        """Of the side."""
        return float(1.0 / (1.0 + np.exp(-self.log_odds)))

    @property
    def is_sure(self) -> bool:
        """Whether the side is certain."""
        return self.log_odds >= CLEAR_LOG_ODDS


def decide_side(trial: Trial, estimate: Callable[[str], Calibration | None]) -> SideFound:
    """Return the likelier side, and its shape.

    A pointing hand, or a fist, of average shape costs about the same as either hand; adjusted to the frames,
    the true one costs less. So both shapes are estimated where the trial's frames left the side open, or
    told of it by hands of a wrong size.

    Args:
        trial: what frames told of side and size.
        estimate: gives the shape of a side's hand; None where it has none that can be used.
    """
    shapes = {trial.side: estimate(trial.side)}
    if len(trial.sides) == 1 or (trial.is_sure_of_side and not _is_resized(trial, shapes)):
        return SideFound(trial.side, abs(trial.log_odds), shapes[trial.side])
    shapes |= {side: estimate(side) for side in trial.sides if side not in shapes}
    first, second = trial.sides
    one, other = shapes[first], shapes[second]
    log_odds = trial.told_log_odds if _is_resized(trial, shapes) else trial.log_odds
    if one is not None and other is not None:
        log_odds += _COUNTED * log_odds_of(one.costs_mm[1], other.costs_mm[1])
    elif _is_resized(trial, shapes):
        log_odds += MOST_A_FRAME * ((one is not None) - (other is not None))
    return SideFound(first, log_odds, one) if log_odds >= 0.0 else SideFound(second, -log_odds, other)


def _is_resized(trial: Trial, shapes: Mapping[str, Calibration | None]) -> bool:
    """Whether a shape was begun with another size than fitted best in the trial."""
    return any(one is not None and one.begun_scale != trial.scale(side) for side, one in shapes.items())


# Which hand it is, and about how large: both sides and several sizes, tried in a run's first seconds


SIDES = ("right", "left")
NS_PER_S = 10**9
LOOKED_AT_S = 10.0
"""A hand that shows itself later is not waited for."""
ASKED_EVERY = 12
"""Frames between those that are asked for the side: they err less alike than neighbours do."""
_COST_PER_LOG_ODDS, MOST_A_FRAME = 0.9, 3.0
"""What the other side costs more, mm, for one unit of log odds, and what a frame tells at most **[ours]**.

Of 94 frames of 14 people (600-617 of the synthetic strangers, with the average hand) the true side is the
cheaper one in four of five; 0.7 mm would be likeliest if frames erred independently."""
_USUAL_COST_MM = 6.0
"""What the cheaper side cost in these; where it costs more, by hands less like the average one, a difference
tells less in proportion."""
WELL_KNOWN_MM = 2.2
"""A hand that costs no more is the configured one: its own model costs 1 to 2 mm, strangers 3 and more. One
frame of such a hand may tell the side for certain, if its mirror image costs 3.6 mm more."""
CLEAR_LOG_ODDS, MOST_ASKED = 4.0, 16
"""Above it the side is certain (.98); frames asked at most."""
_RATIO, _STEPS = 1.16, range(-5, 6)
"""Of sizes that are tried, and how many such steps from the one that is configured: 0.48 to 2.1 of it."""
_STRANGE_MM, _FAR_STEPS = 8.0, (-4, -3, -2, 2, 3, 4)
"""Where a hand costs more, sizes far from it are tried, too: between them costs need not fall."""
_FRAMES_FOR_SIZE, _OWN_MM, _SAME_SIZE = 3, 4.0, 0.03
"""Frames that tell a size; at what cost a hand is of the size that is configured, or how near to it."""
_SIZE_SD, _ANOTHER_UNIT_MM = (0.12, 0.15), 2.5
"""Standard deviations of a size's logarithm above and below the average man's and woman's: men are not much
larger, children smaller. Half a squared one weighs as 1 mm of cost: a hand that is too large covers what the
sensor blurs, and is cheaper than the true one by up to 3 mm (CVAR P4). Nothing weighs more than that the
depth is in another unit than it is taken for: then hands are of any size."""
_QUICK = {"scattered": 4, "finished": 3}
"""A search for another size, or for the other side of a hand that is well known, may miss the last tenths of
a millimetre."""
_HOPELESS_MM = 4.0
"""A side that costs so much more than the other in a frame is not tried in further sizes."""


def tried(
    recording: Recording,
    config: HandConfig,
    start: int,
    sides: Sequence[str],
    keypoints: KeypointFile | None = None,
) -> Trial:
    """Return what frames from the first one on tell of side and size; they are asked until they agree.

    Args:
        recording: depth frames.
        config: of the hand and the search.
        start: the first frame.
        sides: to be tried.
        keypoints: from elsewhere.

    Raises:
        UsageError: the configuration's mesh is no hand that can be used.
    """
    trial = Trial(config, recording.cameras[0], sides, keypoints, has_sizes=is_size_open(config))
    return _asked(trial, early_frames(recording, start))


def tried_all_over(recording: Recording, config: HandConfig, start: int, sides: Sequence[str]) -> Trial:
    """Return what frames of the whole recording tell of side and size, whatever is configured of them.

    Of a few separate images all are asked, until they agree; a hand that shows itself late is waited for.

    Raises:
        RecordingError: an image cannot be used.
        UsageError: the configuration's mesh is no hand that can be used.
    """
    count = recording.frame_count
    stride = ASKED_EVERY if count is None else min(max((count - start) // MOST_ASKED, 1), ASKED_EVERY)
    trial = Trial(config, recording.cameras[0], sides, has_sizes=True)
    return _asked(trial, recording.frames(start=start, end=None, stride=stride))


def _asked(trial: Trial, frames: Iterator[Frame]) -> Trial:
    """The trial after frames have been asked, until they agree."""
    with phase("finding side and size", "search") as advance:
        for frame in frames:
            trial.ask(frame, advance)
            if trial.is_clear:
                break
    return trial


def is_size_open(config: HandConfig) -> bool:
    """Whether nobody has told the hand's shape, and the tracker fits frames, which a wrong shape misleads."""
    told = config.init.shape == "given" or config.hand.mesh is not None
    told = told or config.hand.shape != HandSettings().shape
    return not told and PROPOSALS[config.filter.proposal].fits_frames and config.filter.kind != "pso"


class Trial:
    """What frames cost for hands of several sides and sizes.

    A hand that fits well is of the size that is configured, and no other is tried. Else the sizes are a ratio
    of ``_RATIO`` apart; after a first frame only those about the cheapest are tried further.

    Args:
        config: of the hand and the search.
        camera: of the depth images.
        sides: to be tried.
        keypoints: from elsewhere.
        has_sizes: whether other sizes than the one that is configured are tried.
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
        self._keypoints, self._told = keypoints, ToldSide(keypoints, camera)
        quick = config.acquisition.model_copy(update=_QUICK)
        never = config.status.model_copy(update={"sure_mm": config.observation.clamp_mm})
        self._quick = config.model_copy(update={"acquisition": quick, "status": never})
        self._config, self._camera = config, camera
        self._make_hand = hand_maker(config.hand.mesh)
        self.sides, self.asked, self._log_odds = sides, 0, 0.0
        own = config.hand.scale
        self._scales = tuple(own * _RATIO**k for k in _STEPS) if has_sizes else (own,)
        off = np.log(np.array(self._scales) / own)
        unusual = 0.5 * np.square(off / np.where(off > 0.0, *_SIZE_SD))
        self._unusual = np.minimum(unusual, _ANOTHER_UNIT_MM)  # (K,) mm, of a frame
        self._tried: Sequence[int] = ()
        self._costs = np.zeros((len(sides), len(self._scales)))
        self._finders: dict[tuple[int, int, bool], Acquisition] = {}

    def ask(self, frame: Frame, advance: Advance = lambda count: None) -> None:
        """Add what a frame costs, if there may be a hand in it; ``advance`` counts the searches."""
        own = len(self._scales) // 2
        places = self._finder(0, own).detect(frame.depth)
        if not places and not told_candidates(self._keypoints, self._camera, self._finder(0, own), frame):
            return
        self._ask_keypoints(frame)

        def of(side: int, k: int, places: Sequence[Detection]) -> tuple[float, list[Detection]]:
            finder = self._finder(side, k, quick=k != own or costs.min() <= WELL_KNOWN_MM)
            told = told_candidates(self._keypoints, self._camera, finder, frame)
            advance(1)
            return finder.appraise(frame.depth, places, told)

        costs = np.full(self._costs.shape, self._config.observation.clamp_mm)
        costs[0, own], likely = of(0, own, places)

        def appraise(side: int, k: int) -> None:
            if (side, k) == (0, own):
                return
            # a palm is as large as the hand: where it is looked for depends on it
            there = likely if abs(k - own) <= 1 else self._finder(side, k, quick=True).detect(frame.depth)
            costs[side, k] = of(side, k, there)[0]

        for side in range(len(self.sides)):
            appraise(side, own)
        least = costs[:, own].min()
        possible = [side for side in range(len(self.sides)) if costs[side, own] < least + _HOPELESS_MM]
        if not self._tried:
            self._tried = [own]
            if len(self._scales) > 1 and least > _OWN_MM:
                self._tried = sorted({k for side in possible for k in self._climbed(side, costs, appraise)})
        else:
            for side, k in product(possible, set(self._tried) - {own}):
                appraise(side, k)
        self._costs += costs
        self.asked += 1
        self._tried = [k for k in {*self._tried, self._best[1]} if abs(k - self._best[1]) <= 1]
        if len(self.sides) > 1:
            most = CLEAR_LOG_ODDS if costs.min() <= WELL_KNOWN_MM else MOST_A_FRAME
            self._log_odds += log_odds_of(float(costs[0].min()), float(costs[1].min()), most)

    def _ask_keypoints(self, frame: Frame) -> None:
        """Add what the frame's keypoints tell of the side."""
        if len(self.sides) > 1:
            right, left = (self._finder(side, len(self._scales) // 2).observer.anatomy for side in (0, 1))
            self._told.ask(frame, right, left)

    def _climbed(self, side: int, costs: FloatArray, appraise: Callable[[int, int], None]) -> set[int]:
        """Try sizes of a side beside the cheapest, until that lies between two; return which were tried."""
        own, best = len(self._scales) // 2, -1
        tried = {own}
        if costs[side, own] > _STRANGE_MM:
            for k in (own + step for step in _FAR_STEPS):
                appraise(side, k)
                tried.add(k)
        while True:
            before, best = best, int(np.argmin(costs[side] + self._unusual))
            if best == before:
                return tried
            for k in {best - 1, best + 1} & set(range(len(self._scales))) - tried:
                appraise(side, k)
                tried.add(k)

    @property
    def log_odds(self) -> float:
        """The logarithm of the first side's odds, by costs and keypoints; infinite if it is the only one."""
        return np.inf if len(self.sides) == 1 else self._log_odds + self.told_log_odds

    @property
    def told_log_odds(self) -> float:
        """The same by keypoints alone."""
        return self._told.log_odds

    @property
    def _best(self) -> tuple[int, int]:
        """Which side, and which size of it, costs least so far."""
        side = 0 if self.log_odds >= 0.0 else 1
        return side, int(np.argmin(self._doubts[side]))

    @property
    def _doubts(self) -> FloatArray:
        """What sides and sizes (S, K) cost, and what speaks against the sizes beforehand."""
        return np.asarray(self._costs + max(self.asked, 1) * self._unusual)

    @property
    def cost(self) -> float:
        """What the likeliest hand costs in a frame, mm, on average."""
        return float(self._costs[self._best] / max(self.asked, 1))

    @property
    def side(self) -> str:
        """The likelier side."""
        return self.sides[self._best[0]]

    @property
    def is_sure_of_side(self) -> bool:
        """Whether frames agree on the side."""
        return abs(self.log_odds) >= CLEAR_LOG_ODDS

    @property
    def is_clear(self) -> bool:
        """Whether no further frame has to be asked."""
        enough = self.asked >= (_FRAMES_FOR_SIZE if len(self._tried) > 1 else 1)
        return self.asked >= MOST_ASKED or (enough and self.is_sure_of_side)

    def scale(self, of: str) -> float:
        """Return a side's size at the vertex of the parabola through the least cost and those beside it."""
        side = self.sides.index(of)
        k = int(np.argmin(self._doubts[side]))
        if not 0 < k < len(self._scales) - 1 or not len(self._tried) > 1:
            return self._scales[k]
        before, here, after = self._doubts[side, k - 1 : k + 2]
        shift = 0.5 * (before - after) / max(before - 2.0 * here + after, 1e-9)
        found = round(float(self._scales[k] * _RATIO ** np.clip(shift, -0.5, 0.5)), 3)
        own = self._config.hand.scale
        return own if abs(found / own - 1.0) < _SAME_SIZE else found

    def _finder(self, side: int, k: int, quick: bool = False) -> Acquisition:
        """What searches with a hand of one side and size.

        Its thumb has no inner angles: with them a hand of another side or size fits, too. Nor is it expected
        to rest: that pulls both sides' thumbs from what the image shows, and tells less of the side.
        """
        if (side, k, quick) not in self._finders:
            shape = replace(self._config.hand.shape, scale=self._scales[k])
            hand = self._make_hand(self.sides[side], shape)
            config = self._quick if quick else self._config
            self._finders[side, k, quick] = Acquisition(config, hand, self._camera, STIFF_THUMB)
        return self._finders[side, k, quick]


def log_odds_of(cost_mm: float, other_mm: float, most: float = MOST_A_FRAME) -> float:
    """Return the log odds of a side in a frame, by what it costs and what the other one does."""
    strange = max(1.0, min(cost_mm, other_mm) / _USUAL_COST_MM)
    return float(np.clip((other_mm - cost_mm) / _COST_PER_LOG_ODDS, -most, most)) / strange


def early_frames(recording: Recording, start: int) -> Iterator[Frame]:
    """Yield frames of the first seconds, some time apart: hands that turn and open tell their side."""
    frames = recording.frames(start=start, end=None, stride=ASKED_EVERY)
    first = next(frames, None)
    if first is None:
        return iter(())
    last = first.stamp_ns + int(LOOKED_AT_S * NS_PER_S)
    return takewhile(lambda frame: frame.stamp_ns <= last, chain((first,), _readable(frames)))


def _readable(frames: Iterator[Frame]) -> Iterator[Frame]:
    """The frames up to one that cannot be read, which the run itself will tell."""
    with suppress(RecordingError):
        yield from frames


# What is found out about a hand before it is tracked: right or left, its size and its shape.
#
# It depends on the recording and the configuration alone, so a run that is resumed finds the same.


_SHOWN = 8
"""Frames that are described where none shows a hand."""
_FAR_CHEAPER = 0.8
"""Of what the average hand costs in the size that fitted best: what a hand of another size costs at most."""
_DEARER = 1.25
"""Of what the average hand costs: what a shape costs at most **[ours]**. Shapes are adjusted to other
residuals than searches are judged by, so a better one may cost more. Of 133 people (504 to 753 of the
synthetic strangers) nineteen had shapes that cost .91 to 1.12, and fingertips of all were closer with them
than with the average hand, by 1.9 mm on average; sixteen of these cost .79 to 1.16 once steps
stayed within bounds."""


@dataclass(frozen=True)
class HandFound:
    """What is known of the hand when a run begins.

    Attributes:
        config: with a side, and the shape that was found.
        line: what was found, for people; empty where nothing was left open.
        is_doubtful: whether the line tells a doubt.
    """

    config: HandConfig
    line: str = ""
    is_doubtful: bool = False


def find_hand(
    recording: Recording,
    config: HandConfig,
    start: int,
    keypoints: KeypointFile | None = None,
) -> HandFound:
    """Decide what a configuration leaves open about the hand: its side, its size, its shape.

    Side and size are told by the first seconds from the run's first frame, the shape by frames from there to
    the recording's end, wherever the run ends.

    Args:
        recording: depth frames.
        config: its ``hand.side`` may be ``auto``, its ``init.shape``, too.
        start: the run's first frame.
        keypoints: from elsewhere: further places, and evidence of the side.

    Raises:
        UsageError: the configuration's mesh is no hand that can be used.
    """
    is_open = is_size_open(config)
    if config.hand.side != "auto" and not is_open:
        return HandFound(config)
    sides = SIDES if config.hand.side == "auto" else (config.hand.side,)
    trial = tried(recording, config, start, sides, keypoints)
    if not trial.asked:
        line = _nothing_found(recording, config, start, sides[0]) if len(sides) > 1 else ""
        return HandFound(_with_hand(config, {"side": sides[0]}), line, bool(line))

    estimate = _shapes(recording, config, trial, CalibrationOptions(start=start))

    def estimate_usable(side: str) -> Calibration | None:
        found = estimate(side)
        return found if found is not None and _is_usable(found) else None

    is_unknown = is_open and trial.cost > WELL_KNOWN_MM
    likelier = decide_side(trial, estimate_usable if is_unknown else lambda side: None)
    sized, found = _sized(config, trial, likelier.side), likelier.found
    told = f"a {likelier.side} hand"
    doubt = (
        ""
        if likelier.is_sure
        else f", but hardly so (probability {likelier.probability:.2f}); --hand-side tells"
    )
    if found is not None:
        more = doubts_of(found)
        line = f"{told}, {found.length_mm:.0f} mm long{doubt}{more}"
        return HandFound(_judged_by(_with_hand(sized, found.settings), found), line, bool(doubt or more))
    changed = sized.hand.scale != config.hand.scale
    line = told + (f" of scale {sized.hand.scale:.2f}" if changed else "") + doubt
    return HandFound(sized, line if len(sides) > 1 or changed else "", bool(doubt))


def _nothing_found(recording: Recording, config: HandConfig, start: int, side: str) -> str:
    """What the first seconds show, and what a hand that comes later is taken for."""
    frames = list(islice(early_frames(recording, start), _SHOWN))
    line = f"no hand in the first {LOOKED_AT_S:g} s"
    if not frames:
        return line
    seen = DepthEvidence(recording, config, frames)
    line = f"{line}: {seen.line}"
    later = f"; a later one is taken for a {side} hand, --hand-side states another"
    return f"{line}{later if seen.is_in_range else ''}"


def calibrate(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration:
    """Estimate side, size and shape of the hand in a recording, whatever is configured of them.

    Args:
        recording: depth frames.
        config: of window, segmentation and fits; of its hand only the mesh is read.
        options: the rest.

    Raises:
        RecordingError: no frame, or no hand that can be found in at least four frames.
        UsageError: the configuration's mesh is no hand that can be used.
    """
    sides = (options.side,) if options.side else SIDES
    bare = config.model_copy(update={"hand": HandSettings(mesh=config.hand.mesh)})
    trial = tried_all_over(recording, bare, options.start, sides)
    likelier = decide_side(trial, _shapes(recording, bare, trial, options))
    # what is wrong where there is none is said by trying again
    return likelier.found or shape_of(recording, _sized(bare, trial, likelier.side), options)


def _shapes(
    recording: Recording,
    config: HandConfig,
    trial: Trial,
    options: CalibrationOptions,
) -> Callable[[str], Calibration | None]:
    """Return what estimates the shape of a side's hand, begun in the size that is known best by then."""
    scales = {side: trial.scale(side) for side in trial.sides}

    def estimate(side: str) -> Calibration | None:
        sized = _with_hand(config, {"side": side, "scale": scales[side]})
        found = _shape_in_its_size(recording, sized, replace(options, side=side))
        if found is not None and found.begun_scale != scales[side]:
            scales.update(dict.fromkeys(scales, found.begun_scale))  # which hand it is changes no size
        return found

    return estimate


def _shape_in_its_size(
    recording: Recording, config: HandConfig, options: CalibrationOptions
) -> Calibration | None:
    """The hand's shape; one that leaves the size that fitted best is begun once more from its own.

    Sizes are tried in few frames and by short searches, which small hands before a forearm may mislead.
    """
    found = _shape(recording, config, options)
    if found is None or not found.is_of_another_size:
        return found
    again = _shape(recording, _with_hand(config, {"scale": found.likely_scale}), options)
    if again is None or again.is_of_another_size:
        return found
    return again if again.costs_mm[1] < _FAR_CHEAPER * found.costs_mm[0] else found


def _shape(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration | None:
    """The hand's shape, where enough frames show it."""
    try:
        return shape_of(recording, config, options)
    except RecordingError:
        return None


def _is_usable(found: Calibration) -> bool:
    """Whether a shape explains the frames nearly as well as the average hand or better, and is as large."""
    average, own = found.costs_mm
    return own <= _DEARER * average and not found.is_of_another_size


def _sized(config: HandConfig, trial: Trial, side: str) -> HandConfig:
    return _with_hand(config, {"side": side, "scale": trial.scale(side)})


def _with_hand(config: HandConfig, changes: dict[str, object]) -> HandConfig:
    return config.model_copy(update={"hand": config.hand.model_copy(update=changes)})


def _judged_by(config: HandConfig, found: Calibration) -> HandConfig:
    """The configuration with what good fits of the recording cost, where it says nothing of that."""
    if config.status.good_mm > 0.0:
        return config
    status = config.status.model_copy(update={"good_mm": round(found.good_mm, 4)})
    return config.model_copy(update={"status": status})
