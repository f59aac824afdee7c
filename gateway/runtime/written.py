"""What texts mean that people write: numbers, an address, a time zone."""

from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from drivers.text import shown
from gateway.model.codes import NoticeCode
from gateway.model.text import Text


def whole_numbers(low: int, high: int, text: str) -> tuple[int, ...]:
    """`1-8,12`: whole numbers within bounds, each once, in order. Raises ValueError."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not first.isdecimal() or not (last or first).isdecimal():
            raise ValueError(Text(NoticeCode.NUMBERS_FORM, value=shown(text)))
        if int(last or first) < int(first):
            raise ValueError(Text(NoticeCode.NUMBERS_ORDER, value=shown(text), low=last, high=first))
        found |= set(range(int(first), int(last or first) + 1))
    if min(found) < low or max(found) > high:
        raise ValueError(Text("not_within", value=shown(text), low=low, high=high))
    return tuple(sorted(found))


def time_zone(name: str) -> ZoneInfo:
    """Raises ValueError for one that this computer does not know."""
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError(Text(NoticeCode.ZONE_UNKNOWN, value=shown(name))) from None


def host_and_port(text: str) -> tuple[str, int]:
    """Of HOST:PORT; IPv6 in brackets. Raises ValueError."""
    host, _, port = text.rpartition(":")
    bare = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if not bare or not port.isdecimal() or not 0 <= int(port) <= 65535 or (":" in bare and bare == host):
        raise ValueError(Text(NoticeCode.HOST_PORT_FORM, value=shown(text)))
    return bare, int(port)
