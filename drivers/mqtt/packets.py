"""MQTT messages as bytes, for the wire log: PUBLISH packets of MQTT 3.1.1 (section 3.3), with QoS 0."""

_PUBLISH = 0x30
_RETAINED = 0x01
"""Flag of a PUBLISH packet."""
_MOST_TOPIC = 0xFFFF
"""Bytes."""


def publish_packet(topic: str, payload: bytes, *, retained: bool) -> bytes:
    """The packet of one message. Raises ValueError for a topic of more than 65535 bytes."""
    name = topic.encode()
    if len(name) > _MOST_TOPIC:
        raise ValueError(f"a topic of {len(name)} bytes, expected at most {_MOST_TOPIC}")
    body = len(name).to_bytes(2, "big") + name + payload
    length, rest = bytearray(), len(body)
    while rest > 0x7F:
        length.append(rest & 0x7F | 0x80)
        rest >>= 7
    length.append(rest)
    return bytes((_PUBLISH | _RETAINED if retained else _PUBLISH,)) + bytes(length) + body
