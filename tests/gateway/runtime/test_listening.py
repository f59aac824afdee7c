"""A port that strangers fill serves those who send their request, and ends the connections of those who do not."""

import asyncio
import gc
import ssl
from asyncio.sslproto import SSLProtocol
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from gateway.runtime.listening import ACCEPTED_AT_ONCE, GuardedSocket
from tests.benches.plant_authority import PlantAuthority

LIMIT_S = 60.0
SILENT = 300
PLACES = 8
HALF_A_HELLO = bytes.fromhex("160301020001000200")
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@asynccontextmanager
async def echoing(first_request_s: float, tls: ssl.SSLContext | None = None) -> AsyncIterator[GuardedSocket]:
    """A server that sends back each line, and knows who has sent one that begins with `me`."""
    listening = GuardedSocket("127.0.0.1", 0, strangers=PLACES, known=1, first_request_s=first_request_s)

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            if line.startswith(b"me"):
                listening.know(writer.get_extra_info("peername"))
            writer.write(line)
        writer.close()

    served = asyncio.start_server(answer, sock=listening, backlog=ACCEPTED_AT_ONCE, ssl=tls)
    async with asyncio.timeout(LIMIT_S), await served:
        yield listening
        await listening.end()


async def opened(listening: GuardedSocket, line: bytes = b"") -> Streams:
    reader, writer = await asyncio.open_connection(*listening.getsockname())
    writer.write(line)
    return reader, writer


async def test_however_many_are_silent_who_asks_is_answered_and_who_is_known_stays(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with echoing(LIMIT_S) as listening:
        mine = await opened(listening, b"me\n")
        assert await mine[0].readline() == b"me\n"
        silent = [await opened(listening, b"GET") for _ in range(SILENT)]
        asked = await opened(listening, b"hello\n")
        assert await asked[0].readline() == b"hello\n"
        mine[1].write(b"still here\n")
        assert await mine[0].readline() == b"still here\n"
        ended = await asyncio.gather(*(reader.read() for reader, _ in silent[:-PLACES]))
        assert ended == [b""] * len(ended)
        for _, writer in (mine, asked, *silent):
            writer.close()
    assert len(caplog.records) == 1, "of all of them"


async def test_what_is_left_of_silent_connections_by_tls_does_not_wait_for_python_to_collect_it(tmp_path: Path) -> None:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(*PlantAuthority(tmp_path).issue("localhost"))
    gc.collect()
    gc.disable()
    try:
        async with echoing(LIMIT_S, context) as listening:
            silent = [await opened(listening, HALF_A_HELLO) for _ in range(SILENT)]
            await asyncio.gather(*(reader.read() for reader, _ in silent[:-PLACES]))
            held = sum(isinstance(one, SSLProtocol) for one in gc.get_objects())
            for _, writer in silent:
                writer.close()
    finally:
        gc.enable()
    assert held < SILENT / 2


async def test_who_sends_no_request_in_time_is_cut_off_and_also_who_is_one_too_many_to_be_known() -> None:
    async with echoing(0.2) as listening:
        mine, other, silent = [await opened(listening, line) for line in (b"me\n", b"me too\n", b"")]
        assert await mine[0].readline() == b"me\n"
        assert await other[0].readline() == b"me too\n"
        assert (await other[0].read(), await silent[0].read()) == (b"", b"")
        mine[1].write(b"still here\n")
        assert await mine[0].readline() == b"still here\n"
        for _, writer in (mine, other, silent):
            writer.close()
