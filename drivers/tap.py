"""The tap of a bus: it receives everything that passes on its wire, in order."""

from typing import Protocol


class Tap(Protocol):
    """Receives what passes. Called from any thread; must return at once and never raise."""

    def data(self, sent: bool, data: bytes) -> None:
        """Bytes of a serial line or a TCP connection."""
        ...

    def frame(self, sent: bool, identifier: int, extended: bool, data: bytes) -> None:
        """A CAN data frame."""
        ...

    def note(self, text: str) -> None:
        """The connection: `open`, `close`, or `lost` and why."""
        ...
