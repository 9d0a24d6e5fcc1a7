"""The kinds of subjects that can be measured; a new one is stated in a module of its own and listed here."""

from __future__ import annotations

from posetrack_cli.evaluation.measuring.subjects.hand import HAND
from posetrack_cli.evaluation.measuring.subjects.head import HEAD
from posetrack_cli.evaluation.measuring.subjects.kind import SubjectKind

KINDS = {kind.name: kind for kind in (HAND, HEAD)}
"""By the subject's name, in the order of the catalogue."""

__all__ = ["KINDS", "SubjectKind"]
