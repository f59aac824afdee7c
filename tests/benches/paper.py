"""A page on paper: Chromium's PDF of it, and the words on each sheet with their places (poppler)."""

import html
import re
import subprocess
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Page

_SHEET = re.compile(r'<page width="([\d.]+)" height="([\d.]+)">(.*?)</page>', re.DOTALL)
_WORD = re.compile(r'<word xMin="([-\d.]+)" yMin="([-\d.]+)" xMax="([-\d.]+)" yMax="([-\d.]+)">(.*?)</word>')

MARGIN = 12.0 / 25.4 * 72.0 - 1.0
"""The least margin that the pages ask for, less what a letter may protrude; points."""


@dataclass(frozen=True, slots=True)
class PrintedWord:
    """Its text and its box from the sheet's upper left corner, points of 1/72 inch."""

    text: str
    left: float
    top: float
    right: float
    bottom: float


@dataclass(frozen=True, slots=True)
class Sheet:
    """One printed page."""

    width: float
    height: float
    words: tuple[PrintedWord, ...]

    @property
    def text(self) -> str:
        """Its words in their order, without spaces."""
        return "".join(word.text for word in self.words)

    def last_line(self) -> str:
        """The lowest words, without spaces."""
        lowest = max(word.bottom for word in self.words)
        return "".join(word.text for word in self.words if word.bottom > lowest - 2.0)


def printed(page: Page, folder: Path, paper: str) -> list[Sheet]:
    """Print what the browser shows, as a person does: without backgrounds.

    paper: its format, such as A4 or Letter
    """
    file = folder / "page.pdf"
    page.pdf(path=file, format=paper, print_background=False)
    told = subprocess.run(["pdftotext", "-bbox", file, "-"], check=True, capture_output=True, text=True).stdout
    return [
        Sheet(
            float(width),
            float(height),
            tuple(
                PrintedWord(html.unescape(word), float(left), float(top), float(right), float(bottom))
                for left, top, right, bottom, word in _WORD.findall(content)
            ),
        )
        for width, height, content in _SHEET.findall(told)
    ]


def printed_texts(page: Page, selector: str) -> list[str]:
    """The texts that a browser prints; its medium must be `print`."""
    told = "all => all.filter((one) => one.checkVisibility()).map((one) => one.innerText)"
    found: list[str] = page.locator(selector).evaluate_all(told)
    return found


def cut_off(sheets: Sequence[Sheet]) -> list[tuple[int, PrintedWord]]:
    """Words that reach into a margin, and their sheet, from 1."""
    return [
        (n, word)
        for n, sheet in enumerate(sheets, 1)
        for word in sheet.words
        if not (MARGIN <= word.left <= word.right <= sheet.width - MARGIN and word.bottom <= sheet.height - MARGIN)
    ]


def torn(rows: Sequence[str], sheets: Sequence[Sheet]) -> list[str]:
    """Rows whose letters are not all on the same sheet."""
    on = [Counter(sheet.text) for sheet in sheets]
    return [row for row in rows if not any(Counter(_squeezed(row)) <= letters for letters in on)]


def left_alone(headings: Sequence[str], sheets: Sequence[Sheet]) -> list[str]:
    """Headings that end a sheet."""
    ends = [sheet.last_line() for sheet in sheets]
    return [line for line in ends if any(_squeezed(heading).endswith(line) for heading in headings)]


def _squeezed(text: str) -> str:
    """Without spaces, as `Sheet.text`."""
    return "".join(text.split())
