"""The documentation's site builds without a warning, loads nothing from elsewhere, is searched, and fits on paper."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.benches.page_rig import LIMIT_MS, chromium

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the whole site."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    )
    assert done.returncode == 0, done.stderr
    return folder


def type_in(page: Page, words: str) -> None:
    """Look for words as a reader does: the search hears keys."""
    field = page.locator("input.md-search__input")
    field.fill("")
    field.press_sequentially(words)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as started:
        yield started


@pytest.mark.peer
@pytest.mark.slow
def test_a_page_opened_as_a_file_finds_words_and_options(site: Path, browser: Browser) -> None:
    with browser.new_context(offline=True) as context:
        page = context.new_page()
        page.set_default_timeout(LIMIT_MS)
        page.goto((site / "index.html").as_uri())
        titles, count = page.locator(".md-search-result__link h1"), page.locator(".md-search-result__meta")
        library = (ROOT / "docs" / "library.md").read_text("utf-8").splitlines()[0]
        type_in(page, "GroupLassoARX")
        expect(titles).to_have_text([library.removeprefix("# ")], timeout=LIMIT_MS)
        for option in ("--time-format", "replay --time-format"):
            type_in(page, "wordthatnopagehas")
            expect(count).to_have_text("No matching documents", timeout=LIMIT_MS)
            type_in(page, option)
            expect(count).to_have_text(re.compile(r"^\d+ matching"), timeout=LIMIT_MS)


@pytest.mark.peer
@pytest.mark.slow
@pytest.mark.parametrize("sheet", ["operator-sheet", "fitter-sheet"])
def test_a_sheet_to_print_is_one_page(site: Path, browser: Browser, sheet: str) -> None:
    with browser.new_context(offline=True) as context:
        page = context.new_page()
        page.goto((site / f"{sheet}.html").as_uri(), timeout=LIMIT_MS)
        printed = [page.pdf(format=paper) for paper in ("A4", "Letter")]
    assert [len(re.findall(rb"/Type */Page\b", each)) for each in printed] == [1, 1]


@pytest.mark.slow
def test_the_site_builds_strictly_and_needs_no_network(site: Path) -> None:
    pages = {page.relative_to(ROOT / "docs").with_suffix("") for page in (ROOT / "docs").glob("**/*.md")}
    assert pages <= {page.relative_to(site).with_suffix("") for page in site.rglob("*.html")}
    api = (site / "library.html").read_text(encoding="utf-8")
    assert all(f'id="talc.{name}"' in api for name in ("Learner", "Learner.predict", "rehearse", "GroupLassoARX"))
    assert (site / "troubleshooting.html").read_text(encoding="utf-8").count("<li>") > 150, "the catalogue's messages"
    notebook = (site / "notebooks" / "own_recording.html").read_text(encoding="utf-8")
    assert "no correction, µm" in notebook, "what its cells printed"
    # A page opened as a file may neither fetch the index nor start a worker: both come as scripts beside it.
    index = (site / "search" / "search_index.js").read_text(encoding="utf-8")
    assert any("offsets" in entry["text"] for entry in json.loads(index.removeprefix("var __index = "))["docs"])
    home = (site / "index.html").read_text(encoding="utf-8")
    for script in re.findall(r'<script src="([^"]+)"', home):
        assert (site / script).is_file(), script
    assert '<script src="assets/javascripts/iframe-worker.js">' in home
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert re.findall(r"<(?:script|link|img)[^>]* (?:src|href)=\"?(https?://[^\"> ]+)", text) == []
