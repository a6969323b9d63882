"""Draws a bent vine in a few lines of text: braille dots, or plain ASCII."""

from __future__ import annotations

import math

from flying_vines.vine.shape import axis

COLUMNS, LINES = 18, 7
_WIDE, _HIGH = 2 * COLUMNS, 4 * LINES
"""A braille character is two dots wide and four high."""
_BASE = (13, 5)
"""The vine's base at the drone, in dots from the left and the top. It bends to the right."""
_LENGTH = 21
_HALF_WIDTH = 1.5
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))


def sketch(angle_deg: float, unicode: bool = True) -> list[str]:
    """Lines of equal width: a drone with the vine under it; only the drone if the bend is unknown."""
    dots = {(x, 3) for x in range(4, 24)} | {(x, 4) for x in range(11, 17)}
    dots |= {(x, 0) for x in (*range(1, 9), *range(19, 27))} | {
        (x, y) for x in (4, 5, 22, 23) for y in (1, 2)
    }
    if not math.isnan(angle_deg):
        dots |= _vine(angle_deg)
    return [_line(dots, row, unicode).rstrip().ljust(COLUMNS) for row in range(LINES)]


def _vine(angle_deg: float) -> set[tuple[int, int]]:
    dots = set()
    for point in axis(angle_deg, _LENGTH, pieces=4 * _LENGTH):
        for side in (-_HALF_WIDTH, -_HALF_WIDTH / 3, _HALF_WIDTH / 3, _HALF_WIDTH):
            x = _BASE[0] + 0.5 + point.x_m + side * math.cos(point.heading_rad)
            y = _BASE[1] + point.y_m - side * math.sin(point.heading_rad)
            if 0 <= x < _WIDE and _BASE[1] <= y < _HIGH:
                dots.add((int(x), int(y)))
    return dots


def _line(dots: set[tuple[int, int]], row: int, unicode: bool) -> str:
    text = ""
    for column in range(COLUMNS):
        code = sum(
            bit
            for y, bits in enumerate(_DOTS)
            for x, bit in enumerate(bits)
            if (2 * column + x, 4 * row + y) in dots
        )
        filled = chr(0x2800 + code) if unicode else "#"
        text += filled if code else " "
    return text
