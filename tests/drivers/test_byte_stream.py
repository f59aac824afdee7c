"""What a byte stream keeps of what it receives."""

import pytest

from drivers.byte_stream import Inbox


async def test_nothing_of_the_last_connection_is_read_on_the_next() -> None:
    """A frame without a number, as of Modbus RTU, would answer the first request."""
    inbox = Inbox("rtu1", None)
    inbox.opened()
    inbox.put(b"late")
    inbox.lose("the device closed the connection")
    inbox.opened()
    with pytest.raises(TimeoutError):
        await inbox.take(0.0)


def test_the_newest_bytes_of_a_line_that_never_stops_sending_are_kept() -> None:
    inbox = Inbox("rtu1", None)
    inbox.opened()
    for number in range(100):
        inbox.put(bytes([number]) * 1000)
    kept = inbox.discard()
    assert (len(kept), kept[-1]) == (65536, 99)
