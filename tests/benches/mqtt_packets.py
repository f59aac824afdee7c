"""MQTT packets on a stream (MQTT 3.1.1, 2.1 and 2.2)."""

import asyncio


def packet(first: int, body: bytes) -> bytes:
    """Of a kind with its flags, and its length."""
    length, rest = bytearray(), len(body)
    while rest > 0x7F:
        length.append(rest & 0x7F | 0x80)
        rest >>= 7
    return bytes((first, *length, rest)) + body


async def received(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    """First byte and body of a packet."""
    (first,) = await reader.readexactly(1)
    length = shift = 0
    while True:
        (byte,) = await reader.readexactly(1)
        length |= (byte & 0x7F) << shift
        shift += 7
        if not byte & 0x80:
            return first, await reader.readexactly(length)
