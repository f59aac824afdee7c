"""A hook of MkDocs: links to files of the checkout that are not pages become their path, in words.

A TOML file whose link is a paragraph of its own is shown as it is.
"""

import re
from pathlib import Path

_ROOT = Path(__file__).parents[2]
_OUTSIDE = re.compile(r"\[([^\]]+)\]\((?:\.\./)+([^)]+)\)")
_SHOWN = re.compile(r"^\[[^\]]+\]\((?:\.\./)+(examples/\w+/\w+\.toml)\)$", re.MULTILINE)


def on_page_markdown(markdown: str, **_: object) -> str:
    """The page's text; the pages themselves keep their links, for those who read them in the checkout."""
    shown = _SHOWN.sub(lambda found: f"```toml\n{(_ROOT / found[1]).read_text(encoding='utf-8')}```", markdown)
    return _OUTSIDE.sub(lambda found: f"{found[1]} (`{found[2].split('#')[0]}`)", shown)
