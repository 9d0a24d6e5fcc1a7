"""Registry of the kinds of subjects that can be evaluated, one module each."""

from __future__ import annotations

from posetrack_cli.evaluation.measuring.subjects.hand import HAND
from posetrack_cli.evaluation.measuring.subjects.head import HEAD
from posetrack_cli.evaluation.measuring.subjects.kind import SubjectKind

KINDS = {kind.name: kind for kind in (HAND, HEAD)}
"""Kinds by subject name, in catalogue order."""

__all__ = ["KINDS", "SubjectKind"]
