"""Brackets and colons in names reach the terminal unchanged."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.table import Table

from gateway.cli.main import main
from gateway.runtime.terminal import duration_text, terminal


def test_names_with_brackets_stand_as_they_are_also_in_tables() -> None:
    name = "bed[red] [talc.control] :fire:"
    console = terminal()
    table = Table("channel", title=name)
    table.add_row(name)
    with console.capture() as shown:
        console.print(f"report: {name}", style="red", soft_wrap=True)
        console.print(table)
    assert shown.get().count(name) == 3


def test_replay_names_sections_and_files_whole(tmp_path: Path) -> None:
    path = tmp_path / "y[red].csv"
    path.write_text("\n".join(["time,t1,EX0C", *(f"{300 * i},{20 + i % 5},{i}" for i in range(1, 20))]))
    config = tmp_path / "talc.toml"
    config.write_text('[talc]\nmethod = "models"\n', encoding="utf-8")
    answer = CliRunner().invoke(main, ["replay", str(path), "--config", str(config)], catch_exceptions=False)
    assert answer.exit_code == 0
    assert "--config with [talc.control] calibration_steps" in answer.output
    assert f"report: {tmp_path / 'y[red].html'}" in answer.output
    assert (tmp_path / "y[red].html").exists()


@pytest.mark.parametrize(
    ("seconds", "text", "with_tenths"),
    [
        (0.04, "0 s", "0.0 s"),
        (3.26, "3 s", "3.3 s"),
        (10.0, "10 s", "10 s"),
        (119.0, "119 s", "119 s"),
        (120.0, "2 min", "2 min"),
        (119.6, "2 min", "2 min"),
        (7169.0, "119 min", "119 min"),
        (7199.0, "2 h", "2 h"),
        (7200.0, "2 h", "2 h"),
        (172800.0, "2 days", "2 days"),
    ],
)
def test_a_duration_in_words(seconds: float, text: str, with_tenths: str) -> None:
    assert (duration_text(seconds), duration_text(seconds, tenths=True)) == (text, with_tenths)
