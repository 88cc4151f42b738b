"""Film files: MP4 and GIF."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path

import imageio_ffmpeg
from PIL import Image

from skatemount.utils.errors import ConfigError

GIF_COLORS = 128
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
    """Writes a GIF that is small enough for a README; only every so many pictures of a film are in it.

    Args:
        path: The file.
        rate: Pictures a second of the film.
        size: Width and height of the GIF.
        sample: Picture with the colors of the film; one palette is chosen from it for all pictures.
        hold: Seconds that the last picture is shown before the GIF begins again.

    Raises:
        ConfigError: There is no ffmpeg.
    """

    def __init__(self, path: Path, rate: float, size: tuple[int, int], sample: Image.Image, hold: float):
        self._every = max(1, round(rate / GIF_RATE))
        self._size = size
        self._count = 0
        self._folder = tempfile.TemporaryDirectory()
        palette = Path(self._folder.name) / "palette.png"
        _palette(sample).save(palette)
        command = [
            *("-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"),
            *("-s", f"{size[0]}x{size[1]}", "-r", f"{rate / self._every:.6f}", "-i", "-", "-i", str(palette)),
            # Without dithering the same areas stay the same, and pack well.
            *("-lavfi", "paletteuse=dither=none", "-loop", "0", "-final_delay", f"{100 * hold:.0f}", "-f", "gif"),
            str(path),
        ]
        try:
            program = imageio_ffmpeg.get_ffmpeg_exe()
            self._process = subprocess.Popen([program, *command], stdin=subprocess.PIPE, stderr=subprocess.PIPE)
        except (RuntimeError, OSError) as error:
            self._folder.cleanup()
            raise ConfigError(f"no GIF: {' '.join(str(error).split())}; pip install imageio-ffmpeg") from error

    def add(self, picture: Image.Image) -> None:
        """Take a picture of the film."""
        if self._count % self._every == 0:
            self._write(picture)
        self._count += 1

    def finish(self, last: Image.Image) -> None:
        """Write the last picture, and complete the file.

        Raises:
            ConfigError: ffmpeg failed.
        """
        self._write(last)
        _, said = self._process.communicate()
        if self._process.returncode:
            raise ConfigError(f"no GIF: ffmpeg failed: {' '.join(said.decode(errors='replace').split())}")

    def close(self) -> None:
        """End the program that writes, whether it has finished or not."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()
        self._folder.cleanup()

    def _write(self, picture: Image.Image) -> None:
        assert self._process.stdin is not None
        small = picture.resize(self._size, Image.Resampling.LANCZOS)
        with contextlib.suppress(BrokenPipeError):  # `finish` tells why it ended
            self._process.stdin.write(small.tobytes())


def _palette(sample: Image.Image) -> Image.Image:
    """Return the colors of a picture as the 16 x 16 pixels that ffmpeg reads a palette from."""
    small = sample.convert("RGB").resize((max(1, sample.width // 2), max(1, sample.height // 2)))
    # Unlike the median cut, this keeps the colors of small things such as wheels.
    colors = (small.quantize(GIF_COLORS, method=Image.Quantize.FASTOCTREE).getpalette() or [0, 0, 0])[: 3 * GIF_COLORS]
    colors += colors[:3] * (256 - len(colors) // 3)
    return Image.frombytes("RGB", (16, 16), bytes(colors))
