"""Evaluations made up for tests of what is made from them: tables, gates, reports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.evaluation.measuring.evaluation import Count, Curve, Evaluation, distribution, statistics
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames
from posetrack_cli.evaluation.reading.tracks import Coverage, Pairs
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from support.tracks import hand_track


def hand_evaluation(name: str = "a", frames: int = 300, error_mm: float = 5.0, **changes: Any) -> Evaluation:
    """A hand's evaluation against truth, consistent in itself; ``changes`` replace attributes."""
    truth = hand_track("truth", frames, 0.0)
    track = hand_track(name, frames, error_mm, seed=sum(name.encode()))
    assert track.points is not None
    assert truth.points is not None
    errors = np.linalg.norm(track.points - truth.points, axis=2)
    largest = errors.max(axis=1)
    thresholds = np.arange(0.0, 101.0)
    share = (largest[:, None] < thresholds).mean(axis=0)
    rows = np.arange(frames, dtype=np.int64)
    wholes = {"joint_error_mm": errors, "largest_joint_error_mm": largest}
    distributions = {base: distribution(of, statistics(of)) for base, of in wholes.items()} if frames else {}
    values: dict[str, Any] = {
        "name": name,
        "path": Path(f"{name}.mcap"),
        "subject": "hand",
        "run": {"tracker": "hand", "seed": "1", "configuration": "{}", "renderer": "llvmpipe"},
        "coverage": Coverage(frames, frames, 0, 0, 0, 0, 0, True, frames),
        "metrics": {
            "coverage": 1.0,
            "joint_error_mm": statistics(errors),
            "joint_error_mm.index_tip": statistics(errors[:, JOINT_NAMES.index("index_tip")]),
            "largest_joint_error_mm": statistics(largest),
            "frames_within_20mm": float((largest < 20).mean()),
        },
        "absent": {"velocity_error_mm_s": "the truth has no velocity"},
        "series": {"joint_error_mm": errors.mean(axis=1), "largest_joint_error_mm": largest},
        "series_stamp_ns": track.stamp_ns,
        "curve": Curve(thresholds, share, share),
        "notes": (),
        "losses": (),
        "track": track,
        "truth": truth,
        "pairs": Pairs(rows, rows),
        "counts": {"frames_within_20mm": Count(int((largest < 20).sum()), frames)},
        "distributions": distributions,
        "judged": JudgedFrames(
            confidence=np.where(np.arange(frames) % 4 == 0, 0.65, 0.85),
            right=errors.mean(axis=1) <= np.median(errors.mean(axis=1)),
            far=errors.mean(axis=1) > np.percentile(errors.mean(axis=1), 90),
            lost=np.zeros(frames, dtype=np.bool_),
            right_if="mean joint error at most the median",
            far_if="mean joint error above nine tenths",
        ),
    }
    return Evaluation(**{**values, **changes})
