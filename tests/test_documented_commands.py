"""Every command that the documentation shows can be given as it is shown, and a test runs what it names."""

import re
import shlex
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import click
import pytest

from gateway.cli import main

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")), key=lambda page: page.as_posix()
)
OLD = "CHANGELOG.md"
"""Names commands that are gone."""
PROGRAMS = re.compile(r"(?:\.venv/bin/)?(talc-gateway|make|python)\b")
FILLED = {"TABLE": "steps", "NAME": "arx-vs-static", "SUBJECT": "selection"}
"""Placeholders of which only some words will do."""
RUN_BY = {
    "check": "tests/examples/test_examples.py",
    "db backup": "tests/gateway/cli/test_db.py",
    "db check": "tests/gateway/cli/test_db.py",
    "db export-learnt": "tests/gateway/test_learnt.py",
    "db import-learnt": "tests/gateway/test_learnt.py",
    "db export": "tests/gateway/cli/test_db.py",
    "db stats": "tests/gateway/cli/test_db.py",
    "demo": "tests/system/test_demo.py",
    "doctor": "tests/gateway/cli/test_doctor.py",
    "init": "tests/gateway/cli/test_init.py",
    "play": "tests/gateway/recordings/test_record_commands.py",
    "prior make": "tests/gateway/test_prior.py",
    "probe": "tests/benches/wiring_faults.py",
    "record": "tests/gateway/recordings/test_record_commands.py",
    "replay": "tests/gateway/recordings/test_recording.py",
    "report": "tests/gateway/test_reasons_kept.py",
    "run": "tests/gateway/cli/test_service_manager.py",
    "scan can": "tests/gateway/scan/test_scan_can.py",
    "scan ports": "tests/gateway/scan/test_ports.py",
    "scan serial": "tests/gateway/scan/test_scan_serial.py",
    "scan tcp": "tests/benches/wiring_faults.py",
    "status": "tests/gateway/cli/test_status.py",
    "watch": "tests/gateway/cli/test_watch.py",
    "web": "tests/gateway/web/test_access.py",
}
"""Command to a file that runs it."""


def commands_in(page: Path) -> Iterator[str]:
    """Commands of a page, in code blocks and in code spans, on one line each."""
    prose = []
    for i, part in enumerate(page.read_text("utf-8").split("```")):
        if i % 2 == 0:
            prose.append(part)
            continue
        for line in part.splitlines()[1:]:
            command = line.removeprefix("$ ").partition(" #")[0].strip()
            if PROGRAMS.match(command):
                yield command
    for span in re.findall(r"`([^`]+)`", " ".join(prose)):
        if PROGRAMS.match(span):
            yield " ".join(span.split())


COMMANDS = sorted(
    {
        (page.relative_to(ROOT).as_posix(), command)
        for page in PAGES
        if page.name != OLD
        for command in commands_in(page)
        if " " in command
    }
)


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
    for word in rest:
        if not word.startswith("-"):
            file = folder / word
            file.parent.mkdir(parents=True, exist_ok=True)
            file.touch()
    if isinstance(command, click.Group):
        return
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
        name, is_set, value = word.partition("=")
        if is_set:
            assert f"$({name})" in makefile or f"$(if $({name})" in makefile, name
            if name == "SUBJECTS":
                assert all(find_spec(f"benchmarks.{subject}") for subject in value.split()), value
            if name == "NAME" and value:
                assert find_spec(f"studies.{value.replace('-', '_')}") is not None, value
        else:
            assert re.search(rf"^{re.escape(word)}:", makefile, re.MULTILINE), word


def check_python(words: list[str]) -> None:
    if words[0] != "-m":
        assert (ROOT / words[0]).exists(), words[0]
        return
    module, rest = words[1], words[2:]
    assert find_spec(module) is not None, module
    if module == "pytest":
        assert all((ROOT / word).exists() for word in rest if not word.startswith("-")), rest
    if module == "studies" and rest:
        assert find_spec(f"studies.{rest[0].replace('-', '_')}") is not None, rest


def test_there_are_commands_to_check() -> None:
    assert len(COMMANDS) > 60


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_what_is_shown_can_be_given(page: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program, *words = shlex.split(command.replace("…", ""))
    words = [FILLED.get(word, word) for word in words]
    match Path(program).name:
        case "talc-gateway":
            monkeypatch.chdir(tmp_path)
            check_talc_gateway(words, tmp_path)
        case "make":
            check_make(words)
        case _:
            check_python(words)


def test_a_test_runs_each_command() -> None:
    named = {" ".join(words) for words in _leaves(main, [])}
    assert named == set(RUN_BY)
    for command, file in RUN_BY.items():
        text = (ROOT / file).read_text("utf-8")
        assert all(f'"{word}"' in text for word in command.split()), (command, file)


def _leaves(command: click.Command, path: list[str]) -> Iterator[list[str]]:
    if isinstance(command, click.Group):
        for name, inner in command.commands.items():
            yield from _leaves(inner, [*path, name])
    else:
        yield path
