"""Nodes outside CiA 404: objects by hand or by an EDS, read from the canopen library's own node and by TPDOs."""

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import datatypes

from drivers.base import Driver, Refused, SetupError, SystemClock, WrongDevice
from drivers.build import make_device
from drivers.canopen.objects import CanOpenProfile
from drivers.profiles import load_profile, user_profile
from simulators.devices import Cia404Node, SlcanAdapter
from tests.benches.buses import make_bus
from tests.benches.driver_reads import told
from tests.benches.library_node import EDS, NODE, LibraryNode
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

HEAD = 'protocol = "canopen"\ntitle = "pump"\nunit = "degC"\n'
PROFILE = (
    HEAD
    + """eds = "pump.eds"
vendor_id = 0x17
product_code = 0x194
[[object]]
index = 0x2100
subindex = 1
scale = 0.1
invalid = [{ equals = 0x7FFF, quality = "sensor_fault", detail = "open" }]
[[object]]
index = 0x2100
subindex = 2
unit = "K"
high = 90.0
"""
)


def written(folder: Path, text: str, name: str = "pump.toml") -> str:
    (folder / "pump.eds").write_text(EDS, encoding="cp1252")
    (folder / name).write_text(text)
    return str(folder / name)


@asynccontextmanager
async def local_node(folder: Path, profile: str, count: int) -> AsyncIterator[tuple[canopen.LocalNode, Driver]]:
    """The library's node, and our driver of it."""
    node = LibraryNode(folder / "pump.eds")
    adapter = SlcanAdapter([node])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 5.0})
    driver = make_device("pump", bus, profile, NODE, {f"c{i}": i for i in range(count)}, {}, SystemClock())
    try:
        await bus.connect()
        yield node.local, driver
    finally:
        await bus.close()
        await adapter.stop()


async def test_objects_by_the_eds(tmp_path: Path) -> None:
    async with local_node(tmp_path, written(tmp_path, PROFILE), 2) as (node, driver):
        await driver.connect()
        assert told(await driver.read()) == [(-21.5, "degC"), (41.5, "K")]
        node.set_data(0x2100, 1, struct.pack("<h", 0x7FFF))
        node.set_data(0x2100, 2, struct.pack("<f", 90.5))
        assert told(await driver.read()) == [
            ("sensor_fault", "open"),
            ("out_of_range", "90.5 is beyond the profile's limits"),
        ]
        node.data_store[0x2100][2] = b"\x01\x02"  # the library would refuse to set it
        assert told(await driver.read())[1] == ("comm_fault", "object 2100:02 holds 2 bytes, but a float32 takes 4")


async def test_a_refused_object_takes_its_own_channel_only(tmp_path: Path) -> None:
    by_hand = HEAD + "".join(
        f'[[object]]\nindex = {index}\nsubindex = {sub}\ntype = "int16"\n' for index, sub in ((0x2100, 1), (0x3000, 4))
    )
    async with local_node(tmp_path, written(tmp_path, by_hand), 2) as (_, driver):
        await driver.connect()
        first, second = told(await driver.read())
        assert first == (-215.0, "degC")
        assert second[0] == "comm_fault"
        assert second[1].startswith("node 5 refused object 3000:04: Code 0x06020000")


@pytest.mark.parametrize(
    ("profile", "error", "message"),
    [
        (PROFILE.replace("0x194", "0x195"), WrongDevice, "canopen_identity node=5 canopen_check_profile"),
        (
            HEAD + '[[object]]\nindex = 0x3000\ntype = "int16"\n',
            Refused,
            "canopen_refused node=5 wanted=3000:00 profile_fits",
        ),
    ],
)
async def test_another_device_is_refused(tmp_path: Path, profile: str, error: type[Exception], message: str) -> None:
    count = profile.count("[[object]]")
    async with local_node(tmp_path, written(tmp_path, profile), count) as (_, driver):
        with refusing(error, message):
            await driver.connect()


@pytest.mark.parametrize("transfer", ["sync", "timer"])
async def test_mapped_objects_come_by_tpdo(tmp_path: Path, transfer: str) -> None:
    """A CiA 404 node read by its objects, without a vendor."""
    text = HEAD + "".join(f'[[object]]\nindex = 0x9130\nsubindex = {i}\ntype = "int32"\nscale = 0.1\n' for i in (1, 2))
    node = Cia404Node(NODE, lambda: [20.0, -3.3], inputs=2, event_ms=60 if transfer == "timer" else 0)
    adapter = SlcanAdapter([node])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.2})
    profile = written(tmp_path, text)
    driver = make_device("node", bus, profile, NODE, {"a": 0, "b": 1}, {"transfer": transfer}, SystemClock())
    node.start(adapter.send)
    try:
        await bus.connect()
        await driver.connect()
        first = await driver.read()
        assert [r.value for r in first] == pytest.approx([20.0, -3.3])
        if transfer == "timer":  # the same frame, read again
            await asyncio.sleep(0.04)
            assert [r.monotonic_s for r in await driver.read()] == pytest.approx([r.monotonic_s for r in first])
    finally:
        node.stop()
        await bus.close()
        await adapter.stop()


async def test_values_of_a_node_whose_heartbeat_has_stopped_are_stale(tmp_path: Path) -> None:
    text = HEAD + '[[object]]\nindex = 0x9130\nsubindex = 1\ntype = "int32"\nscale = 0.1\n'
    node = Cia404Node(NODE, lambda: [20.0], inputs=1, heartbeat_ms=50)
    adapter = SlcanAdapter([node])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.2})
    driver = make_device("node", bus, written(tmp_path, text), NODE, {"a": 0}, {}, SystemClock())
    node.start(adapter.send)
    try:
        await bus.connect()
        await driver.connect()
        assert told(await driver.read()) == [(20.0, "degC")]
        await asyncio.sleep(0.5)  # it has come at least once
        node.heartbeat_stopped = True
        await asyncio.sleep(1.0)
        ((quality, detail),) = told(await driver.read())
        assert quality == "stale"
        assert "heartbeat stopped" in detail
    finally:
        node.stop()
        await bus.close()
        await adapter.stop()


@pytest.mark.parametrize(
    ("objects", "message"),
    [
        ("index = 0x2101", "index: the EDS has no object 2101"),
        ("index = 0x2100\nsubindex = 3", "subindex: the EDS has no object 2100:03"),
        ("index = 0x2200", "index: by the EDS object 2200:00 (Name) is no number"),
        ("index = 0x2201", "index: by the EDS object 2201:00 (Set point) cannot be read"),
        ("index = 0x1000\nsubindex = 1", "subindex: 1: by the EDS object 1000 is one number, sub-index 0"),
        (
            'index = 0x2100\nsubindex = 1\ntype = "int32"',
            "type: 'int32', but by the EDS object 2100:01 (Bearing) is int16",
        ),
        ("index = 0x2100\nsubindex = 1\nscale = 0", "scale: 0 would make every value the same"),
        (
            "index = 0x2100\nsubindex = 1\ninvalid = [{ high = 40000, quality = 'sensor_fault', detail = 'x' }]",
            "expected -32768 to 32767",
        ),
    ],
)
def test_mistakes_are_named(tmp_path: Path, objects: str, message: str) -> None:
    profile = written(tmp_path, HEAD + f'eds = "pump.eds"\n[[object]]\n{objects}\n')
    with pytest.raises(SetupError) as caught:
        load_profile(profile)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (datatypes.BOOLEAN, "bool"), (datatypes.INTEGER8, "int8"), (datatypes.INTEGER16, "int16"),
        (datatypes.INTEGER32, "int32"), (datatypes.INTEGER64, "int64"), (datatypes.UNSIGNED8, "uint8"),
        (datatypes.UNSIGNED16, "uint16"), (datatypes.UNSIGNED32, "uint32"), (datatypes.UNSIGNED64, "uint64"),
        (datatypes.REAL32, "float32"), (datatypes.REAL64, "float64"),
    ],
)  # fmt: skip
def test_each_type_of_an_eds_is_the_one_of_the_library(tmp_path: Path, number: int, kind: str) -> None:
    profile = written(tmp_path, HEAD + 'eds = "pump.eds"\n[[object]]\nindex = 0x2100\nsubindex = 1\n')
    (tmp_path / "pump.eds").write_text(EDS.replace("DataType=0x3\n", f"DataType={number:#x}\n"), encoding="cp1252")
    loaded = load_profile(profile)
    assert isinstance(loaded, CanOpenProfile)
    assert loaded.types == (kind,)


def test_a_type_is_stated_once(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="type: missing; state it, or give the node's EDS file as eds"):
        load_profile(written(tmp_path, HEAD + "[[object]]\nindex = 0x2100\n"))
    broken = written(tmp_path, PROFILE)
    (tmp_path / "pump.eds").write_text("no section\n")
    with pytest.raises(SetupError, match=r"eds: .*pump.eds cannot be read"):
        load_profile(broken)


def test_the_eds_belongs_to_the_profile(tmp_path: Path) -> None:
    """A change of it is a change of the configuration."""
    profile = written(tmp_path, PROFILE)
    before = user_profile(profile)
    (tmp_path / "pump.eds").write_text(EDS.replace("DataType=0x3", "DataType=0x4"), encoding="cp1252")
    after = user_profile(profile)
    assert before.content_hash != after.content_hash
    assert after.other is not None
    assert after.other[0] == "eds"


OTHER = "[3000]\nParameterName=Other\nObjectType=0x7\nDataType=0x7\nAccessType=rw\n"
VARIANTS = {
    "another object without DataType": EDS + OTHER.replace("DataType=0x7\n", ""),
    "another object without AccessType": EDS + OTHER.replace("AccessType=rw\n", ""),
    "another object without ParameterName": EDS + OTHER.replace("ParameterName=Other\n", ""),
    "empty numbers": EDS + OTHER.replace("=0x7", "="),
    "words for numbers": EDS + OTHER.replace("=0x7", "=UNSIGNED32"),
    "sub-section without its parent": EDS + OTHER.replace("[3000]", "[3001sub1]"),
    "the channels' own parent is missing": EDS.replace("[2100]", "[9999]"),
    "leading zeros": EDS.replace("DataType=0x3", "DataType=003") + "[DeviceInfo]\nVendorNumber=001\n",
    "lines that are not numbered as counted": EDS + "[Comments]\nLines=5\nline5=x\n",
    "partial DummyUsage": EDS + "[DummyUsage]\nDummy0001=\nDummy0005=1\n",
    "a line without an equals sign": EDS + "whatever\n" + OTHER,
    "duplicate keys of another": EDS + OTHER + "DataType=0x3\n",
    "duplicate sections": EDS + OTHER + OTHER,
    "indented": EDS.replace("\n", "\n  "),
    "a DOMAIN": EDS + OTHER.replace("DataType=0x7", "DataType=0xF").replace("Type=0x7", "Type=0x2"),
    "wide and odd integers": EDS
    + "".join(OTHER.replace("30", f"31{n:X}").replace("0x7\nA", f"0x{n:X}\nA") for n in range(0x10, 0x1B)),
    "upper and lower case": EDS.replace("2100sub", "2100SUB").replace("DataType", "datatype"),
    "a comment behind": EDS.replace("DataType=0x3", "DataType=0x3 ; INTEGER16"),
}


@pytest.mark.parametrize("text", VARIANTS.values(), ids=VARIANTS.keys())
@pytest.mark.parametrize("encoding", ["cp1252", "utf-8-sig", "utf-16"])
def test_what_no_channel_needs_in_the_eds_does_not_matter(tmp_path: Path, text: str, encoding: str) -> None:
    profile = written(tmp_path, PROFILE)
    (tmp_path / "pump.eds").write_text(text, encoding=encoding)
    loaded = load_profile(profile)
    assert isinstance(loaded, CanOpenProfile)
    assert loaded.types == ("int16", "float32")
    assert user_profile(profile).other is not None


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("DataType=0x3\n", "DataType=0x3\nDataType=0x4\n"),
        ("DataType=0x3\n", "DataType=0xF\n"),
        ("DataType=0x3\n", "DataType=0x10\n"),
        ("DataType=0x3\n", ""),
        ("DataType=0x3\nAccessType=ro", "DataType=0x3\nAccessType=wo"),
    ],
    ids=["two types", "a DOMAIN", "INTEGER24", "no type", "not readable"],
)
def test_what_a_channel_needs_in_the_eds_matters(tmp_path: Path, old: str, new: str) -> None:
    profile = written(tmp_path, PROFILE)
    assert old in EDS
    (tmp_path / "pump.eds").write_text(EDS.replace(old, new), encoding="cp1252")
    with pytest.raises(SetupError, match=r"object\[0\]\."):
        load_profile(profile)


def test_a_compact_array_has_its_members(tmp_path: Path) -> None:
    compact = EDS[: EDS.index("[2100sub0]")].replace("SubNumber=3", "CompactSubObj=2\nDataType=0x3\nAccessType=ro")
    profile = written(
        tmp_path, HEAD + 'eds = "pump.eds"\n' + "".join(f"[[object]]\nindex = 0x2100\nsubindex = {i}\n" for i in (0, 2))
    )
    (tmp_path / "pump.eds").write_text(compact, encoding="cp1252")
    loaded = load_profile(profile)
    assert isinstance(loaded, CanOpenProfile)
    assert loaded.types == ("uint8", "int16")
