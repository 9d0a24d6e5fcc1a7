"""Lengths of a face and what is usual for a person."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.dense.lengths import GAP, LENGTH_NAMES, LIDS, UNKNOWN_PERSON, Lengths, lengths_of
from posetrack_cli.head.dense.points import DENSE_COUNT, rows

COUNT = len(LENGTH_NAMES)


def _person(values, frames):
    person = UNKNOWN_PERSON
    for _ in range(frames):
        person = person.after(Lengths(values, np.ones(COUNT)))
    return person


def test_lip_gap_and_its_deviation():
    places = np.zeros((DENSE_COUNT, 3))
    places[rows(66)] = [0.0, -3.0, 4.0]
    covariances = np.broadcast_to(np.diag([9.0, 1.0, 4.0]), (DENSE_COUNT, 3, 3))

    found = lengths_of(places, covariances)

    assert found.values[GAP] == pytest.approx(5.0)
    # both ends have the variance along the gap, (0, .6, -.8)
    assert found.deviations[GAP] == pytest.approx(np.sqrt(2.0 * (0.36 * 1.0 + 0.64 * 4.0)))


def test_unknown_point_makes_its_lengths_unknown():
    places = np.zeros((DENSE_COUNT, 3))
    places[rows(37)] = np.nan

    found = lengths_of(places, np.zeros((DENSE_COUNT, 3, 3)))

    assert np.isnan(found.values[LENGTH_NAMES.index("right_lid")])
    assert not np.isnan(found.values[LENGTH_NAMES.index("left_lid")])


def test_a_person_becomes_certain_with_frames():
    values = UNKNOWN_PERSON.rest + 2.0

    few, many = _person(values, 10), _person(values, 600)

    assert (np.abs(many.rest - values) < 0.5).all()
    assert (many.rest_sd < few.rest_sd).all()
    assert (few.rest_sd < UNKNOWN_PERSON.rest_sd).all()


def test_blinks_do_not_move_the_open_lids():
    open_lids, shut = np.full(COUNT, 9.0), np.full(COUNT, 1.0)
    person = _person(open_lids, 200)
    for _ in range(40):
        person = person.after(Lengths(shut, np.ones(COUNT)))

    np.testing.assert_allclose(person.rest[LIDS], 9.0, atol=0.5)


def test_unknown_lengths_teach_nothing():
    person = UNKNOWN_PERSON.after(Lengths(np.full(COUNT, np.nan), np.full(COUNT, np.nan)))

    np.testing.assert_array_equal(person.histogram, UNKNOWN_PERSON.histogram)
