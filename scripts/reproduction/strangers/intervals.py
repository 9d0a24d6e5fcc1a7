"""Results that were tracked with the person's own mesh, measured with the bones that the run had."""

from __future__ import annotations

import tempfile
from contextlib import chdir
from pathlib import Path

from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.evaluation import Evaluation
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import ARM, EXACT, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tool import draw


def evaluation_with_bones(person: Person, options: Options, measured: Measured) -> Evaluation | None:
    """Return a person's result with the exact mesh, measured with the intervals of its joints; None without.

    ``posetrack eval`` takes the bones from the mesh, for which it looks in the working folder, too: the mesh
    is drawn once more, with as few frames as can be.
    """
    task = options.task(person, ARM, EXACT)
    if measured.evaluation(task, EXACT, EvalOptions()) is None:
        return None
    result = task.result(measured.folder, EXACT).resolve()
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        draw(options.tool.resolve(), Path(folder), person.recording(1))
        return evaluate(result)
