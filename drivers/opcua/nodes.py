"""Names of OPC UA nodes as text, a server's answers about them, and what these mean for a channel. No network."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Final
from uuid import UUID

from pydantic import AfterValidator

from drivers.base import Quality
from drivers.faults import Fault
from drivers.text import Text, shown

_FORM = re.compile(r"(?:ns=(\d+);|nsu=([^;\s]+);)?(i=\d+|s=.+|g=[0-9A-Fa-f-]{36}|b=[A-Za-z0-9+/=]+)", re.DOTALL)

_MOST_INDEX = 0xFFFF
"""Of a namespace."""
_MOST_NUMBER = 0xFFFF_FFFF
"""Of a numeric id."""


@dataclass(frozen=True, slots=True)
class NodeName:
    """A node, however the server numbers its namespaces at present."""

    identifier: str
    """Kind and identifier, such as `s=Temperature`."""
    namespace: int | str
    """Index, or URI."""

    def __str__(self) -> str:
        if not self.namespace:
            return self.identifier
        return f"{'ns' if isinstance(self.namespace, int) else 'nsu'}={self.namespace};{self.identifier}"


def node_name(text: str, namespace: str | None = None) -> NodeName:
    """From a `NodeText`; `namespace` is the URI for one that states none. Raises ValueError."""
    found = _FORM.fullmatch(text)
    if found is None or not _is_possible(found[1], found[3]):
        raise ValueError(f"{text!r} is not a node id")
    index, uri, identifier = found.groups()
    return NodeName(identifier, uri or (int(index) if index is not None else namespace or 0))


def _is_possible(index: str | None, identifier: str) -> bool:
    """Whether the wire can carry these numbers: otherwise every request for the node would fail."""
    kind, _, rest = identifier.partition("=")
    try:
        if kind == "g":
            UUID(rest)
        return int(index or "0") <= _MOST_INDEX and (kind != "i" or int(rest) <= _MOST_NUMBER)
    except ValueError:
        return False


def _checked(text: str) -> str:
    try:
        node_name(text)
    except ValueError:
        raise ValueError(Text("opcua_a_node", value=shown(text))) from None
    return text


NodeText = Annotated[str, AfterValidator(_checked)]
"""A node id in OPC UA's notation (Part 6, 5.3.1.10), its namespace by index or by URI."""


@dataclass(frozen=True, slots=True)
class NodeValue:
    """What a server says of one node."""

    value: object
    status: int = 0
    """StatusCode (Part 4, 7.39); 0 is good."""
    status_name: str = "Good"
    source_time: datetime | None = None
    """By the clock of its source; None if the server states none."""
    age_s: float | None = None
    """From the source time to the server's own present time; None if either is not known."""
    detail: str = ""
    """What the gateway knows against the value, whatever the server says of it."""

    @property
    def data(self) -> bytes | None:
        """The bytes that it holds, as a ByteString or an array; None: it holds something else."""
        if isinstance(self.value, bytes):
            return self.value
        try:
            return bytes(self.value) if isinstance(self.value, list) else None
        except (TypeError, ValueError):  # an array of something else
            return None

    @property
    def is_unknown(self) -> bool:
        """Whether the server does not have the node."""
        return self.status & _CODE in _UNKNOWN

    def fault(self) -> Fault | None:
        """What the status says against the value; None if it is good."""
        if self.detail:
            return Fault(Quality.COMM_FAULT, self.detail)
        code = self.status & _CODE
        quality = _QUALITIES.get(code)
        if quality is None and not self.status & _SEVERITY:
            limit = _LIMITS.get(self.status & _DETAILS)
            text = Text("opcua_at_limit", limit=limit)
            return None if limit is None else Fault(Quality.OUT_OF_RANGE, text)
        if quality is None:
            quality = Quality.SENSOR_FAULT if self.status & _SEVERITY == _UNCERTAIN else Quality.COMM_FAULT
        said = "opcua_unknown_node" if self.is_unknown else "opcua_bad_status"
        return Fault(quality, Text(said, status=self.status_name))


NO_NAMESPACE: Final = NodeValue(None, 0x8033_0000, "BadNodeIdInvalid")
"""The value of a node in a namespace that the server does not have."""


def moved(index: int, known: str, found: str) -> NodeValue:
    """The value of a node whose namespace index belonged to another namespace at the first connection."""
    what = Text("opcua_namespace_moved", index=index, known=known, found=found or "none")
    return NodeValue(None, NO_NAMESPACE.status, NO_NAMESPACE.status_name, detail=what)


_CODE = 0xFFFF_0000
"""Bits of a status: all but its details."""
_SEVERITY = 0xC000_0000
"""Bits of a status: good, uncertain or bad."""
_UNCERTAIN = 0x4000_0000
_DETAILS = 0x0F00
_LIMITS = {0x0500: "low", 0x0600: "high"}
"""Details that say that the value stands at the end of what its source can measure (Part 4, 7.39, LimitBits)."""
_UNKNOWN = (0x8034_0000, 0x8033_0000, 0x8035_0000)
"""BadNodeIdUnknown, BadNodeIdInvalid, BadAttributeIdInvalid."""
_QUALITIES: Mapping[int, Quality] = {
    0x0096_0000: Quality.SENSOR_FAULT,  # GoodLocalOverride: somebody has entered the number by hand
    0x8089_0000: Quality.SENSOR_FAULT,  # BadConfigurationError
    0x808B_0000: Quality.SENSOR_FAULT,  # BadDeviceFailure
    0x808C_0000: Quality.SENSOR_FAULT,  # BadSensorFailure
    0x803C_0000: Quality.OUT_OF_RANGE,  # BadOutOfRange
    0x408F_0000: Quality.STALE,  # UncertainNoCommunicationLastUsableValue
    0x4090_0000: Quality.STALE,  # UncertainLastUsableValue
    0x4094_0000: Quality.OUT_OF_RANGE,  # UncertainEngineeringUnitsExceeded
    0x40F2_0000: Quality.OUT_OF_RANGE,  # UncertainOverRange
    0x40F3_0000: Quality.OUT_OF_RANGE,  # UncertainUnderRange
}
"""Where the severity alone does not tell: uncertain otherwise is a sensor fault, bad a communication fault."""
