"""A TCP server whose behaviour the test writes: at its end no connection is left, however late it came."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def stream_server(serve: Serve, limit: int = 2**16, host: str = "127.0.0.1") -> AsyncIterator[int]:
    """Yields its port; at the end `serve` is cancelled in every connection, and the connection is closed.

    serve: has each connection; an error that it raises goes to asyncio's log
    limit: of the reader, in bytes
    """
    clients: dict[asyncio.Task[None], asyncio.StreamWriter] = {}

    async def known(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        clients[task] = writer
        await serve(reader, writer)

    server = await asyncio.start_server(known, host, 0, limit=limit)
    try:
        yield int(server.sockets[0].getsockname()[1])
    finally:
        for listening in server.sockets:  # asyncio leaks a connection that it makes after the server was closed
            asyncio.get_running_loop().remove_reader(listening.fileno())
        for _ in range(3):  # accepted, connected, served
            await asyncio.sleep(0)
        server.close()
        for task, writer in clients.items():
            task.cancel()
            writer.close()
        await asyncio.gather(*clients, *(each.wait_closed() for each in clients.values()), return_exceptions=True)
        await server.wait_closed()


def http_answer(body: bytes, status: str = "200 OK") -> bytes:
    return f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body
