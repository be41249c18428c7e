"""Write frames as an animation."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import imageio_ffmpeg
import numpy as np
from PIL import Image

COLORS = 96
"""Colours of a GIF's palette; all frames share one, so that still areas stay the same and take no space."""


def write_gif(file: IO[bytes], frames: Iterable[np.ndarray], seconds_per_frame: float, hold: float) -> None:
    """Write an endless GIF.

    Args:
      file: what is written to.
      frames: at least one, each `[height, width, 3]`, uint8.
      seconds_per_frame: s.
      hold: how much longer the last frame stands [s].
    """
    images = [Image.fromarray(frame) for frame in frames]
    palette = _shared_palette(images)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations = [round(1000 * seconds_per_frame)] * len(images)
    durations[-1] += round(1000 * hold)
    images[0].save(file, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0, optimize=False)


def _shared_palette(images: list[Image.Image]) -> Image.Image:
    """A palette for the first, the middle and the last image."""
    chosen = [images[0], images[len(images) // 2], images[-1]]
    strip = Image.new("RGB", (images[0].width, 3 * images[0].height))
    for row, image in enumerate(chosen):
        strip.paste(image, (0, row * image.height))
    return strip.quantize(COLORS, method=Image.Quantize.MEDIANCUT)


def write_mp4(file: IO[bytes], frames: Iterable[np.ndarray], seconds_per_frame: float, hold: float) -> None:
    """Write an H.264 film; arguments as for `write_gif`, width and height even."""
    shown = list(frames)
    shown += shown[-1:] * round(hold / seconds_per_frame)
    height, width, _ = shown[0].shape
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{1.0 / seconds_per_frame:g}"]
    encoded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-loglevel", "error"]
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        encoder = [imageio_ffmpeg.get_ffmpeg_exe(), *raw, "-i", "-", *encoded, str(film)]
        subprocess.run(encoder, input=np.stack(shown).tobytes(), check=True)
        file.write(film.read_bytes())
