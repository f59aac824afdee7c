"""Lasting problems of the control: which are still there, by all that one run has reported."""

from collections.abc import Iterable
from typing import Final

from gateway.model.codes import NoticeCode
from gateway.model.text import Text

DISARMING: Final = (NoticeCode.NC_NOT_SENDABLE, NoticeCode.NC_OTHER_OFFSETS)
"""These last until a restart."""
_ENDS: Final = {
    NoticeCode.NC_NOT_CONNECTED: NoticeCode.NC_CONNECTED_AGAIN,
    NoticeCode.NC_WATCHDOG_UNHEARD: NoticeCode.NC_WATCHDOG_HEARD,
    NoticeCode.NC_WATCHDOG_SILENT: NoticeCode.NC_WATCHDOG_HEARD,
}
"""What ends each of the others."""


def still_wrong(texts: Iterable[Text]) -> tuple[Text, ...]:
    """What is still wrong with the control, by all that one run has reported, in its order."""
    found: dict[NoticeCode | None, Text] = {}
    for text in texts:
        if any(map(text.says, DISARMING)):
            found[None] = text
        for beginning, end in _ENDS.items():
            if text.says(beginning):
                found[end] = text
            elif text.code == end:
                found.pop(end, None)
    return tuple(found.values())
