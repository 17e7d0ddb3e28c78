"""What is written in the corner of a film's frames: the time, what is shown, and what the drawn lines mean."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lieednn_sim.rendering.overlay import PLANNED_COLOUR, TRACED_COLOUR

_INK, _PANEL = (255, 255, 255, 255), (20, 26, 33, 150)
# Height of the letters as a share of the frame's; smaller ones are not readable.
_SHARE, _SMALLEST = 1.0 / 34.0, 9
# A frame below this height [pixels] has no room for words.
_LEAST_HEIGHT = 160
# What the colours of `Overlay` mean.
KEY = ((PLANNED_COLOUR, "planned"), (TRACED_COLOUR, "travelled"))


def write_caption(image: NDArray[np.uint8], lines: Sequence[str]) -> NDArray[np.uint8]:
    """A copy of a frame ``(height, width, 3)`` with lines of text and the key of colours in its upper left corner.

    Frames too small for readable letters are returned as they are.
    """
    height = image.shape[0]
    if height < _LEAST_HEIGHT:
        return image
    size = max(_SMALLEST, round(_SHARE * height))
    font, step, margin = _font(size), round(1.35 * size), round(0.7 * size)
    widths = [font.getlength(line) for line in lines]
    widths.append(sum(font.getlength(text) + 3.0 * size for _, text in KEY))
    picture = Image.fromarray(image)
    draw = ImageDraw.Draw(picture, "RGBA")
    corner = (margin + max(widths) + 2 * margin, margin + step * (len(lines) + 1) + margin)
    draw.rounded_rectangle([margin, margin, *corner], radius=margin // 2, fill=_PANEL)
    x, y = 2.0 * margin, 1.5 * margin
    for line in lines:
        draw.text((x, y), line, font=font, fill=_INK)
        y += step
    for colour, text in KEY:
        middle = y + 0.6 * size
        draw.line([x, middle, x + 1.2 * size, middle], fill=_bright(colour), width=max(2, size // 4))
        draw.text((x + 1.6 * size, y), text, font=font, fill=_INK)
        x += font.getlength(text) + 3.0 * size
    return np.asarray(picture)


def _bright(colour: tuple[float, ...]) -> tuple[int, ...]:
    return (*(round(255 * share) for share in colour[:3]), 255)


@functools.cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size)
