"""A hook of MkDocs: every message about a fault, and what to do, from the catalogue, below docs/troubleshooting.md."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from mkdocs.structure.pages import Page

_CATALOGUE = Path(__file__).parents[2] / "gateway" / "model" / "texts" / "en.toml"
_GROUPS = {
    "buses, devices, channels": "Buses, devices, channels",
    "the control": "The control",
    "probing: why nothing is requested, or nothing came of it": "Probing",
    "dry runs": "Dry runs",
    "store, disk, clock": "Store, disk, clock",
    "sensors and planned loads": "Sensors and planned loads",
    "telemetry and the programs that listen": "Telemetry",
}
"""By the comment above a group of messages, its heading here."""


def on_page_markdown(markdown: str, *, page: Page, **_: object) -> str:
    """The page's text, with the catalogue's messages below it."""
    if page.file.src_path != "troubleshooting.md":
        return markdown
    text = _CATALOGUE.read_text(encoding="utf-8")
    return "\n".join([markdown, *_found_by_doctor(tomllib.loads(text)), *_messages(text)])


def _found_by_doctor(texts: dict[str, dict[str, str]]) -> Iterator[str]:
    yield "\n## What `doctor` finds\n"
    yield "| it says | it matters because | do |\n|---|---|---|"
    for code, remedy in texts["remedy"].items():
        yield f"| {_shown(texts['text'].get(code, ''))} | {_shown(texts['matters'].get(code, ''))} | {_shown(remedy)} |"


def _messages(text: str) -> Iterator[str]:
    """The messages of each group in the catalogue's order; words in italics stand for names and numbers."""
    part = text.partition("\n[text]\n")[2].partition("\n[")[0]
    shown = False
    for line in part.splitlines():
        if line.startswith("# "):
            title = _GROUPS.get(line[2:])
            shown = title is not None
            if title:
                yield f"\n## Messages: {title}\n"
        elif shown and " = " in line:
            yield f"- {_shown(tomllib.loads(line)[line.split(' = ')[0]])}"


def _shown(text: str) -> str:
    """A message with its places in italics, as it may stand in a table."""
    return re.sub(r"\{(\w+)[^}]*\}", lambda found: f"*{found[1].replace('_', ' ')}*", text).replace("|", "\\|")
