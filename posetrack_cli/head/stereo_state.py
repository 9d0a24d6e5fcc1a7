"""A stereo tracker's state, and what of it another tracker can begin with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from posetrack_cli.head.ccipca import Ccipca
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.face import POINT_COUNT
from posetrack_cli.head.following import Following
from posetrack_cli.head.learning import FaceLearning, known_face
from posetrack_cli.head.model_file import unusable
from posetrack_cli.head.start.search import Search
from posetrack_cli.head.state_codecs import following_codec, search_codec, template_codec
from posetrack_cli.head.templates import TemplateSet
from posetrack_cli.results.layouts import Arrays, LayoutError, counts, floats
from posetrack_cli.tracking.state_codec import Array, Codec, Fields, Maybe, Stacked, Value, real, whole
from posetrack_cli.tracking.two_pass import Learned


@dataclass(frozen=True, eq=False)
class StereoState:
    """What a stereo tracker knows after a frame.

    Attributes:
        face: what was learnt of the face; None before it is first found.
        sets: templates, reference first; empty before.
        following: the head when it was last tracked; None before.
        lost: frames in a row, up to the last one, in which it was not.
        search: what looking for the face came to before it was first found.
    """

    face: FaceLearning | None = None
    sets: tuple[TemplateSet, ...] = ()
    following: Following | None = None
    lost: int = 0
    search: Search = field(default_factory=Search)


class StereoCodecs:
    """How a stereo tracker's states and what they have learned become arrays.

    Args:
        cameras: how many there are.
        settings: of the face's model.
    """

    def __init__(self, cameras: int, settings: ModelSettings) -> None:
        face, sets = _face_codec(settings), Stacked(template_codec(cameras), "sets")
        needed = Stacked(template_codec(cameras), "sets", least=1)
        self._known: Codec[StereoState] = Fields(StereoState, face=face, sets=needed)
        learned: dict[str, Codec[Any]] = {"search": search_codec(cameras), "face": Maybe(face), "sets": sets}
        self._learned: Codec[StereoState] = Fields(StereoState, **learned)
        following = Maybe(following_codec(cameras))
        self.state: Codec[StereoState] = Fields(_state, **learned, following=following, lost=whole())

    def learned(self, state: StereoState) -> Learned:
        """Return what was learned, as model files have it: face, templates, and how it was searched for."""
        return self._learned.to_arrays(state)

    def known(self, learned: Arrays) -> StereoState:
        """Return the state that begins with a face and templates that another tracker has learned.

        Raises:
            ResultError: arrays are missing, or not what a stereo tracker with so many cameras learns.
        """
        try:
            return self._known.from_arrays(learned)
        except LayoutError as error:
            raise unusable(error, "what --save-model wrote of a stereo run") from error


def _state(**parts: Any) -> StereoState:
    """A head is only followed once its face is known, and a face is known with its templates."""
    state = StereoState(**parts)
    known = (state.face is not None, bool(state.sets))
    if known != (True, True) and (any(known) or state.following is not None):
        raise LayoutError("a head that is followed, without its face or its templates")
    return state


def _face_codec(settings: ModelSettings) -> Codec[FaceLearning]:
    def face(mean: Array, components: Array, variance: float, counts: Array) -> FaceLearning:
        count, learnt, frames = (int(value) for value in counts)
        return known_face(Ccipca(mean, components, variance, count, learnt), frames, settings)

    return Fields(
        face,
        mean=("statistics.mean", Value(floats(POINT_COUNT, 3))),
        components=("statistics.components", Value(floats("components", 3 * POINT_COUNT))),
        variance=("statistics.variance", real(floats(least=0.0))),
        counts=(lambda one: [one.statistics.count, one.statistics.learnt, one.frames], Value(counts(3))),
    )
