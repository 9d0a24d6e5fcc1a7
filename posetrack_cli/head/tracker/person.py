"""What is known of the person before a camera, and how a frame adds to it (thesis, 4.3.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.adjustment.adjuster import Adjuster
from posetrack_cli.head.adjustment.views import Album, PersonParameters, PointView, choose_views
from posetrack_cli.head.face.shape_model import ShapeModel
from posetrack_cli.head.face.templates import TemplateSet
from posetrack_cli.head.multilinear.face_model import FaceModel

USUAL_RATE = 0.05
"""Share of a frame in the running mean of scores: twenty frames, longer than a blink or a word, count."""


@dataclass(frozen=True, eq=False)
class KnownPerson:
    """One person as far as frames have told.

    Attributes:
        person: identity and offsets.
        history: of identities, (4.36).
        views: n frames that are adjusted together.
        album: frames that show the face from all sides, for an adjustment over the whole recording.
        shape: how this person's face deforms.
        sets: templates, reference first.
        adjusted_frames: how many frames the person was adjusted from.
        rms_px: of the last adjustment, root mean square.
        usual_score: running mean of the scores of tracked frames; NaN before the first.
    """

    person: PersonParameters
    history: IdentityHistory
    views: tuple[PointView, ...]
    album: Album
    shape: ShapeModel
    templates: tuple[TemplateSet, ...]
    adjusted_frames: int = 0
    rms_px: float = np.nan
    usual_score: float = np.nan

    def with_score(self, score: float) -> KnownPerson:
        """Return what is known after a frame with a score."""
        before = score if np.isnan(self.usual_score) else self.usual_score
        return replace(self, usual_score=before + USUAL_RATE * (score - before))

    def after(self, view: PointView, score: float, adjuster: Adjuster) -> KnownPerson:
        """Return what is known after a frame; ``views`` then ends with that frame, adjusted.

        Args:
            view: the frame, its pose and deformation as the filter has them.
            score: mean correlation of its points.
            adjuster: of views of that camera.
        """
        settings = adjuster.settings
        views = choose_views(self.views, view, settings.views)
        start = PersonParameters(self.history.mean, self.person.offsets)
        adjusted = adjuster.adjust(views, start, iterations=settings.iterations, deviations=False)
        return replace(
            self,
            person=adjusted.person,
            history=self.history.with_identity(adjusted.person.identity),
            views=adjusted.views,
            album=self.album.with_view(adjusted.views[-1], score),
            shape=person_shape(adjuster.model, adjusted.person),
            adjusted_frames=self.adjusted_frames + 1,
            rms_px=rms(adjusted.residuals),
        )

    def over_album(self, adjuster: Adjuster) -> KnownPerson:
        """Return the person adjusted from the whole album, for a second pass **[ours]**."""
        views, settings = self.album.views, adjuster.settings
        if settings.when != "always" or len(views) < 2:
            return self
        adjusted = adjuster.adjust(views, self.person, iterations=settings.start_iterations, wide=True)
        return replace(
            self,
            person=adjusted.person,
            history=IdentityHistory.starting_with(adjusted.person.identity, settings.average),
            views=(),
            album=Album(),
            shape=person_shape(adjuster.model, adjusted.person),
            rms_px=rms(adjusted.residuals),
        )


def new_person(person: PersonParameters, reference: TemplateSet, adjuster: Adjuster) -> KnownPerson:
    """Return what is known of a person who was just found, or whom another tracker has learned."""
    history = IdentityHistory.starting_with(person.identity, adjuster.settings.average)
    return KnownPerson(person, history, (), Album(), person_shape(adjuster.model, person), (reference,))


def person_shape(model: FaceModel, person: PersonParameters) -> ShapeModel:
    """Return how a person's face deforms."""
    return model.of_person(person.identity, person.offsets)


def rms(residuals: FloatArray) -> float:
    """Return the root mean square of distances, NaN left out; NaN of none."""
    known = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


@dataclass(frozen=True, eq=False)
class IdentityHistory:
    """The last N_s identities; ``identities`` and ``size`` are all that a checkpoint must keep.

    Attributes:
        identities: (m, S), 1 <= m <= N_s, the newest last.
        size: N_s.
    """

    identities: FloatArray
    size: int

    @classmethod
    def starting_with(cls, identity: FloatArray, size: int) -> IdentityHistory:
        """Return a history that begins with one identity (S,) and keeps ``size`` of them."""
        return cls(np.array(identity, dtype=np.float64)[None], size)

    def with_identity(self, identity: FloatArray) -> IdentityHistory:
        """Return the history after another adjustment; the oldest goes where there are too many."""
        return replace(self, identities=np.vstack([self.identities, identity])[-self.size :])

    @property
    def mean(self) -> FloatArray:
        """(S,) start of the next adjustment, (4.36)."""
        mean: FloatArray = self.identities.mean(axis=0)
        return mean

    @property
    def spread(self) -> FloatArray:
        """(S,) standard deviations about the mean: how far estimates still wander; 0 of one."""
        spread: FloatArray = self.identities.std(axis=0)
        return spread
