"""Whatever the server answers, the driver raises only its own errors: counts, nulls, types, bytes."""

import asyncio
import logging
import random
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest
from asyncua.client.client import Client
from asyncua.client.ua_client import UaClient

from drivers.base import BadAnswer, DriverError, SystemClock
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from tests.benches.cut_line import line_to
from tests.benches.emulated_bench import sinumerik_bench

pytestmark = pytest.mark.simulated_time

Service = Callable[..., Awaitable[Any]]
TIMEOUT_S = 0.2
"""A spoilt answer is often none at all: each costs this long."""


@pytest.fixture(autouse=True)
def _library_keeps_still(caplog: pytest.LogCaptureFixture) -> None:
    """The library logs the spoilt texts, in characters that a test report cannot hold."""
    caplog.set_level(logging.CRITICAL + 1, "asyncua")


MALFORMED: dict[str, Callable[[list[Any]], object]] = {
    "null": lambda _: None,
    "none_at_all": lambda _: [],
    "one_less": lambda good: good[:-1],
    "one_more": lambda good: [*good, good[-1]],
    "null_among_them": lambda good: [None, *good[1:]],
    "numbers_instead": lambda good: [1.0] * len(good),
    "text_instead": lambda _: "answers",
}


async def test_lists_of_another_size_or_kind_are_a_bad_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    async with sinumerik_bench() as bench:  # one for all: a server takes seconds to start
        for service, request in (
            ("read_attributes", bench.nc.read_compensation),
            ("write_attributes", lambda: bench.nc.write_compensation((1.0, 2.0, 3.0))),
        ):
            genuine = getattr(UaClient, service)
            for name, spoil in MALFORMED.items():
                await bench.nc.connect()
                with monkeypatch.context() as patched:
                    patched.setattr(UaClient, service, _spoilt(genuine, spoil))
                    assert await _refused(request()), f"{service}: {name} is taken for an answer"


async def _refused(request: Awaitable[object]) -> bool:
    try:
        await request
    except BadAnswer:
        return True
    return False


def _spoilt(genuine: Service, spoil: Callable[[list[Any]], object]) -> Service:
    async def spoilt(client: UaClient, *given: object) -> object:
        return spoil(await genuine(client, *given))

    return spoilt


async def test_a_namespace_array_of_another_kind_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    async with sinumerik_bench() as bench:
        for namespaces in (None, [], [None], [1, 2]):
            monkeypatch.setattr(Client, "get_namespace_array", _answering(namespaces))
            nc = Sinumerik(SinumerikSettings(security="none", url=bench.url), SystemClock())
            with pytest.raises(DriverError, match="namespace"):
                await nc.connect()
            await nc.close()


def _answering(answer: object) -> Service:
    async def answered(*_: object) -> object:
        return answer

    return answered


@asynccontextmanager
async def _spoilt_line() -> AsyncIterator[tuple[Any, str]]:
    async with sinumerik_bench() as bench, line_to(bench.url) as (line, joined):
        yield line, joined


def _changes(seed: int) -> Iterator[Callable[[bytes], bytes]]:
    """Single answers with bytes exchanged, cut, doubled, or lengths made huge or negative; the header often whole."""
    draw = random.Random(seed)
    while True:
        kind, from_start = draw.choice(("bytes", "ones", "cut", "double", "length")), draw.choice((0, 8, 24, 40))

        def change(data: bytes, kind: str = kind, first: int = from_start) -> bytes:
            if len(data) <= first + 4:
                return data
            spoilt, at = bytearray(data), draw.randrange(first, len(data) - 4)
            match kind:
                case "bytes":
                    for _ in range(draw.randint(1, 4)):
                        spoilt[draw.randrange(first, len(data))] = draw.randrange(256)
                case "ones":
                    spoilt[at : at + 4] = b"\xff\xff\xff\xff"
                case "length":
                    spoilt[at : at + 4] = draw.choice((0, 1, 2**31 - 1, 2**31, 70_000)).to_bytes(4, "little")
                case "cut":
                    del spoilt[at:]
                case "double":
                    spoilt += data
            return bytes(spoilt)

        yield change


async def _connected(nc: Sinumerik) -> None:
    """With a session that answers; on a busy computer an answer may take longer than the driver waits."""
    async with asyncio.timeout(60.0):
        while True:
            try:
                await nc.snapshot()
                return
            except DriverError:
                with suppress(DriverError):
                    await nc.connect()


async def _fuzz(seeds: Sequence[int], answers: int) -> int:
    """How many of the spoilt answers the driver refused. Anything but a DriverError ends the test."""
    refused = 0
    async with _spoilt_line() as (line, joined):
        nc = Sinumerik(
            SinumerikSettings(security="none", url=joined, timeout_s=TIMEOUT_S, subscribe_s=0.0), SystemClock()
        )
        for seed in seeds:
            changes = _changes(seed)
            for number in range(answers):
                line.spoil = None
                await _connected(nc)
                line.spoil = next(changes)
                try:
                    match number % 4:
                        case 0:
                            await nc.read_compensation()
                        case 1:
                            await nc.probing_status(1)
                        case 2:
                            await nc.write_compensation((0.0, 0.0, 0.0))
                        case _:
                            await nc.connect()
                except DriverError:
                    refused += 1
        line.spoil = None
        await nc.close()
        await asyncio.sleep(0)
    return refused


async def test_damaged_bytes_raise_nothing_but_driver_errors() -> None:
    assert await _fuzz([1], 16) > 3


@pytest.mark.slow
async def test_many_damaged_bytes_raise_nothing_but_driver_errors() -> None:
    assert await _fuzz(range(100, 104), 100) > 50
