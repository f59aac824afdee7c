"""Brackets and colons in names reach the terminal unchanged."""

from pathlib import Path

from click.testing import CliRunner
from rich.table import Table

from gateway.cli import main
from gateway.cli.terminal import terminal


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
