"""Every page of the documentation wraps its prose at the code's width, and its links resolve."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benches.page_rig import SCREENS

ROOT = Path(__file__).parents[1]
WIDTH = 120
EARLY = 20
"""Columns that may stay free before what would have fitted."""
CODE = re.compile(r"(?<!`)`[^`]+`(?!`)")
BEGINS = re.compile(r"\s*(?:#|<|\[\^?[^]]+\]: |[-*] |\d+\. |$)")
"""A line that begins something other than a continuation of the previous one."""
LONGEST_CODE = 60
"""Longer code may be cut in two."""
FOLDERS = (".github", "benchmarks", "deploy", "docs", "examples", "tests")
PAGES = sorted(
    page.relative_to(ROOT).as_posix()
    for page in (*ROOT.glob("*.md"), *(page for folder in FOLDERS for page in (ROOT / folder).glob("**/*.md")))
    if "node_modules" not in page.parts  # of the foreign peers, once their tests have run
)


def prose(text: str) -> list[tuple[int, str]]:
    """Numbered lines that wrap: not in a code block or a table, and not a link that cannot be broken."""
    lines, in_code = [], False
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith("```"):
            in_code = not in_code
        elif not (in_code or line.startswith(("|", "    ")) or (len(line.split()) == 1 and len(line) > WIDTH)):
            lines.append((number, line))
    return lines


def whole_word(line: str) -> str:
    """The beginning of a line that may not be cut: a word, with all of the code in it."""
    at, end = 0, re.match(r"\s*\S+", line)
    found = end[0] if end else ""
    for code in CODE.finditer(line):
        if code.start() < len(found):
            at = code.end()
    return found if at <= len(found) else line[:at]


def paragraphs(lines: dict[int, str]) -> Iterator[tuple[int, str]]:
    """Line numbers of their beginnings, and their texts."""
    for number, line in lines.items():
        if number - 1 in lines and not BEGINS.match(line):
            continue
        text, following = line, number + 1
        while following in lines and not BEGINS.match(lines[following]):
            text, following = f"{text}\n{lines[following]}", following + 1
        yield number, text


def anchors(page: Path) -> set[str]:
    """The anchors of the page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_the_readme_is_read_in_one_sitting() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.parametrize("page", PAGES)
def test_prose_wraps(page: str) -> None:
    lines = prose((ROOT / page).read_text(encoding="utf-8"))
    assert [number for number, line in lines if len(line) > WIDTH] == []


@pytest.mark.parametrize("page", PAGES)
def test_no_line_ends_long_before_the_width(page: str) -> None:
    """A changed paragraph must be wrapped again as a whole."""
    lines = dict(prose((ROOT / page).read_text(encoding="utf-8")))
    early = [
        number
        for number, line in lines.items()
        if (following := lines.get(number + 1, ""))
        and not BEGINS.match(following)
        and not re.match(r"#|<|---|\[\^?[^]]+\]: |$", line)
        and len(line) + 1 + len(whole_word(following)) + EARLY <= WIDTH
    ]
    assert early == []


@pytest.mark.parametrize("page", PAGES)
def test_code_is_on_one_line(page: str) -> None:
    """Otherwise nobody can find it by searching, or copy it."""
    cut = [
        (number, code)
        for number, text in paragraphs(dict(prose((ROOT / page).read_text(encoding="utf-8"))))
        for code in CODE.findall(text)
        if "\n" in code and len(code) <= LONGEST_CODE
    ]
    assert cut == []


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files_and_headings(page: str) -> None:
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = link.partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        if "://" in link or (target.exists() and (not anchor or anchor in anchors(target))):
            continue
        broken.append(link)
    assert broken == []


def test_make_pictures_draws_every_picture_that_a_page_shows() -> None:
    shown = {
        Path(link).name
        for page in PAGES
        for link in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", (ROOT / page).read_text(encoding="utf-8"))
    }
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\npictures:")[2].partition("\n\n")[0]
    assert "benchmarks.method_figures" in recipe
    figures = (ROOT / "benchmarks" / "method_figures.py").read_text(encoding="utf-8")
    shots = (ROOT / "tests" / "system" / "test_page_in_browser.py").read_text(encoding="utf-8")
    assert """picture(page, f"page-{width}-{'dark' if dark else 'light'}\"""" in shots
    page = {f"page-{width}-{look}" for width, _ in SCREENS for look in ("dark", "light")}
    page |= set(re.findall(r'picture\(page, "([\w-]+)"', shots))
    drawn = {*re.findall(r" \$\(PICTURES\)/(\S+)$", recipe, re.MULTILINE), *re.findall(r'"(\S+\.svg)"', figures)}
    assert shown == drawn | {f"{name}.png" for name in page}
