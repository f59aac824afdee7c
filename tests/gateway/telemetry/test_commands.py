"""Commands over real Zenoh sessions on loopback: from a program or the command line to the gateway, and back."""

import asyncio
import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
import zenoh
from click.testing import CliRunner

from drivers.base import SystemClock
from gateway.cli.main import main
from gateway.config.telemetry import Operator, Telemetry
from gateway.model.commands import Command, CommandName, CommandOutcome, Pause
from gateway.model.control_state import NcState
from gateway.model.events import Health, HealthChecked, StoreHealth
from gateway.model.text import plain
from gateway.telemetry.client import Machine, MachineError
from gateway.telemetry.codec import decode_refusal
from gateway.telemetry.command_signer import CommandSigner
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.telemetry_peer import ROOT
from tests.benches.zenoh_sessions import client

NOW = datetime(2026, 3, 2, 6, tzinfo=UTC)


def key_file(folder: Path, name: str) -> Path:
    path = folder / f"{name}.key"
    path.write_text(name * 40 + "\n", encoding="utf-8")
    return path


def publisher(port: int, *operators: Operator, obey: "Obeyed | None" = None) -> OpenPublisher:
    settings = Telemetry(listen=(f"tcp/127.0.0.1:{port}",), operator=operators)
    return OpenPublisher(settings, "mill", (), SystemClock(), "boot-1", simulated=False, obey=obey)


class Obeyed:
    """What reached the gateway's loop, which stores all of it."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.refused: list[Command] = []
        self.starting = False

    async def __call__(self, command: Command, refused: str) -> CommandOutcome:
        if self.starting:
            raise OSError("the gateway is starting or stopping; give the command again")
        (self.refused if refused else self.commands).append(command)
        return CommandOutcome(command, NOW, not refused, plain(refused or "it is done"))


async def test_a_program_and_the_command_line_give_commands_and_print_the_answer(tmp_path: Path) -> None:
    port, obeyed, key = free_port(), Obeyed(), key_file(tmp_path, "anna")
    anna = Operator(name="anna", key_file=key, may=(CommandName.MEASURE, CommandName.PAUSE))
    obeyed.starting = True
    async with publisher(port, anna, obey=obeyed) as gateway:
        gateway.publish(HealthChecked(Health(1.0, 0, 0, NcState.READY, True, (), StoreHealth(), Pause("ben", NOW))))

        def give() -> None:
            where, signer = f"tcp/127.0.0.1:{port}", CommandSigner.of_file("anna", key)
            with Machine(connect=where, operator=signer) as machine:
                with pytest.raises(MachineError, match="mill: command: the gateway is starting"):
                    machine.pause()
                obeyed.starting = False
                assert machine.measure_now().text == machine.pause().text == "it is done"
                with pytest.raises(MachineError, match=r"mill: resume refused: anna may not give this command"):
                    machine.resume()
                status = machine.status()
                assert status.commands
                assert status.paused is not None
                assert (status.paused.by, status.paused.since) == ("ben", NOW.isoformat())
            with Machine(connect=where) as machine, pytest.raises(MachineError, match="need an operator"):
                machine.pause()
            line = ["command", "pause", "--connect", where, "--operator-key", str(key), "--as"]
            done = CliRunner().invoke(main, [*line, "anna"])
            assert (done.exit_code, done.output) == (0, "mill: pause accepted: it is done\n")
            wrong = CliRunner().invoke(main, [*line, "ben"])
            assert wrong.exit_code == 3
            assert "by and key are not those of an operator of this gateway" in wrong.output
            short = tmp_path / "short.key"
            short.write_text("secret", encoding="utf-8")
            bad = CliRunner().invoke(main, [*line[:-2], str(short), "--as", "anna"])
            assert bad.exit_code == 2
            assert "holds 6 characters: expected at least 32" in bad.output

        await asyncio.to_thread(give)
    assert [(c.name.value, c.by) for c in obeyed.commands] == [
        ("measure", "anna"),
        ("pause", "anna"),
        ("pause", "anna"),
    ]
    assert [(c.name.value, c.by) for c in obeyed.refused] == [("resume", "anna"), ("pause", "(unknown)")]


async def test_a_reader_without_a_key_can_do_nothing(tmp_path: Path) -> None:
    port, obeyed = free_port(), Obeyed()
    anna = Operator(name="anna", key_file=key_file(tmp_path, "anna"), may=(CommandName.PAUSE,))
    async with publisher(port, anna, obey=obeyed):

        def tried(session: zenoh.Session, selector: str) -> list[str]:
            replies = session.get(selector, payload=b'{"name":"pause"}', timeout=60.0)
            return [decode_refusal(r.err.payload.to_bytes()) for r in replies if r.err is not None]

        def read() -> None:
            with client(port) as session:
                assert "missing required field" in tried(session, f"{ROOT}/command/pause")[0]
                assert "expected one of measure" in tried(session, f"{ROOT}/command/*")[0]
                assert tried(session, "talc/*/command/pause") == [], "a command names its machine"
                assert tried(session, f"{ROOT}/**") == []
                session.put(f"{ROOT}/command/pause", b'{"name":"pause"}')
                [reply] = session.get(f"{ROOT}/schema/command", timeout=60.0)
                assert reply.ok is not None
                assert "accepted" in json.loads(reply.ok.payload.to_bytes())["$defs"]["CommandAnswer"]["properties"]
                [reply] = session.get(f"{ROOT}/command", timeout=60.0)
                assert reply.ok is not None, "it still answers"
                assert json.loads(reply.ok.payload.to_bytes())["names"] == list(CommandName)

        await asyncio.to_thread(read)
    assert obeyed.commands == []
    assert {command.by for command in obeyed.refused} == {"(unknown)"}


async def test_without_operators_nothing_listens_for_commands(tmp_path: Path) -> None:
    port, key = free_port(), key_file(tmp_path, "anna")
    async with publisher(port, obey=Obeyed()):

        def give() -> None:
            signer = CommandSigner.of_file("anna", key)
            with (
                Machine(connect=f"tcp/127.0.0.1:{port}", operator=signer) as machine,
                pytest.raises(MachineError, match=r"does its configuration have \[\[telemetry.operator\]\]"),
            ):
                machine.pause()

        await asyncio.to_thread(give)
