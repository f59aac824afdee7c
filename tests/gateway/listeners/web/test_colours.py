"""Everybody can distinguish the colours that mean something and read the texts on them, in light and dark mode."""

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest

from tests.benches.colour_vision import SIGHTS, ciede2000, contrast, seen_apart

STATES = ("red", "amber", "green", "grey")
MARKS = ("bad", "note", "good")
SERIES = ("before", "after", "measured")
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
    ("names", "least"), [(STATES, 17.0), (MARKS, 13.0), (SERIES, 15.0)], ids=["states", "marks", "series"]
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
