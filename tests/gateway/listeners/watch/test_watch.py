"""`watch`: names the machines that are alive, shows readings, and passes no escape sequence on."""

import asyncio
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console

from drivers.base import SystemClock
from gateway.cli.main import main
from gateway.config.file import load
from gateway.config.telemetry import Telemetry
from gateway.listeners.watch.view import LiveView, ViewState, render
from gateway.model.events import EventReported, ReadingsTaken
from gateway.telemetry.messages import ReadingMessage, StatusMessage
from talc.frame import Event, EventKind
from tests.benches.command import LIMIT_S, beside, here
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.plant_authority import DAY, PlantAuthority
from tests.benches.service_file import TEXT
from tests.benches.telemetry_peer import reading


def publisher(port: int, machine: str) -> OpenPublisher:
    settings = Telemetry(listen=(f"tcp/127.0.0.1:{port}",))
    return OpenPublisher(settings, machine, ("t0",), SystemClock(), "boot-1", simulated=False)


@pytest.mark.parametrize(("option", "value"), [("--connect", "foo"), ("--machine", "a b*"), ("--machine", "*")])
def test_invalid_values_are_refused_by_name(option: str, value: str) -> None:
    answer = CliRunner().invoke(main, ["watch", option, value], catch_exceptions=False)
    assert (answer.exit_code, repr(value) in answer.output) == (2, True), answer.output


@pytest.mark.parametrize("port", ["0", "99999999"])
def test_demo_refuses_an_invalid_port(port: str) -> None:
    answer = CliRunner().invoke(main, ["demo", "--zenoh-port", port], catch_exceptions=False)
    assert answer.exit_code == 2
    assert "is not in the range 1<=x<=65535" in answer.output


def test_an_unknown_machine_is_answered_with_those_that_are_alive() -> None:
    port = free_port()
    with beside(publisher(port, "mill")):
        done = here("watch", "--connect", f"tcp/127.0.0.1:{port}", "--machine", "lathe")
        other = here("watch", "--connect", f"tcp/127.0.0.1:{port}", "--prefix", "hall")
    assert (done.code, other.code) == (3, 3)
    assert "no gateway of machine lathe runs under talc; running: mill" in done.err
    assert "no gateway runs under hall" in other.err


@pytest.mark.slow
async def test_the_only_machine_is_followed_without_escape_sequences_of_others() -> None:
    """A device or a control may send any text. The first lines show the readings; then the gateway ends."""
    port = free_port()
    async with publisher(port, "mill") as telemetry:
        telemetry.publish(ReadingsTaken([reading(21.57)]))
        telemetry.publish(EventReported(Event(EventKind.PROBLEM, "NC: alarm \x1b[2J\x1b]0;owned\x07 stop"), 7))
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "gateway", "watch", "--connect", f"tcp/127.0.0.1:{port}"),
            stdout=asyncio.subprocess.PIPE,
        )
        assert process.stdout is not None
        said = b""
        async with asyncio.timeout(LIMIT_S):
            while b"degC" not in said or b"alarm" not in said:
                said += await process.stdout.readline()
    async with asyncio.timeout(LIMIT_S):
        rest, _ = await process.communicate()
    assert process.returncode == 0
    text = (said + rest).decode()
    assert "t0 21.6 degC" in text
    assert "NC: alarm �[2J�]0;owned� stop" in text
    assert not [c for c in text if not c.isprintable() and c != "\n"]
    assert "mill: the gateway has ended" in text


@pytest.mark.slow
async def test_the_gateway_of_a_configuration_is_found_where_it_says_and_as_it_says(tmp_path: Path) -> None:
    """By mutual TLS, for which the file has everything that is needed."""
    port, file = free_port(), tmp_path / "gateway.toml"
    PlantAuthority(tmp_path / "plant").issue("mill")
    file.write_text(
        f"""{TEXT}
[telemetry]
listen = ["tls/127.0.0.1:{port}"]
[telemetry.tls]
certificate = "plant/mill.pem"
key = "plant/mill.key"
authority = "plant/authority.pem"
mutual = true
""",
        encoding="utf-8",
    )
    config = load(file)
    gateway = OpenPublisher(config.telemetry, "mill", (), SystemClock(), "boot-1", simulated=False)
    async with gateway:
        gateway.publish(ReadingsTaken([reading(21.57)]))
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "gateway", "watch", str(file)), stdout=asyncio.subprocess.PIPE
        )
        assert process.stdout is not None
        async with asyncio.timeout(LIMIT_S):
            while b"21.6 degC" not in (line := await process.stdout.readline()):
                assert line, "it has ended"
    async with asyncio.timeout(LIMIT_S):
        await process.communicate()
    assert process.returncode == 0


@pytest.mark.slow
async def test_a_gateway_runs_on_with_a_certificate_that_has_expired_and_says_so(tmp_path: Path) -> None:
    port, file = free_port(), tmp_path / "gateway.toml"
    certificate, key = PlantAuthority(tmp_path / "plant").issue("mill", -DAY)
    tls = f'[telemetry.tls]\ncertificate = "{certificate}"\nkey = "{key}"\n'
    file.write_text(f'{TEXT}[telemetry]\nlisten = ["tls/127.0.0.1:{port}"]\n{tls}', encoding="utf-8")
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway", "-v", "run", str(file)), stderr=asyncio.subprocess.PIPE
    )
    assert process.stderr is not None
    said = b""
    try:
        async with asyncio.timeout(LIMIT_S):
            while b"listening on tls/" not in said:
                said += (line := await process.stderr.readline())
                assert line, said.decode()
    finally:
        process.terminate()
        async with asyncio.timeout(LIMIT_S):
            await process.communicate()
    assert f"[telemetry.tls] certificate: '{certificate}' has expired on" in said.decode()
    assert process.returncode == 0


def test_a_configuration_that_publishes_nowhere_is_not_waited_for(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(TEXT + "[telemetry]\nlisten = []\n", encoding="utf-8")
    answer = CliRunner().invoke(main, ["watch", str(file)], catch_exceptions=False)
    assert answer.exit_code == 2
    assert "[telemetry]" in answer.output
    other = CliRunner().invoke(main, ["watch", str(file), "--prefix", "hall"], catch_exceptions=False)
    assert "give either it or options" in other.output


def off(*unarmed: str) -> StatusMessage:
    return StatusMessage("b", 1, "2026-01-05T06:00:00+00:00", "system", None, None, 0, {}, None, None, unarmed=unarmed)


NOT_ARMED = "nothing will be learnt: probing is not armed ([probing] armed = true)"


def test_the_screen_shows_what_is_not_armed_until_it_is() -> None:
    state, console = ViewState("mill"), Console(width=80)
    state.apply(off(NOT_ARMED))
    with console.capture() as shown:
        console.print(render(state))
    assert NOT_ARMED in shown.get()
    state.apply(off())
    with console.capture() as shown:
        console.print(render(state))
    assert NOT_ARMED not in shown.get()


@pytest.mark.parametrize("order", [("bed", "column", "ram"), ("ram", "bed", "column")])
def test_channels_stand_in_the_order_of_their_names(order: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    state, console = ViewState("mill"), Console(width=80)
    for name in order:
        state.apply(
            ReadingMessage("b", 1, "2026-01-05T06:00:00+00:00", "system", name, 21.0, "degC", "good", "", 0.0, 1, "")
        )
    with console.capture() as shown:
        console.print(render(state))
    with LiveView(state, plain=True, summary_at_once=True):
        pass
    for text in (shown.get(), capsys.readouterr().out):
        assert text.index("bed") < text.index("column") < text.index("ram")
