"""An OPC UA server as a bus: one session, which several devices share. It only reads."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress

from drivers.base import ConnectError, DriverError, NoAnswer, placed
from drivers.opcua.nodes import NodeName, NodeValue
from drivers.opcua.settings import OpcUaBusSettings
from drivers.patience import LONGER, Patience
from drivers.tap import Tap
from drivers.text import Text

_PATIENCE_S = 5.0
"""An answer that takes longer, and twice the timeout, never comes."""


class OpcUaBus:
    """One session with a server. It is never the control's, whose errors end the session that writes offsets.

    An answer that is late costs its own reading, not the session: opening one takes many requests to a server that is
    slow. If one has taken longer than the timeout, the next may, too. A session that the server has ended is opened
    again for the next question, and once while that is under way.
    """

    kind = OpcUaBusSettings.bus_kind
    units = OpcUaBusSettings.units

    def __init__(self, name: str, settings: OpcUaBusSettings, tap: Tap | None = None) -> None:  # noqa: ARG002
        """`tap`: receives nothing, as what passes on the wire is encrypted."""
        # Importing OPC UA takes half a second and 20 MB: only for a bus that needs it.
        from drivers.opcua.session import OpcUaSession

        self.name, self.timeout_s = name, settings.timeout_s
        self._settings = settings
        self._session = OpcUaSession(settings, "", {}, patience_s=max(_PATIENCE_S, 2.0 * settings.timeout_s))
        self._patience = Patience(settings.timeout_s)
        self._late: asyncio.Task[list[NodeValue]] | None = None
        """The answer that was not waited for any longer."""
        self._question: tuple[Sequence[NodeName], bool] = (), False
        self._took_s = 0.0
        """How long the latest answer took."""
        self._missed = 0
        """How often in a row an answer was waited for in vain."""

    async def connect(self) -> None:
        """Open the session, unless it is open. Raises ConnectError, NoAnswer, Refused, SetupError."""
        if not self._session.is_open:
            with placed(self.name):
                await self._session.connect()

    async def close(self) -> None:
        """Close the session; an answer that is late is not waited for."""
        late, self._late, self._missed = self._late, None, 0
        await self._session.close()
        if late is not None:
            late.cancel()
            with suppress(asyncio.CancelledError, DriverError):
                await late

    def by_uri(self, name: NodeName) -> NodeName:
        """The node named by the URI of its namespace, as the server last numbered them; see `OpcUaSession`."""
        return self._session.by_uri(name)

    async def read(
        self, device: str, nodes: Sequence[NodeName], *, aged: bool = False, again: bool = False
    ) -> list[NodeValue]:
        """What the server says of these nodes. The status of a node that it does not have says so.

        aged: look up how old the values are
        again: this repeats a question, so a late answer to that is accepted too

        Raises NoAnswer; ConnectError, after which the session is closed; BadAnswer or Refused.
        """
        question = nodes, aged
        with placed(self.name, device):
            late, self._late = self._late, None
            if late is not None and (late.done() or self._took_s > self.timeout_s):
                found = await self._answer(late)
                if again and question == self._question:
                    return found
            self._question = question
            if self._session.is_open:
                with suppress(ConnectError):
                    return await self._ask(nodes, aged)
            await self._session.connect()
            return await self._ask(nodes, aged)

    async def _ask(self, nodes: Sequence[NodeName], aged: bool) -> list[NodeValue]:
        asked_s = asyncio.get_running_loop().time()

        def came(asked: "asyncio.Task[list[NodeValue]]") -> None:
            if not asked.cancelled() and asked.exception() is None:
                self._took_s, self._missed = asyncio.get_running_loop().time() - asked_s, 0

        asking = asyncio.ensure_future(self._session.read_nodes(tuple(nodes), aged=aged))
        asking.add_done_callback(came)
        return await self._answer(asking)

    async def _answer(self, asked: "asyncio.Task[list[NodeValue]]") -> list[NodeValue]:
        is_slow = self._took_s > self.timeout_s
        wait_s = self._patience.late_s(LONGER * self._took_s) if is_slow else self.timeout_s
        self._late = asked
        done, _ = await asyncio.wait((asked,), timeout=wait_s)
        if not done:
            self._missed += 1
            what = Text("opcua_no_answer", timeout_s=wait_s, what=Text("opcua_reads"))
            raise NoAnswer(what, heard=self._missed == 1, hint=Text("opcua_slow"))
        self._late = None
        return asked.result()
