"""The shipped face model's script: it draws what the statistics say, and gives the same bytes again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, POINT_NAMES
from posetrack_cli.head.multilinear.build import cumulative_contribution, distances_by_kind, mirrored
from posetrack_cli.head.multilinear.face_model import SHIPPED, load_face_model
from research.face_model import NEUTRAL, SIDEWAYS, VERTICAL, build, main, motion, read_statistics

MODES_MM = (6.0, 4.0, 3.0)


@pytest.fixture
def statistics(tmp_path: Path) -> Path:
    """A file like the published one, of made-up figures."""
    rng = np.random.default_rng(0)
    directions = np.linalg.qr(rng.standard_normal((30, len(MODES_MM))))[0].T.reshape(-1, 10, 3)
    used = {name for knots in (SIDEWAYS, VERTICAL) for knot in knots.values() for name in knot}
    names = [side for name in sorted(used - {"jawOpen"}) for side in (f"{name}_L", f"{name}_R")]
    contents = {
        "points": POINT_NAMES,
        "mean": MEAN_SHAPE.tolist(),
        "identity_modes": {"standard_deviation": MODES_MM, "direction": directions.tolist()},
        "expressions": {name: (5.0 * rng.standard_normal((10, 3))).tolist() for name in [*names, "jawOpen"]},
    }
    path = tmp_path / "statistics.json"
    path.write_text(json.dumps(contents), encoding="utf-8")
    return path


def test_people_vary_as_the_modes_do(statistics: Path) -> None:
    read = read_statistics(statistics)
    people = read.people(2000, np.random.default_rng(1))
    np.testing.assert_allclose(people[:, EYES].mean(axis=1), 0.0, atol=1e-9)
    negatives = people[:2000] + people[2000:] - 2.0 * people.mean(axis=0)
    np.testing.assert_allclose(negatives, 0.0, atol=1e-9)
    variance = np.sum((people - people.mean(axis=0)) ** 2, axis=(1, 2)).mean()
    centred = read.modes - read.modes[:, EYES].mean(axis=1, keepdims=True)
    # of sums of chi-square about sqrt(2 / 2000) of the largest mode's variance: five of these
    assert variance == pytest.approx(np.sum(centred**2), rel=5.0 * np.sqrt(2.0 / 2000))


def test_motions_pass_through_their_knots(statistics: Path) -> None:
    read = read_statistics(statistics)
    for knots in (SIDEWAYS, VERTICAL):
        rates = list(knots)
        assert rates == sorted(rates) and rates[0] == 0.0 and rates[-1] == 1.0
        for rate, knot in knots.items():
            np.testing.assert_allclose(motion(read, knots, rate), read.face(knot), atol=1e-12)
        middle = motion(read, knots, 0.5 * (rates[0] + rates[1]))
        np.testing.assert_allclose(middle, 0.5 * (read.face(knots[rates[0]]) + read.face(knots[rates[1]])))
    assert not read.face(NEUTRAL).any()


def test_the_same_statistics_give_the_same_bytes(statistics: Path, tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        done = CliRunner().invoke(
            main, [str(statistics), "--out", str(tmp_path / name)], catch_exceptions=False
        )
        assert done.exit_code == 0 and done.output.startswith(f"{tmp_path / name}: rms ")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    model = load_face_model(tmp_path / "a.npz")
    built = build(read_statistics(statistics)).model
    np.testing.assert_allclose(model.core, built.core, atol=1e-9)


def test_the_shipped_model_is_what_the_script_builds(measured_data: Path) -> None:
    built, shipped = build(read_statistics(measured_data / "face10-statistics.json")), load_face_model()
    for name in ("mean", "core", "identity_deviations", "deformation_deviations"):
        # rounded to 1e-9, and another machine's arithmetic differs in the last bits
        np.testing.assert_allclose(getattr(shipped, name), getattr(built.model, name), atol=1e-6)
    assert SHIPPED.stat().st_size < 50_000
    assert distances_by_kind(built.approximations() - built.samples)["all"] < 0.76  # as a prototype had it
    assert cumulative_contribution(built.spectra[1])[4] > 0.99
    assert np.array_equal(mirrored(built.samples), built.samples)
