"""Film files: MP4 and GIF."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path

import imageio_ffmpeg
from PIL import Image

from skatemount.utils.errors import ConfigError

GIF_WIDTH, GIF_COLORS = 480, 128
GIF_RATE = 12.5
"""Pictures a second, at most. The format counts in hundredths of a second."""


@contextlib.contextmanager
def mp4_writer(path: Path, rate: float, size: tuple[int, int]) -> Iterator[Generator[None, bytes | None, None]]:
    """Write an MP4 that every browser plays.

    Args:
        path: The file.
        rate: Pictures a second.
        size: Width and height of the pictures, even numbers.

    Yields:
        A generator that takes each picture as RGB bytes by `send`.

    Raises:
        ConfigError: There is no ffmpeg.
    """
    writer = imageio_ffmpeg.write_frames(
        str(path),
        size,
        fps=rate,
        codec="libx264",
        quality=None,
        macro_block_size=2,
        # The temporary name of the file does not tell its format.
        output_params=["-crf", "23", "-preset", "veryfast", "-f", "mp4", "-movflags", "+faststart"],
    )
    try:
        writer.send(None)
    except (RuntimeError, OSError) as error:
        raise ConfigError(f"no film: {' '.join(str(error).split())}; pip install imageio-ffmpeg") from error
    with contextlib.closing(writer):
        yield writer


class GifWriter:
    """Collects pictures for a GIF that is small enough for a README.

    Args:
        rate: Pictures a second of the film.
    """

    def __init__(self, rate: float):
        self._every = max(1, round(rate / GIF_RATE))
        self._seconds = self._every / rate
        self._pictures: list[Image.Image] = []
        self._count = 0

    def add(self, picture: Image.Image) -> None:
        """Take a picture of the film; only every so many are kept."""
        if self._count % self._every == 0:
            height = round(picture.height * GIF_WIDTH / picture.width)
            self._pictures.append(picture.resize((GIF_WIDTH, height), Image.Resampling.LANCZOS))
        self._count += 1

    def save(self, path: Path, last: Image.Image, hold: float) -> None:
        """Write the file.

        Args:
            path: The file.
            last: The last picture of the film.
            hold: Seconds that it is shown before the GIF begins again.
        """
        self._count = 0
        self.add(last)
        pictures = _same_colors(self._pictures)
        milliseconds = [max(20, round(self._seconds * 100) * 10)] * len(pictures)
        milliseconds[-1] = round(hold * 1000)
        pictures[0].save(
            path, format="gif", save_all=True, append_images=pictures[1:], duration=milliseconds, loop=0, disposal=1
        )


def _same_colors(pictures: Sequence[Image.Image]) -> list[Image.Image]:
    """Return pictures with one palette for all, chosen from some of them; without dithering they pack well."""
    some = pictures[:: max(1, len(pictures) // 6)]
    width, height = pictures[0].size
    sheet = Image.new("RGB", (width, height * len(some)))
    for i, picture in enumerate(some):
        sheet.paste(picture, (0, i * height))
    # Unlike the median cut, this keeps the colors of small things such as wheels.
    palette = sheet.quantize(GIF_COLORS, method=Image.Quantize.FASTOCTREE)
    return [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
