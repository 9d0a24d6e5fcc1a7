"""For how many frames of a run a file of keypoints had any."""

from __future__ import annotations

from posetrack_cli.recording.keypoints.sets import KeypointSets


class KeypointUse:
    """Counts for which frames of a run there are keypoints.

    Args:
        name: of the file.
        sets: what it holds.
        what: they are called.
    """

    def __init__(self, name: str, sets: KeypointSets, what: str = "keypoints") -> None:
        self._name, self._sets, self._what = name, sets, what
        self._frames, self._told = 0, 0

    def see(self, index: int, stamp_ns: int) -> None:
        """Count a frame."""
        rows = self._sets.of(index, stamp_ns)
        self._frames += 1
        self._told += int(rows.stop > rows.start)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to say at the end, in one line: most frames have none, so perhaps they are matched wrongly."""
        if 2 * self._told >= self._frames:
            return ()
        by = "by stamps, to 10 ms" if self._sets.by_stamp else "by number, counted from 0"
        return (f"{self._name} has {self._what} for {self._told} of {self._frames} frames, matched {by}",)
