"""Adjustment problems in the middle of being solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.head.adjustment.problem import deformation_basis, linearise, make_equations, make_rows
from posetrack_cli.head.config import AdjustmentSettings
from support.adjustment_reference import Case
from support.bundles import LENSES, moved_away, noisy, random_bundle

QUADRATIC = AdjustmentSettings(huber=1e6, prior=1.7)
ROBUST = AdjustmentSettings(prior=1.7)


def case_of(lens="no lens", settings=QUADRATIC, count=3):
    bundle = noisy(random_bundle(11, count, LENSES[lens], offset_mm=1.0), 1.0, 3)
    views, person = moved_away(bundle, 3, 0.5)
    weights = np.random.default_rng(4).uniform(0.2, 1.0, (count, 10))
    views = tuple(replace(view, weights=w) for view, w in zip(views, weights, strict=True))
    return Case(views, person, bundle.model, bundle.camera, settings)


def somewhere(case):
    """Unknowns away from the start, turned by more than the series is used for."""
    rng, start = np.random.default_rng(5), case.start
    start.local[:, :3] += rng.normal(size=(len(case.views), 3))
    start.local[:, 3:6] += 0.1 * rng.normal(size=(len(case.views), 3))
    start.local[:, 6:] += 0.3 * rng.normal(size=start.local[:, 6:].shape)
    start.shared[:] += 0.3 * rng.normal(size=start.shared.shape)
    return start


def equations_at(problem, unknowns, part):
    equations, rows = make_equations(part), make_rows(problem)
    deformation_basis(problem, unknowns.shared, rows.deformations)
    linearise(problem, unknowns, part, rows, equations)
    return equations


def dense(equations):
    """The whole symmetric matrix and gradient, from the blocks."""
    views, m, q = equations.cross.shape
    matrix = np.zeros((views * m + q, views * m + q))
    for i in range(views):
        own = slice(i * m, (i + 1) * m)
        matrix[own, own] = np.tril(equations.local[i])
        matrix[views * m :, own] = equations.cross[i].T
    matrix[views * m :, views * m :] = np.tril(equations.shared)
    matrix += np.tril(matrix, -1).T
    return matrix, np.concatenate([equations.local_gradient.ravel(), equations.shared_gradient])
