"""A loopback server ends with every client that it accepted, however late."""

import asyncio
import socket

import pytest

from simulators.devices.loopback import Connection, LoopbackServer


@pytest.mark.parametrize("passes", range(6))
def test_a_client_that_connects_while_the_server_stops_is_disconnected(passes: int) -> None:
    """`passes` of the loop lie between the connection and the stop: in some the client is accepted, but not yet made.
    Its socket would be left to the garbage collector, which `no_leaks` reports."""

    async def connect_and_stop() -> socket.socket:
        server = LoopbackServer(Connection)
        client = socket.create_connection(("127.0.0.1", await server.start()), 60.0)
        for _ in range(passes):
            await asyncio.sleep(0)
        await server.stop()
        assert not server.connections
        return client

    with asyncio.run(connect_and_stop()) as client:
        try:
            rest = client.recv(1)
        except ConnectionResetError:
            rest = b""
    assert rest == b""
