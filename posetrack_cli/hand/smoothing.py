"""The smoothed track of a hand: the filter's belief at each frame, spooled, and smoothed backwards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.filtering.filters import FILTERS, FilterState
from posetrack_cli.filtering.fit_smoothing import FitSmoother
from posetrack_cli.filtering.gaussian_smoothing import GaussianSmoother
from posetrack_cli.filtering.model import Dynamics
from posetrack_cli.filtering.particle_smoothing import ParticleSmoother
from posetrack_cli.filtering.smoothing import NOTHING, Memory, Smoothed, Smoother, Step, noise_of
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.local_fits import HandFits
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.proposals import BLOCKS, PROPOSALS
from posetrack_cli.hand.protocol import hand_estimate
from posetrack_cli.hand.space import HandSpace, tangent_vector
from posetrack_cli.results.checkpoint import RESTART_HINT
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.layouts import STAMPS_NS, Layout, LayoutError, check_arrays, counts, floats
from posetrack_cli.results.spool import Array, RecordSpool

STATUSES = tuple(Status)
KEPT = "filter."
"""What names of a record begin with that are the smoother's."""
_NO_FRAME = {"frame_index": 0, "stamp_ns": 0, "status": 0, "cut": 0, "dt": 0.0, "confidence": 0.0}


class Kept(NamedTuple):
    """What a file of an interrupted run is to hold.

    Attributes:
        frames: how many of them stay; 1 or more.
        particles: any state of the filter's, and
        frame: what is kept of any frame: those that stay have to be of the same arrays.
    """

    frames: int
    particles: FilterState
    frame: Memory = NOTHING


class SmoothedTrack:
    """Remembers every frame of a run and then smooths them, from the last to the first.

        with SmoothedTrack(path, smoother, anatomy, kept) as track:
            track.remember(state.particles, estimate, dt, cut, frame)  # each frame
            track.flush()                                           # before a checkpoint
            for estimate in track.backward(): ...                   # at the end
            track.delete()

    A chain of frames is smoothed as one; a re-initialised track begins another. The memory is a file,
    and what is held of it does not grow with the recording.

    Args:
        path: of the file, beside the result.
        smoother: the backward pass.
        anatomy: the hand.
        kept: of an interrupted run; None for nothing.

    Raises:
        ResultError: here and in every method, when the file cannot be written or read, or holds what no run
            wrote.
    """

    def __init__(
        self, path: Path, smoother: Smoother, anatomy: HandAnatomy, kept: Kept | None = None
    ) -> None:
        self._path, self._smoother, self._anatomy = path, smoother, anatomy
        if kept is None:
            self._spool = RecordSpool(path)
            return
        like = _record(_NO_FRAME, smoother.remember(kept.particles, Step(0.0, True, kept.frame)))
        self._spool = RecordSpool(path, kept.frames, like)
        try:
            smoother.resume(self._memory_of(next(reversed(self._spool))))
        except BaseException:
            self._spool.close()
            raise

    def __len__(self) -> int:
        return len(self._spool)

    def remember(
        self,
        particles: FilterState,
        estimate: Estimate,
        dt: float,
        cut: bool,
        frame: Memory = NOTHING,
    ) -> None:
        """Keep what the filter knows after a frame.

        Args:
            particles: the filter's state.
            estimate: what was written of it.
            dt: seconds that the filter advanced by to this frame; 0 if it stood still.
            cut: whether the state does not follow from the frame before: at the first, or re-initialised.
            frame: what the smoother's fits keep of it (`HandFits.keep`).
        """
        about = {
            "frame_index": estimate.frame_index,
            "stamp_ns": estimate.stamp_ns,
            "status": STATUSES.index(estimate.status),
            "cut": int(cut),
            "dt": dt,
            "confidence": float(estimate.confidence),
        }
        self._spool.append(_record(about, self._smoother.remember(particles, Step(dt, cut, frame))))

    def flush(self) -> None:
        """Wait until everything is on the disk."""
        self._spool.flush()

    def backward(self) -> Iterator[Estimate]:
        """Yield the smoothed estimates, the last frame first.

        Status and confidence are those of the filter, which say whether the frame itself was understood.
        """
        later, ends, dt = None, True, 0.0
        for record in reversed(self._spool):
            memory = self._memory_of(record)
            if later is None or ends:
                later = self._smoother.begin(memory)
            else:
                later = self._smoother.back(memory, dt) if dt > 0.0 else self._smoother.stay(memory, later)
            ends, dt = bool(record["cut"]), float(record["dt"])
            yield self._estimate(record, later)

    def delete(self) -> None:
        """Remove the file."""
        self._spool.delete()

    def __enter__(self) -> SmoothedTrack:
        return self

    def __exit__(self, *_: object) -> None:
        """Let the file lie, for a run that is resumed."""
        self._spool.close()

    def _memory_of(self, record: dict[str, Array]) -> dict[str, Array]:
        """What of a record is the smoother's, once all of the record is known to be what a run wrote."""
        try:
            check_arrays(record, _layouts(record))
        except LayoutError as error:
            what = "spool cannot be used"
            raise ResultError(what, where=self._path, found=error, hint=RESTART_HINT) from error
        kept = ((name, values) for name, values in record.items() if name.startswith(KEPT))
        return {name.removeprefix(KEPT): values for name, values in kept}

    def _estimate(self, record: dict[str, Array], smoothed: Smoothed) -> Estimate:
        return hand_estimate(
            self._anatomy,
            smoothed.pose,
            smoothed.velocity,
            frame_index=int(record["frame_index"]),
            stamp_ns=int(record["stamp_ns"]),
            status=STATUSES[int(record["status"])],
            confidence=float(record["confidence"]),
            pose_variance=smoothed.pose_variance,
            twist_variance=smoothed.velocity_variance,
            effective_sample_size=None,
            resampled=False,
        )


def _record(about: Mapping[str, float], memory: Memory) -> dict[str, Array]:
    """The record of a frame."""
    kept = {f"{KEPT}{name}": values for name, values in memory.items()}
    return {name: np.asarray(value) for name, value in (dict(about) | kept).items()}


def _layouts(record: Mapping[str, Array]) -> dict[str, Layout]:
    """What the values of a record must be; its types and shapes are those of all others."""
    most = float(STAMPS_NS[1])
    layouts = {
        name: Layout(values.dtype.name, values.shape, -np.inf if values.ndim else 0.0, most)
        for name, values in record.items()
    }
    layouts["status"] = counts(most=len(STATUSES) - 1)
    layouts["cut"] = counts(most=1)
    layouts["dt"] = floats(least=0.0)
    return layouts


def frame_fits(config: HandConfig, hand: HandModel, camera: Camera) -> HandFits | None:
    """Return what looks at frames again; None unless local fits are smoothed."""
    wanted = config.smoothing.method == "fits" and PROPOSALS.find(config.filter.proposal).fits_frames
    return HandFits(config, hand, camera) if wanted else None


def make_smoother(
    config: HandConfig, dynamics: Dynamics, rng: np.random.Generator, fits: HandFits | None = None
) -> Smoother:
    """Return the smoother of ``smoothing.method``; ``fits`` is ``gaussian`` where there are no fits.

    Args:
        config: parameters.
        dynamics: those of the filter.
        rng: of backward simulation alone, so that filtered estimates do not depend on it.
        fits: of `frame_fits`.
    """
    moving = FILTERS.find(config.filter.kind).has_velocity
    space, settings = HandSpace(), config.smoothing
    if settings.method == "particles":
        return ParticleSmoother(noise_of(dynamics, moving), space, settings.trajectories, rng)
    if fits is not None:
        pose, velocity = tangent_vector(settings.pose), tangent_vector(settings.velocity)
        return FitSmoother(Dynamics(pose**2, velocity**2), space, fits, BLOCKS, settings.freedom)
    return GaussianSmoother(
        noise_of(dynamics, moving), space, guided=PROPOSALS.find(config.filter.proposal).looks_at_frames
    )
