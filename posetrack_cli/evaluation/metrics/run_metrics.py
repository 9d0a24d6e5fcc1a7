"""What a result says about its run: time, particles, weights."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.metrics.measures import Measures
from posetrack_cli.evaluation.track import Track

NO_TIMINGS = "the run recorded no timings; its option --timings does"
EMPTY = "the result holds no estimate"
NOT_COUNTED = "the result does not say how many poses were evaluated"
NO_WEIGHTS = "the tracker has no weighted particles"


def run_metrics(measures: Measures, track: Track, run: Mapping[str, str]) -> None:
    """Add time per frame, frames/s, evaluations, effective sample size, resampling rate and particles."""
    _timings(measures, track)
    _known(measures, "evaluations", track.evaluations, NOT_COUNTED if len(track) else EMPTY)
    _known(measures, "ess", track.effective_sample_size, NO_WEIGHTS if len(track) else EMPTY)
    resampled = np.empty(0) if track.resampled is None else track.resampled
    if resampled.size:
        measures.metrics["resampling_rate"] = float(resampled.mean())
    else:
        measures.lack(EMPTY, "resampling_rate")
    particles = particle_count(run)
    if particles is None:
        measures.lack("the run record names no number of particles", "particles")
    else:
        measures.metrics["particles"] = float(particles)


def run_series(track: Track) -> dict[str, FloatArray]:
    """Return what a run says about each of its frames, (N,) by metric."""
    columns = {
        "cost_mm": track.cost,
        "confidence": track.confidence,
        "ms_per_frame": track.milliseconds,
        "ess": track.effective_sample_size,
        "evaluations": track.evaluations,
    }
    return {name: values for name, values in columns.items() if values is not None}


def _known(measures: Measures, name: str, values: FloatArray | None, nothing: str) -> None:
    """Summarise the values that are known; where there are none, say why."""
    values = np.empty(0) if values is None else values
    measures.summarise(name, values[np.isfinite(values)], nothing)


def _timings(measures: Measures, track: Track) -> None:
    """Time of the frames that were timed; frames per second is their number over their time together."""
    recorded = np.empty(0) if track.milliseconds is None else track.milliseconds
    timed = recorded[np.isfinite(recorded)]
    if not timed.size:
        return measures.lack(NO_TIMINGS if len(track) else EMPTY, "ms_per_frame", "frames_per_s")
    measures.summarise("ms_per_frame", timed)
    if len(timed) < len(recorded):
        measures.notes.append(f"times of the {len(timed)} of {len(recorded)} frames that were timed")
    total_s = 1e-3 * float(timed.sum())
    if total_s > 0.0:
        measures.metrics["frames_per_s"] = len(timed) / total_s
    else:
        measures.lack("the recorded times are 0", "frames_per_s")


def particle_count(run: Mapping[str, str]) -> int | None:
    """Return the size of the filter or the swarm in a run record's configuration; None where it has none."""
    try:
        configuration = json.loads(run["configuration"])
        if "particles" in configuration:  # a head's
            return int(configuration["particles"]["count"])
        swarm = configuration["filter"].get("kind") == "pso"
        return int(configuration["pso" if swarm else "filter"]["particles"])
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError):
        return None
