"""A hook of MkDocs: draws each study's page from the texts and figures that `make study` keeps."""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from studies import published_page


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The site's files, with `studies/NAME.html` for each folder of `docs/studies`."""
    for kept in sorted(Path(config.docs_dir, "studies").glob("*/page.json")):
        name = kept.parent.name
        files.append(File.generated(config, f"studies/{name}.html", content=published_page(kept.parent)))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """The page's text, in which links to such a folder lead to its page."""
    return re.sub(r"\]\(studies/([\w-]+)\)", r"](studies/\1.html)", markdown)
