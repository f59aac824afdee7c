"""Answers that no InfluxDB gives: each is the server's fault, none ends the outlet, and nothing waits without end."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from gateway.listeners.outlets.feed import Feed
from gateway.listeners.outlets.influxdb import InfluxDbOutlet, InfluxDbSettings
from gateway.listeners.outlets.outlet import OutletError, Unacceptable
from tests.benches.feed_talk import reading
from tests.benches.stream_server import http_answer, stream_server

pytestmark = pytest.mark.simulated_time

LIMIT_S = 60.0
DEEP = b'{"message":' + b'{"a":' * 100_000
CHUNKED = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"


def settings(url: str, timeout_s: float = LIMIT_S) -> InfluxDbSettings:
    return InfluxDbSettings.model_validate(
        {"name": "plant", "kind": "influxdb", "url": url, "database": "talc", "timeout_s": timeout_s}
    )


@asynccontextmanager
async def server(*parts: bytes, again: bytes = b"", every_s: float = 0.0) -> AsyncIterator[str]:
    """Answers each line with these bytes, and goes on with `again` until the client leaves; its address."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        for part in parts:
            writer.write(part)
        try:
            while again:
                writer.write(again)
                await writer.drain()
                await asyncio.sleep(every_s)
        except ConnectionError:
            pass
        writer.close()

    async with stream_server(serve) as port:
        yield f"http://127.0.0.1:{port}"


async def sent(url: str, timeout_s: float = LIMIT_S) -> None:
    outlet = InfluxDbOutlet(settings(url, timeout_s))
    try:
        await asyncio.to_thread(outlet.send, [reading(1)])
    finally:
        outlet.close()


async def test_a_refusal_of_brackets_within_brackets_is_shown_as_text() -> None:
    async with server(http_answer(DEEP[:50_000], "400 Bad Request")) as url:
        with pytest.raises(Unacceptable, match=r'400 Bad Request: \{"message":\{"a":'):
            await sent(url)


@pytest.mark.parametrize("status", ["400 Bad Request", "413 Content Too Large", "422 Unprocessable Entity"])
async def test_lines_that_the_server_refuses_for_ever_are_dropped_and_hold_nothing_up(status: str) -> None:
    async with server(http_answer(b"{}", status)) as url:
        feed = Feed(chosen := settings(url), outlet := InfluxDbOutlet(chosen))
        feed.put(reading(1), 0.0)
        await asyncio.to_thread(feed.turn, LIMIT_S)
        assert (feed.waiting, feed.unacceptable, feed.problem) == (0, 1, "")
        outlet.close()


@pytest.mark.parametrize(
    "answer",
    [
        CHUNKED + b"-5\r\n",
        CHUNKED + b"7fffffffffffffffffff\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: 1180591620717411303424\r\n\r\n",
        http_answer(DEEP, "500 Internal Server Error"),
        http_answer(b" " * 65_537),
        b"SSH-2.0-OpenSSH_9.2\r\n",
        b"",
    ],
)
async def test_an_answer_of_absurd_size_or_form_is_a_fault_that_waiting_may_end(answer: bytes) -> None:
    async with server(answer) as url:
        feed = Feed(chosen := settings(url), outlet := InfluxDbOutlet(chosen))
        feed.put(reading(1), 0.0)
        await asyncio.to_thread(feed.turn, LIMIT_S)
        assert (feed.waiting, feed.problem.startswith(url)) == (1, True)
        outlet.close()


@pytest.mark.parametrize(
    ("first", "again"),
    [
        (b"HTTP/1.1 200 OK\r\n", b"X-more: 1\r\n"),
        (b"HTTP/1.1 200 OK\r\n\r\n", b" "),
        (b"", b"HTTP/1.1 100 Continue\r\n\r\n"),
    ],
)
async def test_an_answer_that_never_ends_is_given_up(first: bytes, again: bytes) -> None:
    async with server(first, again=again, every_s=0.02) as url:
        with pytest.raises(OutletError, match=r"no complete answer within 0\.3 s"):
            await asyncio.wait_for(sent(url, 0.3), LIMIT_S)
