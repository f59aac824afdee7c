"""Whatever the server answers, the driver raises only its own errors: counts, nulls, types, bytes."""

import logging
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest
from asyncua.client.ua_client import UaClient

from drivers.base import BadAnswer, DriverError, SystemClock
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from tests.benches.emulated_bench import sinumerik_bench
from tests.benches.spoilt_opcua import ask_spoilt

pytestmark = pytest.mark.simulated_time

ServiceCall = Callable[..., Awaitable[Any]]


@pytest.fixture(autouse=True)
def _library_keeps_still(caplog: pytest.LogCaptureFixture) -> None:
    """The library would log the spoilt texts, in characters that a test report cannot contain."""
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


def _spoilt(genuine: ServiceCall, spoil: Callable[[list[Any]], object]) -> ServiceCall:
    async def spoilt(client: UaClient, *given: object) -> object:
        return spoil(await genuine(client, *given))

    return spoilt


async def test_a_namespace_array_of_another_kind_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    async with sinumerik_bench() as bench:
        genuine = UaClient.read_attributes
        for namespaces in (None, [], [None], [1, 2]):
            monkeypatch.setattr(UaClient, "read_attributes", _spoilt(genuine, _first_holds(namespaces)))
            nc = Sinumerik(SinumerikSettings(security="none", url=bench.url), SystemClock())
            with pytest.raises(DriverError, match="namespace"):
                await nc.connect()
            await nc.close()


def _first_holds(value: object) -> Callable[[list[Any]], object]:
    data = SimpleNamespace(Value=SimpleNamespace(Value=value))
    return lambda good: [data, *good[1:]]


async def test_damaged_bytes_raise_nothing_but_driver_errors() -> None:
    assert await ask_spoilt([1], 16) > 3
