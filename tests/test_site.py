"""The documentation's site builds without a warning, has every page, and loads nothing from elsewhere."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_the_site_builds_strictly_and_needs_no_network(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    )
    assert done.returncode == 0, done.stderr
    pages = {page.relative_to(ROOT / "docs").with_suffix("") for page in (ROOT / "docs").glob("**/*.md")}
    assert pages <= {page.relative_to(tmp_path).with_suffix("") for page in tmp_path.rglob("*.html")}
    api = (tmp_path / "api.html").read_text(encoding="utf-8")
    assert all(f'id="talc.{name}"' in api for name in ("Learner", "Learner.predict", "rehearse", "GroupLassoARX"))
    notebook = (tmp_path / "notebooks" / "own_recording.html").read_text(encoding="utf-8")
    assert "no correction, µm" in notebook, "what its cells printed"
    # A page opened as a file may neither fetch the index nor start a worker: both come as scripts beside it.
    index = (tmp_path / "search" / "search_index.js").read_text(encoding="utf-8")
    assert any("offsets" in entry["text"] for entry in json.loads(index.removeprefix("var __index = "))["docs"])
    home = (tmp_path / "index.html").read_text(encoding="utf-8")
    for script in re.findall(r'<script src="([^"]+)"', home):
        assert (tmp_path / script).is_file(), script
    assert '<script src="assets/javascripts/iframe-worker.js">' in home
    for page in tmp_path.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert re.findall(r"<(?:script|link|img)[^>]* (?:src|href)=\"?(https?://[^\"> ]+)", text) == []
