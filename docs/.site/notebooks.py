"""A hook of MkDocs: each notebook of the examples becomes a page, with what its cells printed."""

import json
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

_FOLDER = Path(__file__).parents[2] / "examples" / "notebooks"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The site's files, with `notebooks/NAME.md` for each notebook."""
    for notebook in sorted(_FOLDER.glob("*.ipynb")):
        files.append(File.generated(config, f"notebooks/{notebook.stem}.md", content=_page(notebook)))
    return files


def _page(notebook: Path) -> str:
    parts = []
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else _fenced("python", source))
        parts += [_fenced("text", "".join(output["text"])) for output in cell.get("outputs", ())]
    told = f"This page is `examples/notebooks/{notebook.name}` of the sources, with what it printed there."
    head, rest = parts[0].split("\n", 1)
    return "\n\n".join([head, f"*{told}*", rest, *parts[1:]]) + "\n"


def _fenced(language: str, text: str) -> str:
    return f"````{language}\n{text.rstrip()}\n````"
