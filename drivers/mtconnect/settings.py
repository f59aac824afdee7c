"""Settings of a control with an MTConnect agent: its address, and which data item is what. No network."""

from collections.abc import Mapping
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from drivers.nc import AXES
from drivers.section import NotEmpty, Section, ServerTime, matching
from drivers.text import Text, shown

_AS_IN_PROBE = "mtconnect_an_id"
ItemId = Annotated[str, matching(r"[^\s\"'<>&]+", _AS_IN_PROBE)]
ItemIdOrNone = Annotated[str, matching(r"[^\s\"'<>&]*", _AS_IN_PROBE)]


def _http(url: str) -> str:
    parts = urlsplit(url)
    try:
        good = parts.scheme == "http" and parts.hostname and parts.port != 0
    except ValueError:  # a port that is not a number of 1 to 65535
        good = False
    if not good or parts.query or parts.fragment or parts.username is not None:
        raise ValueError(Text("http_url", value=shown(url)))
    return url


def _all_axes(positions: Mapping[str, str]) -> Mapping[str, str]:
    if set(positions) != set(AXES):
        raise ValueError(Text("mtconnect_positions", given=tuple(positions) or "-", axes=AXES))
    return positions


AgentUrl = Annotated[NotEmpty, AfterValidator(_http)]
MachineOfAgent = Annotated[str, matching(r"[\w.-]*", "mtconnect_a_machine")]


class MtConnectSettings(Section):
    """An MTConnect agent and the ids of its data items, from the answer to its request `/probe`."""

    url: AgentUrl
    """Address of the agent, such as `http://192.168.0.30:5000`."""
    machine: MachineOfAgent = ""
    """Name or uuid of the machine, if the agent has several; empty: all are read."""
    positions: Annotated[Mapping[str, ItemId], AfterValidator(_all_axes)]
    """X, Y, Z, A and C, each with the id of the data item of its position, of the tool's tip in machine coordinates."""
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """X, Y, Z of these data items at which the tip of the tool is where A and C meet."""
    states: Mapping[str, ItemId] = Field(default_factory=dict)
    """Machine state to the id of its data item: `spindle_speed` and `speed_A`, `speed_C` become 1/min, `speed_X` to
    `speed_Z` mm/min, whatever the agent's unit is; `ON`, `ACTIVE` and `OPEN` become 1, `OFF`, `INACTIVE` and `CLOSED`
    0."""
    mode: ItemIdOrNone = ""
    """Id of the data item CONTROLLER_MODE; empty: not read."""
    program: ItemIdOrNone = ""
    """Id of the data item EXECUTION; empty: not read."""
    tool: ItemIdOrNone = ""
    """Id of the data item TOOL_NUMBER; empty: not read."""
    emergency_stop: ItemIdOrNone = ""
    """Id of the data item EMERGENCY_STOP; empty: not read."""
    timeout_s: ServerTime = 2.0
    """How long one answer may take."""
