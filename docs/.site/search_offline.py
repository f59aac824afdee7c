"""A hook of MkDocs: adds the scripts of the search.

A page opened as a file needs iframe-worker.js: there browsers start no worker. search-options.js lets one look for
options of the command line.
"""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

_SCRIPTS = [Path(__file__).with_name(name) for name in ("iframe-worker.js", "search-options.js")]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The site's files; MkDocs leaves out folders with a dot, such as this one."""
    for script in _SCRIPTS:
        files.append(File.generated(config, f"assets/javascripts/{script.name}", abs_src_path=str(script)))
    return files
