"""A control's agent as a bus: its own connection, which only reads. See docs/agent.md, `values`."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from drivers.agent.connection import AgentConnection, Json
from drivers.agent.greeting import Capability, greeting_of
from drivers.agent.numbers import finite_number, json_object
from drivers.agent.settings import AgentBusSettings, AgentSettings
from drivers.base import BadAnswer, WrongDevice, placed
from drivers.tap import Tap
from drivers.text import Text

_MOST_NAMES = 3000
"""Characters of all names in one question: an agent's longest line has 4096."""


@dataclass(frozen=True, slots=True)
class ToldValues:
    """What an agent says of some of its control's values."""

    values: tuple[float | str | None, ...]
    """In the order of the names: a finite number; a text for what is not a number; None: the control has no such
    name."""
    stale: str
    """Why all of them may be old; empty: they are not."""


class AgentBus:
    """One connection to an agent, beside the one that writes offsets, which it can neither end nor displace."""

    kind = AgentBusSettings.bus_kind
    units = AgentBusSettings.units

    def __init__(self, name: str, settings: AgentBusSettings, tap: Tap | None = None) -> None:  # noqa: ARG002
        """`tap`: receives nothing, as signed lines cannot be played again."""
        self.name, self.timeout_s = name, settings.timeout_s
        self._settings = settings
        self._agent = AgentConnection(
            AgentSettings(
                host=settings.host,
                port=settings.port,
                key_file=settings.key_file,
                timeout_s=settings.timeout_s,
                device="",
            )
        )

    async def connect(self) -> None:
        """Log in as a client that only reads, unless connected.

        Raises ConnectError, NoAnswer, BadAnswer, Refused (the key differs), SetupError (there is no key) and
        WrongDevice for an agent that reports no values.
        """
        if self._agent.is_open:
            return
        with placed(self.name):
            greeting = greeting_of(await self._agent.connect(reads=True), "")
            if Capability.VALUES not in greeting.can:
                await self._agent.close()
                raise WrongDevice(
                    Text("agent_no_values"),
                    hint=Text("agent_needs_values"),
                )

    async def close(self) -> None:
        await self._agent.close()

    async def values(self, device: str, names: Sequence[str]) -> ToldValues:
        """What the control has under these names now.

        Raises ConnectError, NoAnswer or BadAnswer, after which the connection is closed, and Refused.
        """
        found: list[float | str | None] = []
        stale = ""
        with placed(self.name, device):
            for start, end in pairwise(_parts(names)):
                told = json_object(await self._agent.ask("values", names=list(names[start:end])), "values", "")
                found += _listed(told.get("values"), names[start:end])
                stale = stale or _why(told.get("stale"))
        return ToldValues(tuple(found), stale)


def _parts(names: Sequence[str]) -> list[int]:
    """Where the names of each question begin, and the end."""
    parts, length = [0], 0
    for i, name in enumerate(names):
        length += len(name) + 4
        if length > _MOST_NAMES and i > parts[-1]:
            parts.append(i)
            length = len(name) + 4
    return [*parts, len(names)]


def _listed(told: Json, names: Sequence[str]) -> list[float | str | None]:
    if not isinstance(told, list) or len(told) != len(names):
        raise BadAnswer(Text("agent_values", expected=len(names)), hint=Text("agent_version_differs"))
    pairs = zip(told, names, strict=True)
    return [v if v is None or isinstance(v, str) else finite_number(v, f"value {name}", "") for v, name in pairs]


def _why(told: Json) -> str:
    if not isinstance(told, str):
        raise BadAnswer(Text("agent_stale", told=repr(told)), hint=Text("agent_version_differs"))
    return told
