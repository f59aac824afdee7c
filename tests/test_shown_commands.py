"""The commands that the documentation shows can be given, and those that need no device do what they should."""

import asyncio
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.util import find_spec
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from drivers.signature import shared_key
from gateway.cli.main import main
from tests.benches.command import LIMIT_S, Done, talc_gateway
from tests.benches.file_waits import appears, text_of
from tests.benches.free_port import free_port
from tests.benches.pages import ROOT, commands
from tests.benches.waits import until

DEMO = "out/demo/gateway.sqlite"
NAMED = {
    "CONFIG": "gateway.toml",
    "/etc/talc-gateway/gateway.toml": "gateway.toml",
    "DB": DEMO,
    "DATABASE": DEMO,
    "gateway.sqlite": DEMO,
    "TABLE": "steps",
}
"""What stands for the reader's own file in a command."""
FILES = {"check": "gateway.toml", "replay": "recording.csv", "export": "steps.csv", "import-learnt": "learnt.json"}
"""What FILE stands for; for other commands a new file."""
ENDS = {
    r"check \S+|db \S+ DATABASE.*|db import-learnt gateway\.toml FILE|replay (DB|FILE|out/\S+)|report \S+": 0,
    r"(doctor|status) \S+": 3,
}
"""Commands that end by themselves in a folder without devices, and how: 3 is a fault, as no gateway runs."""
UNPUBLISHED = "\n[telemetry]\nenabled = false\n"


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


def words_of(command: str) -> list[str]:
    """The arguments of `talc-gateway`, with the folder's files in place of the reader's own."""
    words = shlex.split(command)[1:]
    file = FILES.get(words[1] if words[0] == "db" else words[0], "made")
    return [NAMED.get(word, file if word == "FILE" else word) for word in words]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reader's folder: two hours of the demo, an example's configuration, and a recording as its page shows one."""
    here = tmp_path_factory.mktemp("reader")
    command = (sys.executable, "-m", "gateway", "demo", "--hours", "2", "--zenoh-port", str(free_port()))
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"replay: talc-gateway replay {DEMO}" in done.stdout
    example = (ROOT / "examples" / "sinumerik.toml").read_text("utf-8")
    assert example.count('"/var/lib/talc-gateway/gateway.sqlite"') == 1
    (here / "gateway.toml").write_text(example.replace("/var/lib/talc-gateway/", ""), encoding="utf-8")
    page = (ROOT / "docs" / "recordings.md").read_text("utf-8")
    head = re.search(r"(?m)^time,.*$", page)
    assert head is not None
    rows = [
        f"2026-03-02T{6 + i // 12:02d}:{i % 12 * 5:02d}:00Z,{21 + i / 20},{21 + i / 30},20.8,"
        + (f"{i / 10},{i / 5}" if i % 3 == 0 else ",")
        for i in range(60)
    ]
    (here / "recording.csv").write_text("\n".join([head[0], *rows]) + "\n", encoding="utf-8")
    learnt = CliRunner().invoke(main, ["db", "export-learnt", str(here / DEMO), "-o", str(here / "learnt.json")])
    assert learnt.exit_code == 0, learnt.output
    return here


@pytest.mark.slow
def test_what_needs_no_device_ends_as_it_should(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    given, wrong = set[str](), []
    for command in sorted({shown for _, shown in commands()}):
        text = command.removeprefix("talc-gateway ")
        codes = [code for pattern, code in ENDS.items() if re.fullmatch(pattern, text)]
        if not codes or "--" in text or "rehearsal" in text:  # a page makes that file
            continue
        for new in ("made", "steps.csv"):
            (folder / new).unlink(missing_ok=True)
        given.add(text.split()[0])
        answer = CliRunner().invoke(main, words_of(command), catch_exceptions=False)
        if answer.exit_code != codes[0]:
            wrong.append(f"{command}: {answer.exit_code}: {answer.output}")
    assert wrong == []
    assert given == {"check", "db", "doctor", "replay", "report", "status"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "made"),
    [
        ("gateway.config.reference", "docs/configuration.md"),
        ("tests.benches.faults.page", "docs/faults.md"),
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


def test_a_key_made_as_shown_is_one(tmp_path: Path) -> None:
    subprocess.run("openssl rand -hex 32 > anna.key && chmod 600 anna.key", shell=True, cwd=tmp_path, check=True)
    assert len(shared_key(tmp_path / "anna.key")) == 64


class PageReader:
    """Runs the commands of the pages in a folder, and remembers which."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.given: set[tuple[str, ...]] = set()

    def start(self, command: str, enough: asyncio.Event | None = None) -> "asyncio.Task[Done]":
        """Run a command to its end, or until Ctrl-C at `enough`."""
        self.given.add(tuple(words_of(command)))
        interrupt = None if enough is None else enough.wait
        return asyncio.create_task(talc_gateway(*words_of(command), folder=self.folder, interrupt=interrupt))

    async def until_heard(self, command: str, file: str) -> None:
        """Ctrl-C comes when the file has several messages of each wire. On a busy computer all answers may be too
        late; then the exit code says that no channel was good."""
        enough = asyncio.Event()
        running = self.start(command, enough)
        wires = ("rtu1", "tcp1", "can1", "growth1")

        def heard() -> bool:
            text = text_of(self.folder / file)
            return running.done() or all(len(re.findall(rf"(?m)^\(\S+\) {wire} ", text)) > 5 for wire in wires)

        await until(heard, LIMIT_S)
        enough.set()
        done = await running
        assert done.code in (0, 3), done.err
        assert heard(), done.err

    @asynccontextmanager
    async def playing(self, command: str, file: str) -> AsyncIterator[None]:
        """The command plays from when its configuration is there until Ctrl-C at the end."""
        enough = asyncio.Event()
        playing = self.start(command, enough)
        try:
            await appears(self.folder / f"{file}.play" / "gateway.toml", playing)
            yield
        finally:
            enough.set()
            done = await playing
        assert done.code == 0, done.err


@pytest.mark.slow
async def test_a_wire_is_played_read_recorded_and_played_again(tmp_path: Path) -> None:
    """What docs/wire-log.md, docs/wiring.md and README.md show, with the recording that is in docs."""
    reader = PageReader(tmp_path)
    (tmp_path / "docs").mkdir()
    shutil.copy(ROOT / "docs" / "example.wire", tmp_path / "docs")
    async with reader.playing("talc-gateway play docs/example.wire", "docs/example.wire"):
        played = (tmp_path / "docs" / "example.wire.play" / "gateway.toml").read_text("utf-8")
        (tmp_path / "gateway.toml").write_text(played + UNPUBLISHED, encoding="utf-8")
        assert " of 30 good" in (await reader.start("talc-gateway probe gateway.toml")).out
        watched = await reader.start("talc-gateway probe gateway.toml --watch --seconds 5 --every 5")
        assert "growth1 eddy: " in watched.out
        for command in (
            "talc-gateway run gateway.toml --record field.wire",
            "talc-gateway record CONFIG",
            "talc-gateway record gateway.toml -o field.wire",
        ):
            (tmp_path / "field.wire").unlink(missing_ok=True)
            await reader.until_heard(command, "field.wire")
    async with reader.playing("talc-gateway play field.wire", "field.wire"):
        assert " of 30 good" in (await reader.start("talc-gateway probe field.wire.play/gateway.toml")).out
    shown = {tuple(words_of(command)) for _, command in commands() if command.startswith("talc-gateway ")}
    assert reader.given <= shown
