"""A study's small version, run from the command line as a user does."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner

from studies import Run
from studies.__main__ import main


@dataclass(frozen=True)
class Studied:
    """What is in its folder afterwards."""

    folder: Path
    page: str
    runs: tuple[Run, ...]


def study_by_command(name: str, folder: Path, *only: str) -> Studied:
    """Run it in this process: every run, or only those with some values (`--only`), and the page."""
    command = [name, "--small", "--workers", "1", "--out", str(folder), *(f"--only={each}" for each in only)]
    answer = CliRunner().invoke(main, command, catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    kept = [json.loads(file.read_text(encoding="utf-8")) for file in (folder / "runs").iterdir()]
    runs = tuple(Run(one["parameters"], one["result"], one["seconds"]) for one in kept)
    assert f"{name}: {len(runs)} runs" in answer.output
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert f"python -m studies {name} --seed 1 --small" in page
    assert "src=" not in page
    assert not re.search(r"\bnan\b", page)
    return Studied(folder, page, runs)
