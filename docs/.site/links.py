"""A hook of MkDocs: links to files of the checkout that are not pages become their path, in words."""

import re

_OUTSIDE = re.compile(r"\[([^\]]+)\]\((?:\.\./)+([^)]+)\)")


def on_page_markdown(markdown: str, **_: object) -> str:
    """The page's text; the pages themselves keep their links, for those who read them in the checkout."""
    return _OUTSIDE.sub(lambda found: f"{found[1]} (`{found[2].split('#')[0]}`)", markdown)
