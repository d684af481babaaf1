"""Films: their duration."""

import numpy as np
import pytest
from PIL import Image

from burrlab.view.film import write_video


@pytest.mark.parametrize("fps", [1.0, 29.97, 35.0, 50.0])
def test_a_gif_lasts_as_long_as_its_frames(tmp_path, fps):
    """Each frame lasts whole hundredths of a second, none less than browsers show it."""
    frames = [np.full((16, 16, 3), 50 * (i % 4), np.uint8) for i in range(60)]
    assert write_video(tmp_path / "a.gif", frames, fps=fps) == 60
    shown = []
    with Image.open(tmp_path / "a.gif") as film:
        for i in range(film.n_frames):
            film.seek(i)
            shown.append(film.info["duration"])
    assert sum(shown) == pytest.approx(60 * 1000 / fps, abs=5)
    assert min(shown) >= 20
    assert max(shown) - min(shown) <= 10


def test_a_gif_of_one_picture(tmp_path):
    assert write_video(tmp_path / "a.gif", [np.zeros((16, 16, 3), np.uint8)], fps=35.0) == 1
