"""What ``view`` writes plays in a browser: every picture in its colours, of its size, as long as it says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.evaluation.viewing.outputs import VideoFile
from support.browser import open_browser

COUNT, RATE, HEIGHT, WIDTH = 10, 10.0, 98, 131
LEVELS = [20 + 20 * number for number in range(COUNT)]
COLOURS = np.array([0.2, 0.6, 1.0])
"""Blue, green and red of a level."""
LOSSES = 6
"""Of plain colours: quantised by crf 20, and rounded as YUV and back."""
PLAYED = """
const done = arguments[arguments.length - 1], video = document.querySelector('video');
const told = (error) => done({error, width: video.videoWidth, height: video.videoHeight,
                              duration: video.duration, pixels: told.pixels});
told.pixels = [];
const canvas = document.createElement('canvas'), context = canvas.getContext('2d');
video.onerror = () => told(video.error.message || 'cannot be played');
const at = (number) => {
  if (number === arguments[0]) { told(null); return; }
  video.requestVideoFrameCallback(() => {  // 'seeked' may come before its picture
    context.drawImage(video, 0, 0);
    told.pixels.push(Array.from(context.getImageData(8, 8, 1, 1).data.slice(0, 3)));
    at(number + 1);
  });
  video.currentTime = (number + 0.5) / arguments[1];
};
if (video.error) told(video.error.message); else if (video.readyState > 0) at(0);
else video.onloadedmetadata = () => at(0);
"""


@pytest.fixture
def page(tmp_path: Path) -> Path:
    video = VideoFile(tmp_path / "v.mp4", RATE)
    for number, level in enumerate(LEVELS):
        video.add(number, np.full((HEIGHT, WIDTH, 3), level * COLOURS, np.uint8))
    video.close()
    path = tmp_path / "page.html"
    path.write_text("<video src='v.mp4' muted preload='auto'></video>")
    return path


def test_a_browser_plays_every_picture_in_its_colours(page: Path, tmp_path: Path) -> None:
    with open_browser(tmp_path / "profile", "--allow-file-access-from-files") as driver:
        driver.get(page.as_uri())
        played: dict[str, Any] = driver.execute_async_script(PLAYED, COUNT, RATE)
    assert played["error"] is None
    assert (played["width"], played["height"]) == (WIDTH + 1, HEIGHT)
    assert played["duration"] == pytest.approx(COUNT / RATE, abs=0.5 / RATE)
    expected = np.outer(LEVELS, COLOURS[::-1])
    assert np.abs(np.array(played["pixels"]) - expected).max() <= LOSSES
