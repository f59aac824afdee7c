"""Channels from another maker's OPC UA stack (node-opcua)."""

from pathlib import Path

import pytest

from drivers.base import Quality, SystemClock
from drivers.build import make_device
from tests.benches.buses import make_bus
from tests.benches.node_opcua_site import secured
from tests.benches.npm_peer import node_with, running

pytestmark = pytest.mark.peer

PROFILE = """
protocol = "opcua"
title = "axes of the control"
unit = "mm"
namespace = "SinumerikVarProvider"
max_age_s = 60
[[node]]
node = "s=/Channel/MachineAxis/actToolBasePos[u1,2]"
[[node]]
node = "s=/Channel/MachineAxis/actToolBasePos[u1,99]"
"""


async def test_channels_with_user_and_certificates(tmp_path: Path) -> None:
    site = await secured(tmp_path, "gateway")
    profile = tmp_path / "axes.toml"
    profile.write_text(PROFILE)
    async with running(node_with("node_opcua", "node-opcua"), "node_opcua/server.js", *site.arguments) as (url, _):
        fields: dict[str, object] = {
            "url": url,
            "user": "gateway",
            "password_file": str(site.password),
            "certificate": str(tmp_path / "gateway.der"),
            "private_key": str(tmp_path / "gateway_key.pem"),
            "server_certificate": str(tmp_path / "peer.der"),
            "timeout_s": 60.0,
        }
        bus = make_bus("opc1", "opcua", fields)
        device = make_device("axes", bus, str(profile), 1, {"y": 0, "nothing": 1}, {}, SystemClock())
        try:
            await bus.connect()
            await device.connect()
            y, nothing = await device.read()
        finally:
            await bus.close()
    assert (y.value, y.unit, y.quality) == (-20.25, "mm", Quality.GOOD)
    assert (nothing.quality, nothing.detail[:41]) == (Quality.COMM_FAULT, "the server reports BadNodeIdUnknown: comp")
