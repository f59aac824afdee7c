"""A hook of MkDocs: adds the script by which a page opened as a file can search; there browsers start no worker."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

_SCRIPT = Path(__file__).with_name("iframe-worker.js")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The site's files; MkDocs leaves out folders with a dot, such as this one."""
    files.append(File.generated(config, f"assets/javascripts/{_SCRIPT.name}", abs_src_path=str(_SCRIPT)))
    return files
