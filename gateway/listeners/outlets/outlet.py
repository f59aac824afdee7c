"""The interface of outlets: an outlet opens, sends, closes, and says what failed. It never waits, retries or logs."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol

from pydantic import Field

from drivers.section import NotNegative, Section, ServerTime, matching
from gateway.config.fields import Name
from gateway.telemetry.codec import MESSAGE_TYPES
from gateway.telemetry.messages import Published


@dataclass(frozen=True, slots=True)
class OutletMessage:
    """One thing that was heard of a machine."""

    machine: str
    suffix: str
    """The key's part below the machine's."""
    message: Published | None
    """None: the machine's gateway has appeared or disappeared."""
    payload: bytes = b""
    """The message as it was published."""
    alive: bool = True
    """Whether the gateway is there."""


class OutletError(OSError):
    """The other side is not there, or does not let us in; what was to be sent is kept and tried again."""


class Unacceptable(OutletError):
    """The other side will never take these messages: they are dropped."""


class Outlet(Protocol):
    """A way into another system. All of it is called from one thread, and may block for the outlet's `timeout_s`."""

    def open(self) -> None:
        """Connect. Raises OutletError."""
        ...

    def send(self, batch: Sequence[OutletMessage]) -> None:
        """Hand these over, in their order; when it returns, the other side has them. Raises OutletError."""
        ...

    def close(self) -> None:
        """Let go of the connection, whatever its state; it may be opened again."""
        ...


PublishedKind = Annotated[str, matching("|".join(MESSAGE_TYPES), f"one of {', '.join(MESSAGE_TYPES)}")]
"""A kind of key."""


class OutletSettings(Section):
    """What every kind of outlet has."""

    name: Name
    """Name for messages."""
    kinds: tuple[PublishedKind, ...] | None = None
    """Kinds of key to pass on (docs/keys.md); None: all that this kind of outlet can pass on."""
    reading_every_s: NotNegative = 0.0
    """Pass on a reading of a channel at most once in this time; a change of its quality always."""
    most_waiting: int = Field(default=20_000, ge=100, le=10_000_000)
    """How many messages wait in memory while the other side is away; after that the oldest are dropped."""
    timeout_s: ServerTime = 10.0
    """How long connecting, or the answer to one batch, may take."""

    @property
    def batch(self) -> int:
        """How many messages are sent together at most."""
        return 100

    @property
    def gather_s(self) -> float:
        """How long the first message of a batch waits for others."""
        return 0.0

    @property
    def possible(self) -> frozenset[str]:
        """Kinds of key that this outlet can pass on."""
        return frozenset(MESSAGE_TYPES)

    @abstractmethod
    def outlet(self) -> Outlet:
        """An outlet with these settings. Uses no network. Raises SetupError."""
