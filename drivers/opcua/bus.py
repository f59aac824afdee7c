"""An OPC UA server as a bus: one session, which several devices share. It only reads."""

from collections.abc import Sequence

from drivers.base import placed
from drivers.opcua.nodes import NodeName, NodeValue
from drivers.opcua.settings import OpcUaBusSettings
from drivers.tap import Tap


class OpcUaBus:
    """One session with a server. It is never the control's, whose errors end the session that writes offsets."""

    kind = OpcUaBusSettings.bus_kind
    units = OpcUaBusSettings.units

    def __init__(self, name: str, settings: OpcUaBusSettings, tap: Tap | None = None) -> None:  # noqa: ARG002
        """`tap`: receives nothing, as what passes on the wire is encrypted."""
        # Importing OPC UA takes half a second and 20 MB: only for a bus that needs it.
        from drivers.opcua.session import OpcUaSession

        self.name, self.timeout_s = name, settings.timeout_s
        self._settings = settings
        self._session = OpcUaSession(settings, "", {})

    async def connect(self) -> None:
        """Open the session, unless it is open. Raises ConnectError, NoAnswer, Refused, SetupError."""
        if not self._session.is_open:
            with placed(self.name):
                await self._session.connect()

    async def close(self) -> None:
        await self._session.close()

    def by_uri(self, name: NodeName) -> NodeName:
        """The node named by the URI of its namespace, as the server last numbered them; see `OpcUaSession`."""
        return self._session.by_uri(name)

    async def read(self, device: str, nodes: Sequence[NodeName], *, aged: bool = False) -> list[NodeValue]:
        """What the server says of these nodes. The status of a node that it does not have says so.

        aged: look up how old the values are

        Raises NoAnswer or ConnectError, after which the session is closed, and BadAnswer or Refused.
        """
        with placed(self.name, device):
            return await self._session.read_nodes(tuple(nodes), aged=aged)
