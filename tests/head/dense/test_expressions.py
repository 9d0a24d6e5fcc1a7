"""Strengths of expressions from displaced points."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.dense.expressions import BLEND_SHAPES, displacements, strengths
from posetrack_cli.head.dense.points import DENSE_COUNT

NOISE = np.full(DENSE_COUNT, 0.25)


@pytest.mark.parametrize("name", ["jawOpen", "mouthSmileLeft", "browInnerUp", "browDownRight", "mouthPucker"])
def test_a_single_expression_is_found(name):
    which = BLEND_SHAPES.index(name)

    found, sd = strengths(0.8 * displacements()[which], NOISE)

    # the prior pulls by a part of its own standard deviation
    assert found[which] == pytest.approx(0.8, abs=0.15)
    assert found.argmax() == which
    assert (sd > 0.0).all()


def test_strengths_are_not_negative():
    found, _ = strengths(-displacements()[BLEND_SHAPES.index("jawOpen")], NOISE)

    assert (found >= 0.0).all()


def test_unknown_points_widen_the_deviation():
    which = BLEND_SHAPES.index("browInnerUp")
    moved = displacements()[which].copy()
    unknown = np.abs(moved).max(axis=1) > 1.0
    hidden = np.where(unknown[:, None], np.nan, moved)

    _, sd = strengths(moved, NOISE)
    _, sd_hidden = strengths(hidden, NOISE)

    assert sd_hidden[which] > 2.0 * sd[which]
