"""Every configuration in examples/ passes `talc-gateway check`, is unarmed, and is explained."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.config.file import load

FOLDER = Path(__file__).parents[2] / "examples"
PROFILES = {"thermocouples.toml"}
GATEWAYS = sorted(file.name for file in FOLDER.glob("*.toml") if file.name not in PROFILES)


def explanations() -> dict[str, list[str]]:
    """By file, the lines that explain it."""
    _, *sections = (FOLDER / "README.md").read_text(encoding="utf-8").split("\n# Notebooks")[0].split("\n## [")
    return {section.split("]")[0]: section.strip().splitlines()[2:] for section in sections}


def test_there_are_examples_and_each_is_explained() -> None:
    assert len(GATEWAYS) == 4
    found = explanations()
    assert sorted(found) == GATEWAYS
    assert [file for file, lines in found.items() if not "".join(lines).strip()] == []


@pytest.mark.parametrize("name", GATEWAYS)
def test_an_example_passes_the_check(name: str) -> None:
    answer = CliRunner().invoke(main, ["check", str(FOLDER / name)], catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    assert f"{name}: good. " in answer.output


@pytest.mark.parametrize("name", GATEWAYS)
def test_no_example_writes_to_a_control(name: str) -> None:
    config = load(FOLDER / name)
    assert not config.probing.armed
    assert config.compensation.mode == "monitor"
