"""GIFs as they are written; tests of films read MP4s."""

from __future__ import annotations

import contextlib
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from skatemount.rendering.video import GifWriter
from skatemount.utils.errors import ConfigError

COLORS = [(200, 40, 40), (40, 200, 40), (40, 40, 200), (230, 230, 230), (20, 20, 20)]


def sample() -> Image.Image:
    sheet = Image.new("RGB", (10 * len(COLORS), 20))
    for i, color in enumerate(COLORS):
        sheet.paste(color, (10 * i, 0, 10 * i + 10, 20))
    return sheet


@pytest.mark.parametrize(("rate", "every", "milliseconds"), [(25.0, 2, 80), (12.5, 1, 80), (50.0, 4, 80)])
def test_a_gif_plays_at_the_speed_of_the_film(tmp_path: Path, rate: float, every: int, milliseconds: int) -> None:
    path = tmp_path / "made.gif"
    with contextlib.closing(GifWriter(path, rate, (64, 48), sample(), 0.5)) as gif:
        for i in range(4 * every):
            gif.add(Image.new("RGB", (128, 96), COLORS[i // every]))
        gif.finish(Image.new("RGB", (128, 96), COLORS[4]))
    with Image.open(path) as made:
        assert (made.size, made.n_frames, made.info["loop"]) == ((64, 48), 5, 0)
        for i, color in enumerate(COLORS):
            made.seek(i)
            assert made.info["duration"] == (milliseconds if i < 4 else 500)
            assert np.abs(np.asarray(made.convert("RGB"), int) - color).max() <= 4


def test_a_failing_ffmpeg_is_told_in_one_line(tmp_path: Path) -> None:
    picture = Image.new("RGB", (64, 48))
    with contextlib.closing(GifWriter(tmp_path / "no" / "folder.gif", 25.0, (64, 48), sample(), 0.5)) as gif:
        gif.add(picture)
        with pytest.raises(ConfigError, match="^no GIF: ffmpeg failed: ") as error:
            gif.finish(picture)
    assert "\n" not in str(error.value)


def test_without_ffmpeg_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: str(tmp_path / "nothing"))
    with pytest.raises(ConfigError, match="no GIF: .* pip install imageio-ffmpeg"):
        GifWriter(tmp_path / "made.gif", 25.0, (64, 48), sample(), 0.5)
