"""A Modbus TCP host written by a test, and a bus connected to it."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from drivers.modbus.bus import ModbusTcpBus
from drivers.modbus.settings import ModbusTcpSettings
from tests.benches.stream_server import Serve, stream_server


@asynccontextmanager
async def modbus_host(serve: Serve, timeout_s: float) -> AsyncIterator[ModbusTcpBus]:
    """serve: has each connection"""
    async with stream_server(serve) as port:
        bus = ModbusTcpBus("bus1", ModbusTcpSettings(host="127.0.0.1", port=port, timeout_s=timeout_s))
        try:
            await bus.connect()
            yield bus
        finally:
            await bus.close()
