"""Reads a drawn OPC UA server with the gateway's acquisition and with a plain client, and compares."""

import asyncio
import random
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from asyncua import ua
from asyncua.client.client import Client
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.uaerrors import UaError

from drivers.build import make_device
from gateway.acquisition.line import Line
from gateway.model.sample import Sample
from tests.benches.buses import make_bus
from tests.benches.strangers.driven_loop import DrivenLoop, LoopClock, run_driven
from tests.benches.strangers.least_readings import least_readings
from tests.benches.strangers.opcua_server import URIS, ForeignServer, OpcUaNature, age_s, drawn, told
from tests.benches.strangers.polled import Polled

PERIODS = 50
WITHIN = 20
"""So many periods the gateway has to get to know a server."""
_STEP_S = 0.02
"""Of the nodes' time."""
_SECOND_S = 1.0
"""Of timestamps without fractions."""
_PATIENCE_S = 5.0
_URL = "opc.tcp://host:4840"
_CAUSES = {"bad": "opcua_bad_status", "uncertain": "opcua_bad_status", "waiting": "opcua_bad_status"}
_CAUSES_OF_AGED = {"frozen": "opcua_old", "ahead": "opcua_ahead"}
"""What is said of some bursts, if ages are looked up."""


@cache
def _profile(nodes: int, by_index: bool, max_age_s: float) -> str:
    path = Path(tempfile.mkdtemp(prefix="strangers")) / "nodes.toml"
    text = 'protocol = "opcua"\ntitle = "some nodes"\nunit = "1"\n'
    text += "" if by_index else f'namespace = "{URIS[2]}"\n'
    text += f"max_age_s = {max_age_s}\n" if max_age_s else ""
    path.write_text(text + "".join(f'[[node]]\nnode = "{"ns=2;" * by_index}s=T{i}"\n' for i in range(nodes)))
    return str(path)


class OpcUaTrial:
    """One seed."""

    def __init__(self, nature: OpcUaNature, seed: int) -> None:
        self.nature, self.seed = nature, seed
        self.lasts_s = PERIODS * nature.period_s
        self.max_age_s = 2.0 * nature.period_s if nature.aged else 0.0
        self.ours = Polled(self._wrong)
        self.said, self.notices = self.ours.said, self.ours.notices
        self.plain: list[float | None] = []
        """How long after each round was due a plain client had read all; None: it had not."""

    def run(self) -> None:
        run_driven(self._gateway)
        run_driven(self._plain)

    def _serve(self, loop: DrivenLoop) -> None:
        self._began_s = loop.time()
        loop.hosts["host"] = ForeignServer(loop, self.nature, random.Random(self.seed))

    async def _gateway(self, loop: DrivenLoop) -> None:
        self._serve(loop)
        nature, clock = self.nature, LoopClock(loop)
        bus = make_bus("bus", "opcua", {"url": _URL, "security": "none", "timeout_s": nature.timeout_s})
        channels = {str(i): i for i in range(nature.nodes)}
        profile = _profile(nature.nodes, nature.by_index, self.max_age_s)
        driver = make_device("d", bus, profile, 1, channels, {}, clock)
        await self.ours.run(Line(bus, (driver,), nature.period_s), clock, self.lasts_s)

    def _wrong(self, sample: Sample, at_s: float, last_s: float) -> str:
        if told(sample.value) != int(sample.channel):
            return f"shows node {told(sample.value)}"
        old_s = age_s(sample.value, self._began_s + at_s)
        if not self.nature.aged:
            is_old = self.nature.burst != "frozen" and old_s > at_s - last_s + _STEP_S
        else:
            is_old = old_s > self.max_age_s + self.nature.timeout_s + _STEP_S
        return f"is {old_s:.2f} s old" if is_old else ""

    async def _plain(self, loop: DrivenLoop) -> None:
        self._serve(loop)
        nature, due_s = self.nature, loop.time()
        client: Client | None = None
        while loop.time() < self._began_s + self.lasts_s:
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            read = False
            try:
                if client is None:
                    client = Client(_URL, timeout=_PATIENCE_S, watchdog_intervall=1e6)
                    await client.connect()
                    uris = await client.get_namespace_array()
                read = await self._reads(client, uris, loop)
            except (UaError, OSError, TimeoutError):
                if client is not None:
                    client.disconnect_socket()
                    with suppress(Exception):
                        await client.disconnect()
                client = None
            self.plain.append(loop.time() - due_s if read else None)
            due_s = max(due_s + nature.period_s, loop.time())
        if client is not None:
            with suppress(Exception):
                await client.disconnect()

    async def _reads(self, client: Client, uris: list[str], loop: DrivenLoop) -> bool:
        """Whether all nodes are read, as they are now."""
        asked_s, nature = loop.time(), self.nature
        index = 2 if nature.by_index else uris.index(URIS[2])
        nodes = [ua.NodeId(ua.String(f"T{i}"), ua.Int16(index)) for i in range(nature.nodes)]
        most = nature.most or len(nodes)
        values: list[ua.DataValue] = []
        for first in range(0, len(nodes), most):
            values += await client.uaclient.read_attributes(nodes[first : first + most], AttributeIds.Value)
        has_age = not nature.aged or all(value.SourceTimestamp is not None for value in values)
        return has_age and all(
            (value.StatusCode is None or value.StatusCode.is_good())
            and value.Value is not None
            and told(value.Value.Value) == number
            and age_s(value.Value.Value, loop.time()) <= loop.time() - asked_s + _STEP_S
            for number, value in enumerate(values)
        )

    def problems(self) -> Iterator[str]:
        """What is not as it must be."""
        yield from self.ours.wrong[:3]
        nature, since_s = self.nature, WITHIN * self.nature.period_s
        theirs = self.plain[WITHIN * len(self.plain) // PERIODS :]
        ours = self.ours.readings("0", since_s)
        moves = nature.by_index and nature.renumbers and self.lasts_s > nature.every_s
        if ours < least_readings(theirs, nature.period_s) and not (nature.burst == "ahead" or moves):
            yield f"{ours} readings, a plain client has {sum(t is not None for t in theirs)} of {len(theirs)}"
        if moves and ours and not self.ours.says("opcua_namespace_moved"):
            yield "nothing says that the namespaces have moved"
        cause = _CAUSES.get(nature.burst) or (_CAUSES_OF_AGED.get(nature.burst) if nature.aged else None)
        answers = not (nature.mute_s or nature.lingers_s or nature.closes_s or nature.closes_after or nature.session_s)
        is_long = nature.burst_s > 3 * nature.period_s + self.max_age_s + nature.timeout_s
        prompt = nature.took_s + nature.jitter_s + nature.slower_s + nature.pieces_s < nature.timeout_s / 4
        seen = self.lasts_s > nature.every_s and nature.stamps != "none" and not nature.swallows
        if cause and answers and is_long and prompt and seen and not self.ours.says(cause):
            yield f"nothing says {cause}"


def tried(seed: int) -> OpcUaTrial:
    """The trial of that seed."""
    trial = OpcUaTrial(drawn(random.Random(seed)), seed)
    trial.run()
    return trial
