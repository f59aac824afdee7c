"""Two gateways with the same name: the typed client does not mix their data, and commands neither."""

import asyncio
import queue
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from drivers.base import SystemClock
from gateway.config.telemetry import Operator, Telemetry
from gateway.model.commands import Command, CommandName, CommandOutcome
from gateway.model.control_state import NcState
from gateway.model.events import Health, HealthChecked, StoreHealth
from gateway.model.text import plain
from gateway.telemetry.answers import HistoryPage
from gateway.telemetry.client import Machine, MachineError
from gateway.telemetry.command_signer import CommandSigner
from gateway.telemetry.history_queries import HistoryRequest
from gateway.telemetry.publisher import Obey
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.telemetry_peer import problem
from tests.benches.zenoh_sessions import router

LIMIT_S = 60.0
BEGIN = datetime(2026, 3, 2, tzinfo=UTC)
SAID = r"^mill: 2 gateways answer under this name, .* give each its own \[machine\] name$"


def stored(_: HistoryRequest) -> HistoryPage:
    return HistoryPage(0.0, ("bed",), ("degC",), [BEGIN.timestamp()], [0], [20.0], ["good"], None)


def gateway(where: str, boot: str, *operators: Operator, obey: Obey | None = None) -> OpenPublisher:
    settings = Telemetry(mode="client", listen=(), connect=(where,), operator=operators)
    return OpenPublisher(settings, "mill", (), SystemClock(), boot, simulated=False, history=stored, obey=obey)


def healthy() -> HealthChecked:
    return HealthChecked(Health(60.0, 30, 30, NcState.READY, None, (), StoreHealth()))


def wait_until_known(where: str) -> None:
    """Wait until the router has heard of a gateway."""
    until_s = time.monotonic() + LIMIT_S
    while True:
        try:
            with Machine(connect=where):
                return
        except MachineError:
            if time.monotonic() > until_s:
                raise


def refused(ask: Callable[[], object]) -> None:
    """Wait until the client refuses, once the router knows both: until then an answer of one gateway is right."""
    until_s = time.monotonic() + LIMIT_S

    def ask_again() -> None:
        while time.monotonic() < until_s:
            ask()

    with pytest.raises(MachineError, match=SAID):
        ask_again()


async def test_what_two_gateways_of_one_name_say_is_not_mixed(tmp_path: Path) -> None:
    key, obeyed = tmp_path / "anna.key", list[Command]()
    key.write_text("anna" * 10, encoding="utf-8")
    anna = Operator(name="anna", key_file=key, may=(CommandName.PAUSE,))

    async def obey(command: Command, no: str) -> CommandOutcome:
        obeyed.append(command)
        return CommandOutcome(command, BEGIN, not no, plain(no or "it is done"))

    def ask(where: str) -> None:
        with Machine(connect=where, operator=CommandSigner.of_file("anna", key)) as machine:
            refused(machine.status)
            for asked in (
                lambda: next(machine.follow("status", quiet_s=LIMIT_S)),
                lambda: machine.history(BEGIN, BEGIN + timedelta(days=1)),
                machine.latest,
                machine.pause,
            ):
                with pytest.raises(MachineError, match=SAID):
                    asked()
            with pytest.raises(MachineError, match="running: mill"):
                Machine("lathe", connect=where).__enter__()

    def ask_one(where: str) -> None:
        with Machine(connect=where, operator=CommandSigner.of_file("anna", key)) as machine:
            assert machine.status().channels_good == 30
            assert machine.pause().text == "it is done"

    with router(free_port()) as where:
        async with gateway(where, "a", anna, obey=obey) as first:
            async with gateway(where, "b", anna, obey=obey) as second:
                for one in (first, second):
                    one.publish(healthy())
                await asyncio.to_thread(wait_until_known, where)
                await asyncio.to_thread(ask, where)
                assert obeyed == [], "neither was commanded"
            await asyncio.to_thread(ask_one, where)


async def test_a_follower_is_told_of_a_second_gateway_that_begins_later_and_not_of_a_restart() -> None:
    def follow(where: str) -> None:
        with Machine(connect=where) as machine:
            messages = machine.follow("event", quiet_s=LIMIT_S)
            for boot in steps:
                assert next(messages).boot == boot
                heard.put(boot)
            with pytest.raises(MachineError, match=SAID):
                next(messages)

    steps, heard = ("a", "b"), queue.Queue[str]()
    with router(free_port()) as where:
        async with gateway(where, "a") as first:
            first.publish(healthy())
            first.publish(problem("the first"))
            await asyncio.to_thread(wait_until_known, where)
            following = asyncio.create_task(asyncio.to_thread(follow, where))
            assert await asyncio.to_thread(heard.get, timeout=LIMIT_S) == "a"
        async with gateway(where, "b") as again:
            again.publish(healthy())
            again.publish(problem("the first, started again"))
            assert await asyncio.to_thread(heard.get, timeout=LIMIT_S) == "b"
            async with gateway(where, "c") as other:
                other.publish(healthy())
                other.publish(problem("the other"))
                await following
