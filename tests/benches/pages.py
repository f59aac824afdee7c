"""The commands that the documentation shows."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
_PAGES = sorted(
    page
    for page in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md"))
    if page.name != "CHANGELOG.md"  # names commands that no longer exist
)
_PROGRAMS = re.compile(r"(?:\.venv/bin/)?(talc-gateway|make|python|pip|apt|apt-get|dpkg|uv) [^|=]")


def commands() -> list[tuple[str, str]]:
    """Page and command, each on one line, as they stand in code blocks, indented lines and code spans."""
    return sorted({(page.relative_to(ROOT).as_posix(), found) for page in _PAGES for found in _commands_in(page)})


def _commands_in(page: Path) -> Iterator[str]:
    for i, part in enumerate(page.read_text("utf-8").split("```")):
        lines = part.splitlines() if i % 2 else re.findall(r"(?m)^    (?=\S)(.*)$", part)
        spans = [] if i % 2 else re.findall(r"`([^`]+)`", re.sub(r"(?m)^    .*$", "", part))
        for shown in (*lines, *spans):
            command = " ".join(shown.split()).removeprefix("$ ").partition(" #")[0].strip()
            if _PROGRAMS.match(command):
                yield command
