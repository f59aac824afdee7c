"""The commands of the documentation that can be given as they are shown, in a reader's folder."""

import asyncio
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.signature import shared_key
from gateway.cli import main
from tests.benches.command import LIMIT_S, Done, talc_gateway
from tests.benches.file_waits import appears, text_of
from tests.benches.free_port import free_port
from tests.benches.shown_commands import ROOT, WHOLE, RunAsShown, RunOnWires, RunPrints, verdict
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
FILES = {
    "check": "gateway.toml",
    "replay": "recording.csv",
    "export": "steps.csv",
    "import-learnt": "learnt.json",
    "play": "docs/example.wire",
}
"""What FILE stands for; for other commands a new file."""
KNOWN = {command: found for command in WHOLE if (found := verdict(command)[1]) is not None}
GIVEN = [command for command, found in KNOWN.items() if isinstance(found, RunAsShown)]
PRINTED = [command for command, found in KNOWN.items() if isinstance(found, RunPrints)]
UNPUBLISHED = "\n[telemetry]\nenabled = false\n"


def words_of(command: str) -> list[str]:
    """The arguments of `talc-gateway`, with the folder's files in place of the reader's own."""
    words = shlex.split(command)[1:]
    file = FILES.get(words[1] if words[0] in ("db", "nc") else words[0], "made")
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
@pytest.mark.parametrize("command", GIVEN)
def test_it_says_what_it_should_when_it_is_given_as_shown(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = KNOWN[command]
    assert isinstance(found, RunAsShown)
    monkeypatch.chdir(folder)
    if not command.startswith("talc-gateway "):
        said = subprocess.run([sys.executable, *shlex.split(command)[1:]], cwd=ROOT, capture_output=True, text=True)
        assert (said.returncode, found.says in said.stdout) == (found.code, True), said
        return
    for new in ("made", "steps.csv"):
        (folder / new).unlink(missing_ok=True)
    answer = CliRunner().invoke(main, words_of(command), catch_exceptions=False)
    assert answer.exit_code == found.code, answer.output
    assert found.says in answer.output


@pytest.mark.slow
@pytest.mark.parametrize("command", PRINTED)
def test_what_it_prints_is_the_page(command: str, tmp_path: Path) -> None:
    made, _, page = command.partition(" > ")
    words = shlex.split(made)[1:]
    kept = ROOT / words[-1] if "/" in words[-1] else None
    if kept is not None:
        words[-1] = str(tmp_path)
    said = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    if kept is not None:
        assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {
            file.name: file.read_bytes() for file in kept.iterdir()
        }
    elif page:
        assert said.stdout == (ROOT / page).read_text("utf-8")
    else:
        assert said.stdout.startswith("#")


@pytest.mark.slow
def test_a_key_made_as_shown_is_one(tmp_path: Path) -> None:
    printed = subprocess.run(shlex.split("openssl rand -hex 32"), capture_output=True, text=True, check=True).stdout
    assert re.fullmatch(r"[0-9a-f]{64}\n", printed)
    subprocess.run("openssl rand -hex 32 > anna.key && chmod 600 anna.key", shell=True, cwd=tmp_path, check=True)
    assert len(shared_key(tmp_path / "anna.key")) == 64


def test_make_format_mends_what_lint_refuses(tmp_path: Path) -> None:
    for name in ("Makefile", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "odd.py").write_text("import sys\nimport os\nprint( os.sep,sys.path )\n", encoding="utf-8")

    def make(target: str) -> int:
        command = ["make", f"VENV={sys.prefix}", f"--old-file={sys.prefix}/.ready", target]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode

    assert make("lint") != 0
    assert make("format") == 0
    assert make("lint") == 0
    assert (tmp_path / "odd.py").read_text("utf-8") == "import os\nimport sys\n\nprint(os.sep, sys.path)\n"


@pytest.mark.slow
@pytest.mark.peer
def test_make_pictures_draws_those_of_the_pages(tmp_path: Path) -> None:
    """Uses an hour of the demo and the test that takes one picture, and draws into another folder."""
    docs, out = tmp_path / "docs", tmp_path / "out"
    docs.mkdir()
    shot = "tests/system/test_page_in_browser.py::test_a_gateway_that_is_killed_looks_gone_and_one_that_comes_back"
    settings = {
        "VENV": sys.prefix,
        "PICTURES": docs,
        "OUT": out,
        "DEMO": f"--hours 1 --zenoh-port {free_port()}",
        "SHOTS": f"{shot}_begins_again",
    }
    command = ["make", f"--old-file={sys.prefix}/.ready", "pictures", *(f"{k}={v}" for k, v in settings.items())]
    alone = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    done = subprocess.run(command, cwd=ROOT, env=alone, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    drawn = {file.name for file in docs.iterdir()}
    assert drawn == {"demo.png", "method-day.svg", "method-inputs.svg", "page-gone.png"}
    assert all(file.stat().st_size > 5_000 for file in docs.iterdir())
    assert all((ROOT / "docs" / name).is_file() for name in drawn)


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
    walked = [command for command, found in KNOWN.items() if isinstance(found, RunOnWires)]
    assert reader.given == {tuple(words_of(command)) for command in walked}
