"""CAN interfaces on a silent bus while the wall clock jumps."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import get_args

import pytest

from drivers.can.settings import CanInterfaceSettings, Interface
from drivers.can.survey import CanSurvey, Heard
from simulators.devices import SlcanAdapter
from tests.benches.buses import make_bus
from tests.benches.can_kernel import CanKernel
from tests.benches.free_port import free_port
from tests.benches.simulated_time import jump_wall_clock

pytestmark = pytest.mark.simulated_time

HOUR_S = 3600
WAITING_S = 0.15
"""After this time the receiving thread is waiting for the next frame."""
AT_ONCE_S = 1.0


class Unheard:
    """A tap that keeps nothing."""

    def data(self, sent: bool, data: bytes) -> None: ...

    def frame(self, sent: bool, identifier: int, extended: bool, data: bytes) -> None: ...

    def note(self, text: str) -> None: ...


@asynccontextmanager
async def silent(interface: str, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[dict[str, object]]:
    """Options of a silent bus."""
    options: dict[str, object] = {"interface": interface, "channel": "can0"}
    match interface:
        case "slcan":
            adapter = SlcanAdapter([])
            try:
                yield options | {"channel": await adapter.start()}
            finally:
                await adapter.stop()
        case "socketcan":
            monkeypatch.setattr("can.interfaces.socketcan.socketcan.create_socket", CanKernel().create)
            yield options
        case "udp_multicast":
            yield options | {"channel": "239.74.163.9", "port": free_port()}
        case _:
            yield options


@pytest.mark.parametrize("interface", get_args(Interface))
@pytest.mark.parametrize("kind", ["canopen", "can"])
@pytest.mark.parametrize("tap", [None, Unheard()], ids=["", "recorded"])
async def test_closing_takes_no_time_and_leaves_no_thread(
    interface: str, kind: str, tap: Unheard | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with silent(interface, monkeypatch) as options:
        bus = make_bus("can1", kind, options, tap)
        for seconds in (-HOUR_S, HOUR_S, -HOUR_S):
            await bus.connect()
            await asyncio.sleep(WAITING_S)
            jump_wall_clock(seconds)
            begun = time.monotonic()
            await bus.close()
            assert time.monotonic() - begun < AT_ONCE_S


@pytest.mark.parametrize("interface", get_args(Interface))
async def test_listening_ends_in_time(interface: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async with silent(interface, monkeypatch) as options:
        settings = CanInterfaceSettings.model_validate(options)

        def listen() -> float:
            begun = time.monotonic()
            with CanSurvey("scan", settings) as survey:
                survey.listen(2 * WAITING_S, Heard(), lambda: False)
            return time.monotonic() - begun

        listening = asyncio.create_task(asyncio.to_thread(listen))
        await asyncio.sleep(WAITING_S)
        jump_wall_clock(-HOUR_S)
        assert await asyncio.wait_for(listening, 10.0) < 2 * WAITING_S + AT_ONCE_S
