"""Every command in the documentation is valid as shown, and a test runs it."""

import re
import shlex
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from gateway.cli import main
from tests.benches.shown_commands import (
    COMMANDS,
    OURS,
    ROOT,
    TABLE,
    WHOLE,
    RunElsewhere,
    commands_in,
    leaf,
    verdict,
)

FILLED = {"TABLE": "steps", "NAME": "arx-vs-static", "SUBJECT": "selection"}
"""Placeholders of which only some words will do."""
RUN_BY = {
    "agent-test": "tests/gateway/agent_test/test_agent_test.py",
    "check": "tests/examples/test_examples.py",
    "command": "tests/gateway/telemetry/test_commands.py",
    "collect": "tests/gateway/collect/test_network.py",
    "db backup": "tests/gateway/cli/recorded/test_db.py",
    "db check": "tests/gateway/cli/recorded/test_db.py",
    "db export-learnt": "tests/gateway/past/test_learnt.py",
    "db import-learnt": "tests/gateway/past/test_learnt.py",
    "db export": "tests/gateway/cli/recorded/test_db.py",
    "db stats": "tests/gateway/cli/recorded/test_db.py",
    "demo": "tests/system/test_demo.py",
    "doctor": "tests/gateway/cli/condition/test_doctor.py",
    "init": "tests/gateway/cli/commissioning/test_init.py",
    "inspect nodes": "tests/gateway/scan/test_inspect_named.py",
    "inspect topics": "tests/gateway/scan/test_inspect_topics.py",
    "inspect objects": "tests/gateway/scan/test_inspect_named.py",
    "inspect registers": "tests/gateway/scan/test_inspect.py",
    "nc sinumerik-files": "tests/gateway/cli/commissioning/test_nc_files.py",
    "opcua": "tests/gateway/umati/test_opcua_command.py",
    "play": "tests/gateway/recordings/test_record_commands.py",
    "prior make": "tests/gateway/past/test_prior.py",
    "probe": "tests/benches/wiring_faults.py",
    "publish": "tests/gateway/outlets/test_publish.py",
    "record": "tests/gateway/recordings/test_record_commands.py",
    "replay": "tests/gateway/recordings/test_recording.py",
    "report": "tests/gateway/test_reasons_kept.py",
    "run": "tests/gateway/cli/running/test_service_manager.py",
    "scan can": "tests/gateway/scan/test_scan_can.py",
    "scan ports": "tests/gateway/scan/test_ports.py",
    "scan serial": "tests/gateway/scan/test_scan_serial.py",
    "scan tcp": "tests/benches/wiring_faults.py",
    "status": "tests/gateway/cli/condition/test_status.py",
    "watch": "tests/gateway/cli/beside/test_watch.py",
    "web": "tests/gateway/web/test_access.py",
}
"""Command to a file that runs it."""


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


@pytest.mark.parametrize(("page", "command"), [shown for shown in COMMANDS if OURS.match(shown[1])])
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


def test_every_command_on_a_page_is_run() -> None:
    found = {command: verdict(command) for command in WHOLE}
    new = [command for command, (_, said) in found.items() if said is None]
    assert new == [], "say in TABLE of tests/benches/shown_commands.py which test runs them"
    assert set(TABLE) == {pattern for pattern, _ in found.values()}, "no page shows these any more"
    for said in TABLE.values():
        if isinstance(said, RunElsewhere):
            assert re.search(said.trace, (ROOT / said.file).read_text("utf-8")), said


def test_the_extras_that_a_page_installs_exist() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    shown = {e for _, command in COMMANDS for e in re.findall(r"^pip install ['\"]?talc-gateway\[(\w+)\]", command)}
    assert len(shown) > 5
    assert shown <= set(extras)


def test_a_command_that_is_not_in_the_table_is_found() -> None:
    assert verdict("talc-gateway db explode x") == ("", None)
    assert verdict("talc-gateway db check DATABASE")[1] is not None


@pytest.mark.slow
def test_the_recording_on_the_page_leaves_what_the_page_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = ROOT / "docs" / "recordings.md"
    (command,) = (found for found in commands_in(page) if "fl_thermal.csv" in found)
    monkeypatch.chdir(ROOT)
    own = {name: str(tmp_path / name) for name in ("spindle.html", "spindle.csv")}
    ran = CliRunner().invoke(main, [own.get(word, word) for word in shlex.split(command)[1:]], catch_exceptions=False)
    assert ran.exit_code == 0, ran.output
    assert all(Path(file).exists() for file in own.values())
    sentence = r"With (\d+) measurements it leaves (N) of (N) µm RMS; holding the same measurements would leave (N)\."
    said = re.search(sentence.replace("N", r"\d+\.\d"), " ".join(page.read_text("utf-8").split()))
    assert said is not None
    left, held = (
        [float(cell) for cell in row.split("│") if re.fullmatch(r"\s*[\d.]+\s*", cell)]
        for row in ran.output.splitlines()
        if row.startswith("│ spindle Z")
    )
    assert re.search(rf"\bMeasurements of \d+ s: {said[1]};", " ".join(ran.output.split()))
    for text, figure in zip(said.groups()[1:], (left[3], left[2], held[3]), strict=True):
        assert float(text) == pytest.approx(figure, abs=0.051)


def test_a_test_runs_each_command() -> None:
    named = {" ".join(words) for words in _leaves(main, [])}
    assert named == set(RUN_BY)
    for command, file in RUN_BY.items():
        text = (ROOT / file).read_text("utf-8")
        assert all(f'"{word}"' in text for word in command.split()), (command, file)


def _leaves(command: click.Command, path: list[str]) -> Iterator[list[str]]:
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            yield from _leaves(inner, [*path, name])
    else:
        yield path
