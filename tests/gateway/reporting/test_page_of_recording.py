"""The page of a recording says how it was made and what was not checked; replay says how long a calibration takes."""

import hashlib
import html
import re
import shlex
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.benches.command import here


def recording(folder: Path, spacing_s: float, rows: int) -> Path:
    path = folder / "some mill.csv"
    lines = (f"{spacing_s * i:g},{20 + i % 7 * 0.3:.1f},{i},{i % 5}" for i in range(rows))
    path.write_text("\n".join(["time,t1,note,EX0C", *lines]), encoding="utf-8")
    return path


def page_of(path: Path) -> str:
    return html.unescape(path.with_suffix(".html").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_page_can_be_made_again_from_what_it_says(tmp_path: Path) -> None:
    path, config = recording(tmp_path, 300.0, 60), tmp_path / "talc.toml"
    config.write_text("[talc.control]\ncalibration_steps = 24\n", encoding="utf-8")
    assert here("replay", path, "--config", config, "--ignore", "note", "--every-measurement").code == 0
    page = page_of(path)
    said = re.search(r"<code>(talc-gateway replay .*?)</code>", page)
    assert said is not None
    command = shlex.split(said[1])
    path.with_suffix(".html").unlink()
    assert here("replay", *command[2:]).code == 0
    assert page_of(path) == page
    for file in (path, config):
        assert f"{file.name}, " in page
        assert hashlib.sha256(file.read_bytes()).hexdigest() in page
    assert "calibration_steps = 24, calibration_interval_steps = 1" in page
    assert 'selector = "search"' in page
    for name in ("scipy", "osqp", "numpy"):
        assert f"{name} {version(name)}" in page


def test_the_command_holds_what_was_given(tmp_path: Path) -> None:
    path, page = recording(tmp_path, 300.0, 60), tmp_path / "page.html"
    told = ["-o", str(page), "--time", "time", "--error", "EZ0T=note", "--error", "EX0C=EX0C"]
    assert here("replay", path, *told).code == 0
    text = html.unescape(page.read_text(encoding="utf-8"))
    assert f"talc-gateway replay '{path}' -o {page} --error EZ0T=note --error EX0C=EX0C</code>" in text
    assert "EZ0T = note, EX0C</code>" in text
