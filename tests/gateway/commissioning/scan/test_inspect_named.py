"""`inspect objects` and `inspect nodes`: what third-party nodes and servers contain, and drafts that read the same."""

import asyncio
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from drivers.opcua.profile import OpcUaProfile
from drivers.profiles import load_profile
from gateway.cli.main import main
from simulators.devices import SlcanAdapter
from tests.benches.library_node import EDS, NODE, LibraryNode
from tests.benches.opcua_drives import URI, Drives
from tests.benches.started import started
from tests.benches.terminal_tables import row_of


async def inspect(*words: str) -> Result:
    return await asyncio.to_thread(
        CliRunner().invoke, main, ["inspect", *words, "--timeout", "60"], env={"COLUMNS": "200"}
    )


async def test_objects_of_the_librarys_node(tmp_path: Path) -> None:
    (tmp_path / "pump.eds").write_text(EDS, encoding="cp1252")
    adapter = SlcanAdapter([LibraryNode(tmp_path / "pump.eds")])
    draft = tmp_path / "draft.toml"
    async with started(adapter) as channel:
        wanted = (channel, str(NODE), "2100:01", "2100:02", "3000", "--interface", "slcan")
        done = await inspect("objects", *wanted, "--draft", str(draft), "--type", "int16", "--scale", "0.1")
    assert done.exit_code == 0, done.output
    first, second = row_of(done.output, "2100:01"), row_of(done.output, "2100:02")
    assert first[1:4] == ["29 ff", "-215", "65321"]
    assert (second[1], second[-2]) == ("00 00 26 42", "41.50")
    assert "node 5 refused object 3000:00: Code 0x06020000" in done.output
    text = draft.read_text()
    assert '# seen: -215\nindex = 0x2100\nsubindex = 1\ntype = "int16"\nscale = 0.1' in text
    assert load_profile(str(draft)).channels == 1, "one object has the size of the type"


@pytest.mark.slow
async def test_nodes_of_a_server(tmp_path: Path) -> None:
    server, draft = Drives(), tmp_path / "draft.toml"
    await server.start()
    try:
        names = (f"nsu={URI};s=motor", f"nsu={URI};s=name", "ns=0;i=99999", f"nsu={URI};s=bearing")
        done = await inspect("nodes", server.url, *names, "--draft", str(draft))
    finally:
        await server.server.stop()
    assert done.exit_code == 0, done.output
    assert row_of(done.output, names[0])[1:4] == ["61.25", "float", "Good"]
    assert row_of(done.output, names[1])[1:4] == ["'drive'", "str", "Good"]
    assert row_of(done.output, names[2])[3] == "BadNodeIdUnknown"
    assert f'# seen: 61.25\nnode = "{names[0]}"' in draft.read_text()
    assert load_profile(str(draft)).channels == 2, "the numbers"


async def test_nodes_that_hold_bytes(tmp_path: Path) -> None:
    """Such as the process data of an IO-Link device."""
    server, draft = Drives(), tmp_path / "draft.toml"
    await server.start()
    name = f"nsu={URI};s=bytes"
    try:
        await server.set("bytes", bytes.fromhex("FFDF41BC0000"))
        alone = await inspect("nodes", server.url, name, "--draft", str(tmp_path / "other.toml"))
        done = await inspect("nodes", server.url, name, "--draft", str(draft), "--type", "int16", "--scale", "0.1")
    finally:
        await server.server.stop()
    assert alone.exit_code == 2
    assert "no node holds a good number; --type says how its bytes hold one: no draft was written" in alone.output
    assert done.exit_code == 0, done.output
    assert row_of(done.output, "0") == ["0", "FF", "255", "-33", "-3.3", "-2145860", "nan"]
    assert row_of(done.output, "2")[-1] == "23.50"
    assert row_of(done.output, "5") == ["5", "00", "0", "", "", "", ""]
    profile = load_profile(str(draft))
    assert "# seen: ff df 41 bc 00 00" in draft.read_text()
    assert isinstance(profile, OpcUaProfile)
    (node,) = profile.nodes
    assert (node.node, node.element, node.type, node.scale) == (name, 0, "int16", 0.1)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("objects", "can0", "5", "10"), "expected an index of 1000 to FFFF"),
        (("objects", "can0", "5", "2100", "--draft", "a.toml"), "--draft needs --type"),
        (("nodes", "opc.tcp://nowhere", "motor"), "'motor' is not a node id; expected such as"),
        (("nodes", "http://nowhere", "i=1"), "opc.tcp://host:port"),
    ],
)
async def test_mistakes_are_named(words: tuple[str, ...], told: str) -> None:
    done = await inspect(*words)
    assert done.exit_code == 2
    assert told in done.output
