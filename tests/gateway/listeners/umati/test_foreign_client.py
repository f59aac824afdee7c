"""Another maker's OPC UA client (node-opcua) reads what a machine publishes, and can change nothing."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from gateway.listeners.umati.server import MachineToolServer
from gateway.listeners.umati.settings import OpcUaServing, ServerSecurity, ShownMachine
from gateway.runtime.passwords import make_hash
from gateway.telemetry.subscriber.site import SiteSeen
from tests.benches.heard import BEGAN, STEP, HeardMachine
from tests.benches.node_opcua_site import secured
from tests.benches.npm_peer import PEERS, node_with

pytestmark = pytest.mark.peer

OWN = "urn:talc-gateway"
MACHINE_TOOL, DI = "http://opcfoundation.org/UA/MachineTool/", "http://opcfoundation.org/UA/DI/"
PLATE = ShownMachine(manufacturer="Muster AG", serial_number="4711", product_instance_uri="https://muster.example/4711")


def a_machine() -> HeardMachine:
    machine = HeardMachine()
    machine.decision(1, {"EX0C": 12.5})
    machine.passes(STEP)
    machine.decision(2, {"EX0C": 13.5, "EC0C": None})
    machine.reasons(2)
    machine.compensation((1.0, -2.0, 3.0), k=2)
    machine.reading("spindle_front", 31.25)
    machine.reading("bed", None, "sensor_fault")
    machine.status()
    return machine


@asynccontextmanager
async def serving(machine: HeardMachine, settings: OpcUaServing) -> AsyncIterator[MachineToolServer]:
    site = SiteSeen("talc", ("mill",), lambda: machine.now, lambda: machine.now_s)
    with site.machines() as machines:
        machines["mill"] = machine.seen
    async with MachineToolServer(site, {"mill": PLATE}, settings, "127.0.0.1", 0) as server:
        yield server


class ForeignClient:
    """The peer's program."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def line(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        while not (line := await self._process.stdout.readline()).startswith(b"{"):  # its libraries print, too
            assert line, "the peer ended"
        found: dict[str, Any] = json.loads(line)
        return found

    async def read(self) -> dict[str, Any]:
        """What it finds now."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"read\n")
        while "mill" not in (found := await self.line()):
            pass  # notifications
        return found


@asynccontextmanager
async def client(folder: Path, url: str, *more: object) -> AsyncIterator[ForeignClient]:
    node = await asyncio.to_thread(node_with, "node_opcua", "node-opcua")
    process = await asyncio.create_subprocess_exec(
        node,
        str(PEERS / "node_opcua" / "client.js"),
        str(folder / "client_pki"),
        url,
        *map(str, more),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        limit=2**22,
    )
    assert process.stdin is not None
    try:
        yield ForeignClient(process)
    finally:
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), 60.0)
        except TimeoutError:
            process.kill()
            await process.wait()


async def test_it_finds_the_machine_reads_follows_and_can_change_nothing(tmp_path: Path) -> None:
    machine = a_machine()
    async with serving(machine, OpcUaServing()) as server, client(tmp_path, server.url) as peer:
        found = await peer.line()
        assert found["mill"]["type"] == [MACHINE_TOOL, 13]
        plate = "mill/Identification"
        assert (found[plate]["uri"], found[plate]["type"]) == (DI, [MACHINE_TOOL, 11])
        assert found[f"{plate}/Manufacturer"]["value"]["text"] == "Muster AG"
        assert found[f"{plate}/SerialNumber"]["value"] == "4711"

        error = found["mill/Monitoring/ThermalErrors/EX0C"]
        assert (error["value"], error["status"], error["uri"]) == (13.5, "Good", OWN)
        assert error["source"] == (BEGAN + STEP).strftime("%Y-%m-%dT%H:%M:%S.000Z")
        unit = found["mill/Monitoring/ThermalErrors/EX0C/EngineeringUnits"]["value"]
        assert (unit["unitId"], unit["displayName"]["text"]) == (13384, "µm")
        assert found["mill/Monitoring/ThermalErrors/EC0C"]["status"] == "BadNoData"
        spindle, bed = (found[f"mill/Monitoring/Channels/{name}"] for name in ("spindle_front", "bed"))
        assert (spindle["value"], spindle["status"], bed["status"]) == (31.25, "Good", "BadSensorFailure")
        assert bed.get("value") is None
        assert found["mill/Monitoring/MachineTool/OperationMode"]["status"] == "BadNotSupported"

        cycle = "mill/Notification/Prognoses/NextProbingCycle"
        assert found[cycle]["type"] == [MACHINE_TOOL, 9]
        assert found[f"{cycle}/PredictedTime"]["value"] == (BEGAN + 13 * STEP).strftime("%Y-%m-%dT%H:%M:%S.000Z")
        assert found[f"{cycle}/Activity"]["value"]["text"].startswith("Probing cycle")

        tried = await peer.line()
        assert len(tried) > 3 * 40
        refusals = {"BadUserAccessDenied", "BadNotWritable", "BadServiceUnsupported"}
        assert {what: answer for what, answer in tried.items() if answer not in refusals} == {}

        assert (await peer.line())["value"] == 13.5
        machine.passes(STEP)
        machine.decision(3, {"EX0C": 14.5})
        await server.show()
        assert (await peer.line())["value"] == 14.5

        machine.seen.disappear(machine.now)
        await server.show()
        assert (await peer.line())["status"] == "BadNoCommunication"
        gone = await peer.read()
        heard = {name: node["status"] for name, node in gone.items() if node["uri"] == OWN and "status" in node}
        assert set(heard.values()) == {"BadNoCommunication"}
        assert found.keys() == gone.keys()


async def test_with_a_certificate_it_needs_encryption_a_user_and_the_password(tmp_path: Path) -> None:
    await secured(tmp_path, "gateway")
    security = ServerSecurity(certificate=tmp_path / "gateway.der", private_key=tmp_path / "gateway_key.pem")
    settings = OpcUaServing(security=security, users={"anna": make_hash("grüezi")})
    own = (tmp_path / "peer.pem", tmp_path / "peer_key.pem")
    async with serving(a_machine(), settings) as server:
        users = ("anna", "grüezi", "--", "anna", "wrong", *own, "--", "anna", "grüezi", *own)
        async with client(tmp_path, server.url, *users) as peer:
            assert "refused" in await peer.line(), "without a certificate"
            assert "refused" in await peer.line(), "with a wrong password"
            found = await peer.line()
            assert found["mill/Monitoring/ThermalErrors/EX0C"]["value"] == 13.5
            tried = await peer.line()
            assert tried["Value of mill/Monitoring/ThermalErrors/EX0C"] == "BadUserAccessDenied"
