"""Errors are as large as noise and equations say: Monte Carlo against the inverse Schur complement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.head.adjustment.adjuster import Adjuster
from posetrack_cli.head.config import AdjustmentSettings
from support.adjustment_cases import dense, equations_at
from support.adjustment_reference import Case, joined, numeric_jacobian, residual_vector, split
from support.bundles import CAMERA, UNIT_SD, random_bundle, random_model

DRAWS = 300
NOISE_PX = 0.05
"""So small that the linearisation holds: what is left of it is within the bounds of the draws."""
SETTINGS = AdjustmentSettings(
    prior=1.0,
    huber=1e6,
    bound=1e6,
    offsets=False,
    pixel_sd=UNIT_SD.model_copy(update=dict.fromkeys(("eyes", "mouth", "nostrils", "brows"), NOISE_PX)),
)


def estimates(bundle):
    """(DRAWS, S) whitened s, estimated from the views with noise."""
    rng, model = np.random.default_rng(8), bundle.model
    found = []
    for _ in range(DRAWS):
        views = tuple(
            replace(view, pixels=view.pixels + NOISE_PX * rng.normal(size=(10, 2))) for view in bundle.views
        )
        adjuster = Adjuster(model, bundle.camera, SETTINGS)
        found.append(adjuster.adjust(views, bundle.person, iterations=20, wide=True))
    return np.array([one.person.identity / model.identity_deviations for one in found])


def covariances(case):
    """Covariance (S, S) of u that noise makes, H^-1 J'J H^-1, and the posterior's, (J'J + P)^-1.

    H is F's own Hessian, which along the valley of c s, a / c differs from that of Gauss-Newton.
    """
    start, part, problem = case.start, case.everything, case.problem
    x = joined(start, part)
    J = numeric_jacobian(lambda x: residual_vector(case, split(x, start)), x)
    hessian = numeric_jacobian(lambda x: dense(equations_at(problem, split(x, start), part))[1], x)
    who = slice(start.local.size, start.local.size + 10)
    data, inverse = J[: 20 * len(case.views)], np.linalg.inv(hessian)
    return (inverse @ data.T @ data @ inverse.T)[who, who], np.linalg.inv(J.T @ J)[who, who]


def test_errors_scatter_as_the_noise_predicts():
    bundle = random_bundle(41, 6)
    adjuster = Adjuster(bundle.model, bundle.camera, SETTINGS)
    found = adjuster.adjust(bundle.views, bundle.person, iterations=200, wide=True)
    case = Case(found.views, found.person, bundle.model, bundle.camera, SETTINGS)
    over_noise, posterior = covariances(case)
    covariance = np.cov(estimates(bundle).T)
    # trace(C^-1 S) / S' of the sample covariance S: chi^2 with (draws - 1) S' degrees of freedom
    ratio = np.trace(np.linalg.solve(over_noise, covariance)) / 10
    assert abs(ratio - 1.0) < 4.0 * np.sqrt(2.0 / ((DRAWS - 1) * 10))
    # and each by itself, within the spread of a sample variance
    own = np.diag(covariance) / np.diag(over_noise)
    assert np.abs(own - 1.0).max() < 4.0 * np.sqrt(2.0 / (DRAWS - 1))
    reported = (found.identity_deviations / bundle.model.identity_deviations) ** 2
    np.testing.assert_allclose(reported, np.diag(posterior), rtol=1e-5)


def test_deviations_hold_over_people_and_noise():
    """Over people from the prior, seen with noise, errors over reported deviations have variance 1."""
    model, errors = random_model(42), []
    rng = np.random.default_rng(9)
    wide_noise = SETTINGS.model_copy(
        update={
            "pixel_sd": UNIT_SD.model_copy(update={"eyes": 0.7, "mouth": 0.7, "nostrils": 0.7, "brows": 0.7})
        }
    )
    for seed in range(150):
        bundle = random_bundle(seed, 5, CAMERA, model=model, spread=np.inf)
        views = tuple(
            replace(view, pixels=view.pixels + 0.7 * rng.normal(size=(10, 2))) for view in bundle.views
        )
        found = Adjuster(model, CAMERA, wide_noise).adjust(views, bundle.person, iterations=20, wide=True)
        errors.append((found.person.identity - bundle.person.identity) / found.identity_deviations)
    mean_square = np.mean(np.square(errors))
    # The ten errors of a person are correlated: as if they were three. The noise bends the equations by some
    # ten per cent more.
    assert abs(mean_square - 1.0) < 4.0 * np.sqrt(2.0 / (150 * 3)) + 0.1


def test_more_views_tell_more():
    bundle = random_bundle(43, 20)
    adjuster = Adjuster(bundle.model, CAMERA, SETTINGS)
    deviations = [
        adjuster.adjust(bundle.views[:n], bundle.person, iterations=5, wide=True).identity_deviations
        for n in (2, 5, 20)
    ]
    assert np.all(deviations[0] > deviations[1]) and np.all(deviations[1] > deviations[2])
    assert np.all(deviations[0] < bundle.model.identity_deviations)
