"""Everybody can distinguish the colours that mean something and read the texts on them, in light and dark mode."""

import re
from collections.abc import Mapping
from importlib.resources import files
from itertools import combinations
from typing import Final

import numpy as np
import pytest

from talc.frame import FloatArray

# Differences between two colours for people who see all colours, and for those who do not.


SIGHTS: Final[Mapping[str, FloatArray]] = {
    "all colours": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""Linear sRGB to that which is seen: Machado, Oliveira and Fernandes (2009), severity 1.0."""
_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = np.array([0.95047, 1.0, 1.08883])


def linear(colour: str) -> FloatArray:
    """(3,) linear sRGB of `#rgb` or `#rrggbb`."""
    digits = colour.removeprefix("#")
    digits = "".join(2 * d for d in digits) if len(digits) == 3 else digits
    values = np.array([int(digits[i : i + 2], 16) / 255.0 for i in (0, 2, 4)])
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """By WCAG 2.2: 1 to 21."""
    dark, light = sorted(float(_TO_XYZ[1] @ linear(colour)) for colour in (one, other))
    return (light + 0.05) / (dark + 0.05)


def seen_apart(one: str, other: str, sight: str) -> float:
    """CIEDE2000 of two colours as they are seen."""
    seen = [_lab(np.clip(SIGHTS[sight] @ linear(colour), 0.0, 1.0)) for colour in (one, other)]
    return ciede2000(*seen)


def _lab(rgb: FloatArray) -> FloatArray:
    t = _TO_XYZ @ rgb / _WHITE
    f = np.where(t > 216 / 24389, np.cbrt(t), (24389 / 27 * t + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def ciede2000(one: FloatArray, other: FloatArray) -> float:
    """Difference of two CIELAB colours: Sharma, Wu and Dalal (2005)."""
    chroma = (np.hypot(*one[1:]) + np.hypot(*other[1:])) / 2
    stretch = 1.5 - 0.5 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7))
    (c1, h1), (c2, h2) = (
        (np.hypot(stretch * a, b), np.degrees(np.arctan2(b, stretch * a)) % 360) for _, a, b in (one, other)
    )
    grey = c1 * c2 == 0
    turn = 0.0 if grey else (h2 - h1 + 180) % 360 - 180
    middle = h1 + h2 if grey else (h1 + ((h2 - h1 + 180) % 360 - 180) / 2) % 360
    light, c = (one[0] + other[0]) / 2, (c1 + c2) / 2
    d_hue = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2))
    waves = ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.20, 4, -63))
    t = 1 + sum(size * np.cos(np.radians(times * middle + by)) for size, times, by in waves)
    s_light = 1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2)
    x, y, z = (other[0] - one[0]) / s_light, (c2 - c1) / (1 + 0.045 * c), d_hue / (1 + 0.015 * c * t)
    blue = 60 * np.exp(-(((middle - 275) / 25) ** 2))
    rotation = -2 * np.sqrt(c**7 / (c**7 + 25.0**7)) * np.sin(np.radians(blue))
    return float(np.sqrt(x * x + y * y + z * z + rotation * y * z))


STATES = ("red", "amber", "green", "grey", "away")
MARKS = ("bad", "note", "good")
SERIES = ("before", "after", "measured")
STACK = ("c1", "c2", "c3", "c4", "c6")
"""The parts that moved the tool over the day, one upon the other."""
TEXT_CONTRAST = 4.5
"""WCAG 2.2, 1.4.3 (AA)."""


def colours(dark: bool) -> dict[str, str]:
    """Name to colour, as the style sheet has it."""
    css = files("gateway.listeners.web").joinpath("static", "page.css").read_text(encoding="utf-8")
    light, in_the_dark = (
        dict(re.findall(r"--([\w-]+): (#[0-9a-f]+);", block))
        for block in re.findall(r":root \{(.*?)\}", css, re.DOTALL)[:2]
    )
    return {**light, **in_the_dark} if dark else light


@pytest.mark.parametrize(
    ("one", "other", "known"),
    [  # Sharma, Wu and Dalal (2005), table 1: pairs 1, 4, 7, 10, 15, 17, 24, 25, 31, 34
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0000),
        ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
        ((50.0, 2.4900, -0.0010), (50.0, -2.4900, 0.0010), 7.1792),
        ((50.0, -0.0010, 2.4900), (50.0, 0.0011, -2.4900), 4.7461),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((50.0, 2.5, 0.0), (50.0, 3.2592, 0.3350), 1.0000),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_the_difference_is_that_of_its_published_table(
    one: tuple[float, ...], other: tuple[float, ...], known: float
) -> None:
    assert ciede2000(np.array(one), np.array(other)) == pytest.approx(known, abs=1e-4)


@pytest.mark.parametrize("sight", SIGHTS)
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize(
    ("names", "least"),
    [(STATES, 17.0), (MARKS, 13.0), (SERIES, 15.0), (STACK, 18.0)],
    ids=["states", "marks", "series", "stack"],
)
def test_no_two_colours_are_alike_for_anybody(names: tuple[str, ...], least: float, dark: bool, sight: str) -> None:
    known = colours(dark)
    apart = {(a, b): seen_apart(known[a], known[b], sight) for a, b in combinations(names, 2)}
    assert min(apart.values()) >= least, apart


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_texts_are_read_on_their_ground(dark: bool) -> None:
    known = colours(dark)
    grounds = [(known[f"on-{state}"], known[state]) for state in STATES]
    grounds += [(known[name], known[ground]) for name in (*MARKS, "ink", "soft") for ground in ("paper", "panel")]
    assert {pair: round(contrast(*pair), 2) for pair in grounds if contrast(*pair) < TEXT_CONTRAST} == {}
