"""The memory of a head run that is smoothed: frames on the way forward, the smoothed track in the end."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.filtering.smoothing import Memory
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from posetrack_cli.head.smoothing.fits import HeadFits, make_head_smoother
from posetrack_cli.head.smoothing.frames import FrameKeeper, HeadFrame, Link, Reach, chained, with_speeds
from posetrack_cli.head.smoothing.places import PosedFrame, posed_frame, with_places
from posetrack_cli.head.tracks import track_model
from posetrack_cli.phases import phase
from posetrack_cli.results.checkpoint import RESTART_HINT
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.layouts import LayoutError, check_arrays
from posetrack_cli.results.spool import RecordSpool
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking.smoothing import SmoothedTrack
from posetrack_cli.tracking.velocity import smoothed_velocities
from posetrack_cli.units import NS_PER_S


class HeadMemory:
    """Remembers every frame of a run, and writes the smoothed track (``tracking.run.FrameMemory``).

    The frames are gone through twice more. From the last to the first a Kalman filter runs over their fits,
    backwards in time, with the face as it was known in the end; then the smoother goes on from the first to
    the last. What is held does not grow with the recording: the frames, and what the filter expects of each,
    are in files beside the result.

    Args:
        path: of the file of frames; that of the way back lies beside it.
        config: the tracker's.
        subject: what is tracked.
        cameras: how many see it.
        origin: (B,) what the coefficients of the neutral face are called in results.
        kept: of an interrupted run's frames, so many stay.

    Raises:
        ResultError: here and in every method, when a file cannot be written or read, or holds what no run
            wrote.
    """

    def __init__(
        self,
        path: Path,
        config: HeadStereoConfig | HeadMonoConfig,
        subject: Subject,
        cameras: int,
        origin: FloatArray,
        kept: int = 0,
    ) -> None:
        self._path, self._cameras, self._origin = path, cameras, origin
        self._settings, self._model = config.smoothing, track_model(config)
        self._fits = HeadFits(self._model, cameras)
        self._reach = Reach(self._settings.bridge_s)
        self._keeper = FrameKeeper(subject)
        self._spool = RecordSpool(path, kept, self._keeper.blank())

    def remember(self, state: Any, estimate: Estimate) -> None:
        """Keep what is needed of a frame."""
        self._spool.append(self._keeper.frame(state, estimate).record)

    def flush(self) -> None:
        """Wait until everything is on the disk."""
        self._spool.flush()

    def finish(self, writer: ResultWriter) -> None:
        """Write the smoothed track, the first frame first, and forget the frames."""
        path = self._path.with_name(f"{self._path.name}.back")
        describe = partial(posed_frame, cameras=self._cameras)
        smoother = make_head_smoother(self._settings, self._fits)
        with SmoothedTrack[PosedFrame](path, smoother, describe) as track:
            with phase("smoothing, way back", "frame", len(self._spool)) as advance:
                for link, chain, dt, end in self._linked():
                    memory = _memory(link, end, chain)
                    track.remember(self._fits.belief(memory), link.frame.facts, dt, link.begins, memory)
                    advance(1)
            placed = with_places(track.backward(), self._origin)
            with phase("smoothing, way on", "frame", len(track)) as advance:
                for estimate in smoothed_velocities(placed, self._model.velocity):
                    writer.write_smoothed(estimate)
                    advance(1)
            track.delete()
        self._spool.delete()

    def __enter__(self) -> HeadMemory:
        return self

    def __exit__(self, *_: object) -> None:
        """Let the file lie, for a run that is resumed."""
        self._spool.close()

    def _linked(self) -> Iterator[tuple[Link, int, float, HeadFrame]]:
        """Yield frames, the last first, with their chain's number, s to the last one, and the chain's end."""
        chain, end, last_ns = 0, None, 0
        for link in with_speeds(chained(self._frames(), self._reach)):
            frame = link.frame
            if end is None or link.begins:
                chain, end = chain + 1, frame
            dt = 0.0 if link.begins else (last_ns - frame.stamp_ns) / NS_PER_S
            yield link, chain, dt, end
            last_ns = frame.stamp_ns

    def _frames(self) -> Iterator[HeadFrame]:
        """The frames, the last first, each known to be what a run wrote."""
        layouts = self._keeper.layouts()
        for record in reversed(self._spool):
            try:
                check_arrays(record, layouts)
            except LayoutError as error:
                what = "spool cannot be used"
                raise ResultError(what, where=self._path, found=error, hint=RESTART_HINT) from error
            yield HeadFrame.of_record(record)


def _memory(link: Link, end: HeadFrame, chain: int) -> Memory:
    """What fits and places need of a frame, with the face as it was known at its chain's end."""
    frame = link.frame
    return {
        "tracked": np.concatenate([frame.position, frame.quaternion]),
        "points": frame.points,
        "weights": frame.weights,
        "seen": int(not frame.is_lost),
        "chain": chain,
        "speed": link.speed,
        "systematic": frame.systematic,
        "beside": frame.beside,
        "skin_share": frame.skin_share,
        "neutral": end.mean,
        "basis": end.basis,
        "deviations": end.deviations,
    }
