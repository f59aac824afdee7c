"""The fuzz bench finds nothing for a while, and a guard that is missing: one on each surface is taken away."""

# ruff: noqa: SLF001 - a defect is put where it does harm

import json
import logging
from collections.abc import Iterator, Mapping
from typing import Any
from xml.parsers import expat

import cantools.database.errors
import pytest

from drivers import profiles
from drivers.agent import line
from drivers.can import dbc
from drivers.canopen import bus as canopen_bus
from drivers.micro_epsilon import rs485
from drivers.modbus import bus as modbus_bus
from drivers.modbus.frames import find_tcp_answer
from drivers.mqtt import profile as mqtt_profile
from drivers.mtconnect import exchange
from drivers.opcua import session
from gateway.config import prior, reading
from gateway.heard import instants
from gateway.recordings import cells, files, wire_log
from gateway.storage import learnt, snapshot
from gateway.telemetry import command_door
from gateway.web import older, weeks
from tests.benches.fuzz import SURFACES, fuzzed
from tests.benches.planted import Defect, planted

_answer_at, _find, _event = rs485._answer_at, find_tcp_answer, wire_log._event


class NeverRaised(Exception):
    """Is caught in the place of an error."""


def _first_four(heard: bytes, start: int, address: int) -> bytes | None:
    _ = heard[start + 3]
    return _answer_at(heard, start, address)


def _first_eight(heard: bytes, number: int) -> object:
    _ = heard[7] if heard else None
    return _find(heard, number)


def _every_line(text: str) -> object:
    if (event := _event(text)) is None:
        raise ValueError(text)
    return event


def _unchecked(data: bytes) -> tuple[Any, int]:
    body = data[snapshot._CHECKSUM :]
    at = len(snapshot._NAME) + snapshot._LENGTH
    end = at + int.from_bytes(body[len(snapshot._NAME) : at], "little")
    return json.loads(body[at:end]), snapshot._CHECKSUM + end


GUARDS: Mapping[str, Defect] = {
    "opcua": ((session, "Exception", NeverRaised),),
    "agent": ((line, "ValueError", NeverRaised),),
    "modbus": ((modbus_bus, "find_tcp_answer", _first_eight),),
    "canopen": ((canopen_bus, "SdoCommunicationError", NeverRaised),),
    "can": ((dbc, "_value", lambda signal, heard: signal.decode(heard[signal.frame])),),
    "micro_epsilon": ((rs485, "_answer_at", _first_four),),
    "toml": ((reading, "ValueError", NeverRaised),),
    "profiles": ((profiles, "ValueError", NeverRaised),),
    "dbc": ((cantools.database.errors, "Error", NeverRaised),),
    "recordings": ((files, "ArrowException", NeverRaised), (files, "OSError", NeverRaised)),
    "wire_log": ((wire_log, "_event", _every_line),),
    "learnt": tuple((learnt, name, NeverRaised) for name in ("KeyError", "TypeError", "AttributeError")),
    "prior": ((prior, "RecursionError", NeverRaised),),
    "snapshot": ((snapshot, "_header", _unchecked),),
    "parquet": ((files._Parquet, "_is_plain", lambda *_: True), (cells, "TypeError", NeverRaised)),
    "settings": ((reading, "ValueError", NeverRaised),),
    "mtconnect": ((expat, "ExpatError", NeverRaised),),
    "http": ((exchange, "ValueError", NeverRaised),),
    "mqtt": ((mqtt_profile, "ValueError", NeverRaised),),
    "heard": ((instants, "ValueError", NeverRaised),),
    "answers": ((weeks, "OverflowError", NeverRaised), (weeks, "OSError", NeverRaised)),
    "queries": ((command_door, "is_signed", lambda *_: True),),
    "web": ((older, "ValueError", NeverRaised),),
}
EXAMPLES = {"prior": 400, "dbc": 100, "answers": 400, "web": 1500}
"""If not 40."""
TEN_SECONDS = {
    "opcua": 15, "agent": 350, "modbus": 220, "can": 55,
    "wire_log": 6_000, "recordings": 7_000, "toml": 9_000, "dbc": 7_000,
}  # fmt: skip
"""Examples of which a recent computer tries so many in about ten seconds of processor time."""


@pytest.fixture(autouse=True)
def _unlogged() -> Iterator[None]:
    """What is logged of damaged answers may be no text."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of a socket that a defect left
@pytest.mark.parametrize("surface", SURFACES)
def test_a_guard_that_is_missing_is_found(surface: str) -> None:
    said: list[str] = []
    with planted(GUARDS[surface]):
        assert not fuzzed(surface, 0.0, EXAMPLES.get(surface, 40), 0, said.append), said
    assert "NeverRaised" not in "".join(said)


@pytest.mark.slow
@pytest.mark.parametrize(("surface", "examples"), TEN_SECONDS.items())
def test_nothing_comes_through(surface: str, examples: int) -> None:
    """The same examples on every computer."""
    said: list[str] = []
    assert fuzzed(surface, 0.0, examples, 0, said.append), said
