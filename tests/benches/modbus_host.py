"""A Modbus TCP host written by a test, and a bus connected to it."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from drivers.modbus.bus import ModbusTcpBus
from drivers.modbus.settings import ModbusTcpSettings


@asynccontextmanager
async def modbus_host(
    serve: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]], timeout_s: float
) -> AsyncIterator[ModbusTcpBus]:
    """serve: has each connection"""
    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    bus = ModbusTcpBus("bus1", ModbusTcpSettings(host="127.0.0.1", port=port, timeout_s=timeout_s))
    try:
        await bus.connect()
        yield bus
    finally:
        await bus.close()
        server.close()
        await server.wait_closed()
        await asyncio.sleep(0.01)
