"""The commands that the documentation shows can be given, and its generated pages are up to date."""

import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import click
import pytest

from gateway.cli.main import main
from tests.benches.pages import ROOT, commands


def leaf(words: list[str]) -> tuple[click.Command, list[str], click.Context]:
    """The command that the words name, and the words that remain for it."""
    command: click.Command = main
    context = click.Context(main, info_name="talc-gateway")
    while isinstance(command, click.Group) and words:
        name, found, words = command.resolve_command(context, words)
        assert found is not None
        command, context = found, click.Context(found, info_name=name, parent=context)
    return command, words, context


def check_talc_gateway(words: list[str], folder: Path) -> None:
    """Parse what is shown. Raises UsageError."""
    command, rest, context = leaf(words)
    if isinstance(command, click.Group):
        return
    rest = [word.removeprefix("/") for word in rest]  # below the folder, not on this computer
    for word in rest:
        if not word.startswith("-"):
            file = folder / word
            file.parent.mkdir(parents=True, exist_ok=True)
            file.touch()
    try:
        command.make_context(context.info_name, rest, parent=context.parent)
    except click.MissingParameter:
        pass  # named in a sentence
    except click.BadOptionUsage as error:
        if "requires an argument" not in error.message:
            raise


def check_make(words: list[str]) -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8").replace("$(VENV)", ".venv")
    for word in words:
        name, is_set, _ = word.partition("=")
        found = rf"\$\((if \$\()?{name}\b" if is_set else rf"(?m)^{re.escape(word)}:"
        assert re.search(found, makefile), word


def check_python(words: list[str]) -> None:
    if words[0] != "-m":
        assert (ROOT / words[0]).exists(), words[0]
    else:
        assert find_spec(words[1]) is not None, words[1]


def test_what_is_shown_can_be_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    checks = {
        "talc-gateway": lambda words: check_talc_gateway(words, tmp_path),
        "make": check_make,
        "python": check_python,
    }
    count, wrong = 0, []
    for page, command in commands():
        program, *words = shlex.split(command.replace("…", ""))
        if words and (check := checks.get(Path(program).name)):
            count += 1
            try:
                check(["steps" if word == "TABLE" else word for word in words])
            except (AssertionError, click.UsageError) as error:
                wrong.append(f"{page}: {command}: {error}")
    assert count > 100
    assert wrong == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "made"),
    [
        ("gateway.config.reference", "docs/configuration.md"),
        ("gateway.telemetry", "docs/telemetry"),
    ],
)
def test_a_generated_page_is_up_to_date(module: str, made: str, tmp_path: Path) -> None:
    kept = ROOT / made
    command = [sys.executable, "-m", module, *([str(tmp_path)] if kept.is_dir() else [])]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    if kept.is_dir():
        assert {f.name: f.read_bytes() for f in tmp_path.iterdir()} == {f.name: f.read_bytes() for f in kept.iterdir()}
    else:
        assert said.stdout == kept.read_text("utf-8")
