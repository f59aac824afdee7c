"""The site's page of commands contains what `--help` prints."""

import re

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from tests.benches.linuxcnc_module import module_at
from tests.benches.pages import ROOT

PAGE: str = module_at(ROOT / "docs" / ".site" / "command_line.py").command_line_page()


@pytest.mark.parametrize("words", ["init", "replay", "scan serial", "inspect topics", "nc sinumerik-files"])
def test_every_option_that_help_prints_is_in_the_section_of_its_command(words: str) -> None:
    section = PAGE.split(f"## {words}\n")[1].split("\n## ")[0]
    printed = CliRunner().invoke(main, [*words.split(), "--help"]).output.split("Options:")[1]
    options = set(re.findall(r"(?m)^  (?:-\w, )?(--[\w-]+)", printed)) - {"--help"}
    assert options
    assert options == set(re.findall(r"(?m)^\| `(?:-\w, )?(--[\w-]+)", section))
