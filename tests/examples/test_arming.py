"""docs/arming.md shows what `check` says at each step, from nothing armed to everything armed."""

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.base import SystemClock
from gateway.cli.main import main
from gateway.config.file import load
from gateway.model.events import EventReported
from gateway.model.wording import event_of
from gateway.nc.probing.geometry import geometry_of, recorded
from gateway.storage.store import Store
from talc.frame import EventKind

ROOT = Path(__file__).parents[2]
STEPS: tuple[dict[str, str], ...] = (
    {},
    {"armed = false": "armed = true"},
    {"armed = false": "armed = true", 'mode = "monitor"': 'mode = "advise"'},
    {
        "armed = false": "armed = true",
        'mode = "monitor"': 'mode = "compensate"',
        "bound_um = [100.0, 100.0, 100.0]": "bound_um = [20.0, 20.0, 20.0]",
    },
)
"""What the page has changed in the example by each step."""


def steps_of_the_page() -> list[list[str]]:
    """The lines below each `check`."""
    blocks = re.findall(r"```text\n\$ talc-gateway check gateway.toml\n(.*?)```", _page(), re.DOTALL)
    return [block.splitlines() for block in blocks]


def _page() -> str:
    return (ROOT / "docs" / "arming.md").read_text("utf-8")


def test_each_step_is_shown_and_its_lines_are_named() -> None:
    assert len(steps_of_the_page()) == len(STEPS)
    for line in ("armed = true", 'mode = "advise"', 'mode = "compensate"', 'mode = "monitor"', "armed = false"):
        assert f"`{line}`" in " ".join(_page().split())


@pytest.mark.parametrize("step", range(len(STEPS)))
def test_check_says_what_the_page_shows(step: int, tmp_path: Path) -> None:
    text = (ROOT / "examples" / "sinumerik.toml").read_text("utf-8")
    for before, after in STEPS[step].items():
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    text = text.replace("/var/lib/talc-gateway/", "")
    file = tmp_path / "gateway.toml"
    file.write_text(text, encoding="utf-8")
    geometry = geometry_of(config := load(file))
    assert geometry is not None
    with Store(config.storage.path, "dry run", SystemClock()) as store:
        store.record(EventReported(event_of(EventKind.OPERATOR, recorded(geometry, "6 poses")), None))
    answer = CliRunner().invoke(main, ["check", str(file)], catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    said = answer.stdout.replace(f"{tmp_path}/", "").splitlines()
    wanted = steps_of_the_page()[step]
    assert len(said) == len(wanted)
    for line, begin in zip(said, wanted, strict=True):
        assert line.startswith(begin.removesuffix("…")), line
