"""CANopen nodes that do not answer as CiA 301 says, one fault each: no wrong value, and neighbours are read."""

import asyncio
import struct
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.base import BadAnswer, Driver, DriverError, Learns, NoAnswer, SystemClock
from drivers.build import make_device
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.slcan_adapter import CanFrame
from tests.benches.buses import make_bus
from tests.benches.driver_reads import values_or_reasons

pytestmark = pytest.mark.simulated_time

ODD, NEIGHBOUR = 5, 6
SHORT, REAL, LONG = (0x2100, 1), (0x2100, 2), (0x2101, 0)
HELD = {SHORT: struct.pack("<h", -215), REAL: struct.pack("<f", 41.5), LONG: struct.pack("<q", -(2**40))}
RIGHT = [-215.0, 41.5, float(-(2**40))]
PROFILE = 'protocol = "canopen"\ntitle = "pump"\nunit = "degC"\n' + "".join(
    f'[[object]]\nindex = {index}\nsubindex = {sub}\ntype = "{kind}"\n'
    for (index, sub), kind in ((SHORT, "int16"), (REAL, "float32"), (LONG, "int64"))
)
Oddity = Callable[["OddNode", bytes, bytes], Sequence[bytes]]
"""Takes the node, a request and its right answer, and gives what the node sends."""


class OddNode:
    """Answers SDO reads: up to four bytes at once, more of them in segments."""

    def __init__(self, node: int) -> None:
        self.node, self.held = node, dict(HELD)
        self.fault: Oddity = right
        self._left, self._place = b"", (0, 0)

    @property
    def place(self) -> tuple[int, int]:
        """The object that is being read."""
        return self._place

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        if identifier != 0x600 + self.node or data[0] == 0x80:
            return []
        return [(0x580 + self.node, one) for one in self.fault(self, data, self._answer(data))]

    def _answer(self, data: bytes) -> bytes:
        if data[0] & 0xE0 == 0x60:
            part, self._left = self._left[:7], self._left[7:]
            return bytes([data[0] & 0x10 | 7 - len(part) << 1 | (not self._left)]) + part.ljust(7, b"\0")
        self._place = int.from_bytes(data[1:3], "little"), data[3]
        held = self.held.get(self._place, b"" if self._place[0] != 0x1000 else bytes(4))
        if not held:
            return abort(data, 0x06020000)
        if len(held) <= 4:
            return bytes([0x43 | 4 - len(held) << 2]) + data[1:4] + held.ljust(4, b"\0")
        self._left = held
        return b"\x41" + data[1:4] + struct.pack("<I", len(held))


def abort(request: bytes, code: int) -> bytes:
    return b"\x80" + request[1:4] + struct.pack("<I", code)


def aborting(code: int) -> Callable[[bytes, bytes], Sequence[bytes]]:
    return lambda request, _answer: [abort(request, code)]


def right(node: OddNode, request: bytes, answer: bytes) -> Sequence[bytes]:
    return [answer]


def first(request: bytes) -> bool:
    return request[0] == 0x40


@asynccontextmanager
async def bench(folder: Path) -> AsyncIterator[tuple[OddNode, Driver, Driver, SlcanAdapter]]:
    odd, neighbour = OddNode(ODD), OddNode(NEIGHBOUR)
    adapter = SlcanAdapter([odd, neighbour])
    (folder / "pump.toml").write_text(PROFILE)
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.1})
    names = {"short": 0, "real": 1, "long": 2}
    one, other = (
        make_device(f"pump{node}", bus, str(folder / "pump.toml"), node, names, {}, SystemClock())
        for node in (ODD, NEIGHBOUR)
    )
    try:
        await bus.connect()
        yield odd, one, other, adapter
    finally:
        await bus.close()
        await adapter.stop()


async def values(driver: Driver) -> list[float | str] | DriverError:
    try:
        return values_or_reasons(await driver.read())
    except DriverError as error:
        return error


def only(place: tuple[int, int], change: Callable[[bytes, bytes], Sequence[bytes]]) -> Oddity:
    """This change for one object's first answer; the others are right."""

    def fault(node: OddNode, request: bytes, answer: bytes) -> Sequence[bytes]:
        return change(request, answer) if node.place == place and first(request) else [answer]

    return fault


def segments(change: Callable[[bytes], Sequence[bytes]]) -> Oddity:
    def fault(_node: OddNode, request: bytes, answer: bytes) -> Sequence[bytes]:
        return [answer] if first(request) else change(answer)

    return fault


CODES = [
    0x05030000, 0x05040000, 0x05040001, 0x05040005, 0x06010000, 0x06010001, 0x06020000, 0x06040043, 0x06060000,
    0x06070010, 0x06090011, 0x08000000, 0x08000020, 0x08000021, 0x08000022, 0x08000024, 0xFFFFFFFF, 0,
]  # fmt: skip
OWN = [
    ("another subindex", only(SHORT, lambda _, a: [a[:3] + b"\x02" + a[4:]]), 0),
    ("another index", only(SHORT, lambda _, a: [a[:1] + b"\0\x22" + a[3:]]), 0),
    ("written", only(REAL, lambda _, a: [b"\x60" + a[1:]]), 1),
    ("block", only(REAL, lambda _, a: [b"\xc2" + a[1:]]), 1),
    ("reserved", only(REAL, lambda _, a: [b"\xe3" + a[1:]]), 1),
    ("segment at once", only(REAL, lambda _, a: [b"\x01" + a[1:]]), 1),
    ("one byte", only(SHORT, lambda _, a: [b"\x4f" + a[1:]]), 0),
    ("four bytes", only(SHORT, lambda _, a: [b"\x43" + a[1:]]), 0),
    ("cut short", segments(lambda a: [bytes([a[0] & 0x10 | 3 << 1 | 1]) + a[1:]]), 2),
    ("toggle", segments(lambda a: [bytes([a[0] ^ 0x10]) + a[1:]]), 2),
    ("endless", segments(lambda a: [bytes([a[0] & 0x10]) + b"\x01" * 7]), 2),
    ("empty segments", segments(lambda a: [bytes([a[0] & 0x10 | 7 << 1]) + a[1:]]), 2),
    ("segment refused", segments(lambda _: [b"\x80\x01\x21\0" + struct.pack("<I", 0x05040000)]), 2),
    ("size that is not sent", only(LONG, lambda _, a: [a[:4] + struct.pack("<I", 20)]), 2),
    *((f"abort {code:08X}", only(REAL, aborting(code)), 1) for code in CODES),
]


@pytest.mark.parametrize("meanwhile", [False, True], ids=["from the start", "meanwhile"])
@pytest.mark.parametrize(("fault", "lost"), [pytest.param(*rest, id=name) for name, *rest in OWN])
async def test_an_objects_fault_takes_its_own_channel(
    tmp_path: Path, fault: Oddity, lost: int, meanwhile: bool
) -> None:
    async with bench(tmp_path) as (node, odd, neighbour, _):
        await neighbour.connect()
        if meanwhile:
            await odd.connect()
            assert await values(odd) == RIGHT
        node.fault = fault
        if not meanwhile:
            await odd.connect()
        for _ in range(3):
            seen = await values(odd)
            assert isinstance(seen, list), seen
            object_ = "{:04X}:{:02X}".format(*list(HELD)[lost])
            assert str(seen[lost]).startswith("comm_fault: ")
            assert object_ in str(seen[lost])
            assert [v for i, v in enumerate(seen) if i != lost] == [v for i, v in enumerate(RIGHT) if i != lost]
            assert await values(neighbour) == RIGHT
        node.fault = right
        await values(odd)
        assert await values(odd) == RIGHT


@pytest.mark.parametrize("what", ["answers", "aborts too"])
async def test_answers_that_come_twice(tmp_path: Path, what: str) -> None:
    """For instance through a repeater: the second copy comes in the time of the next request."""
    kept: list[bytes] = []

    def late_twin(_node: OddNode, _request: bytes, answer: bytes) -> Sequence[bytes]:
        heard = [*kept, answer]
        kept[:] = [answer]
        return heard

    async with bench(tmp_path) as (node, odd, neighbour, _):
        await neighbour.connect()
        node.fault = late_twin
        if what != "answers":
            del node.held[SHORT]
        await odd.connect()
        for _ in range(3):
            seen = await values(odd)
            assert isinstance(seen, list), seen
            assert seen[1:] == RIGHT[1:]
            assert seen[0] == RIGHT[0] if what == "answers" else "refused object 2100:01" in str(seen[0])
            assert await values(neighbour) == RIGHT


@pytest.mark.parametrize("length", [0, 3, 5, 7])
async def test_no_byte_of_an_answer_that_is_cut_is_taken(tmp_path: Path, length: int) -> None:
    """CiA 301: every answer has eight bytes."""
    async with bench(tmp_path) as (node, odd, neighbour, _):
        await neighbour.connect()
        await odd.connect()
        node.fault = only(REAL, lambda _, answer: [answer[:length]])
        assert isinstance(await values(odd), NoAnswer)
        assert await values(neighbour) == RIGHT
        node.fault = right
        assert await values(odd) == RIGHT


async def test_four_bytes_of_which_no_count_is_stated(tmp_path: Path) -> None:
    """CiA 301: then the type of the object says how many count."""
    async with bench(tmp_path) as (node, odd, _, _adapter):
        node.fault = lambda _n, r, a: [b"\x42" + a[1:]] if first(r) and a[0] & 2 else [a]
        await odd.connect()
        assert await values(odd) == RIGHT


async def test_node_that_answers_one_request_late(tmp_path: Path) -> None:
    kept: list[bytes] = []

    def behind(_node: OddNode, _request: bytes, answer: bytes) -> Sequence[bytes]:
        heard, kept[:] = list(kept), [answer]
        return heard

    async with bench(tmp_path) as (node, odd, neighbour, _):
        await neighbour.connect()
        await odd.connect()
        assert await values(odd) == RIGHT
        node.fault = behind
        for _ in range(4):
            node.held[SHORT] = struct.pack("<h", 7)
            seen = await values(odd)
            assert isinstance(seen, NoAnswer | BadAnswer), seen
            assert await values(neighbour) == RIGHT
        node.fault = right
        for _ in range(3):
            seen = await values(odd)
        assert seen == [7.0, *RIGHT[1:]]


async def test_message_names_bus_device_and_object(tmp_path: Path) -> None:
    async with bench(tmp_path) as (node, odd, _, _adapter):
        await odd.connect()
        node.fault = lambda _n, _r, _a: [b"\x43\x00\x30\x00" + bytes(4)]
        seen = await values(odd)
        assert isinstance(seen, BadAnswer)
        assert str(seen).startswith("bus can1, device pump5: ")
        assert "2100:01" in str(seen)


async def test_restarts_and_foreign_heartbeats(tmp_path: Path) -> None:
    async with bench(tmp_path) as (_node, odd, neighbour, adapter):
        await neighbour.connect()
        await odd.connect()
        for number in (NEIGHBOUR, 7, 0x7F):
            adapter.send([(0x700 + number, b"\0"), (0x700 + number, b"\x05")])
        adapter.send([(0x705, b""), (0x705, b"\0"), (0x705, b"\xff")])
        await asyncio.sleep(0.02)
        assert await values(odd) == RIGHT
        assert await values(neighbour) == RIGHT


@pytest.mark.parametrize("transfer", ["sync", "timer"])
@pytest.mark.parametrize("change", [-1, -4, 3], ids="by {}".format)
async def test_tpdos_of_another_length_than_their_mapping(tmp_path: Path, transfer: str, change: int) -> None:
    """Two objects in one frame: in a shorter frame the second is lost, and a longer one contains nothing more."""

    def cut(identifier: int, frame: bytes) -> Sequence[tuple[float, bytes]]:
        if identifier != 0x285:
            return [(0.0, frame)]
        data = bytes.fromhex(frame[5:-1].decode())
        data = (data + bytes(8))[: min(8, len(data) + change)]
        return [(0.0, b"t285%d%s\r" % (len(data), data.hex().encode()))]

    node = Cia404Node(ODD, lambda: [20.0, -3.3, 40.0, 55.0], inputs=4, event_ms=60 if transfer == "timer" else 0)
    adapter = SlcanAdapter([node])
    adapter.spoil = cut
    (tmp_path / "node.toml").write_text(
        'protocol = "canopen"\ntitle = "node"\nunit = "degC"\n'
        + "".join(f'[[object]]\nindex = 0x9130\nsubindex = {i}\ntype = "int32"\n' for i in (1, 2, 3, 4))
    )
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.2})
    names = {f"c{i}": i for i in range(4)}
    driver = make_device("node", bus, str(tmp_path / "node.toml"), ODD, names, {"transfer": transfer}, SystemClock())
    node.start(adapter.send)
    try:
        await bus.connect()
        await driver.connect()
        seen = await values(driver)
    finally:
        node.stop()
        await bus.close()
        await adapter.stop()
    assert isinstance(seen, list), seen
    assert seen[:3] == [200.0, -33.0, 400.0]
    assert seen[3] == 550.0 if change > 0 else "9130:04 is missing in its TPDO" in str(seen[3])


class Twins:
    """Two nodes with one id: each answers all that is sent to it, the second a moment later."""

    def __init__(self, one: Cia404Node, other: Cia404Node) -> None:
        self.both, self.one, self.other = True, one, other

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        return [*self.one.on_frame(identifier, data), *(self.other.on_frame(identifier, data) if self.both else ())]


def twin(temperature: float, heartbeat_ms: int = 0, event_ms: int = 0) -> Cia404Node:
    return Cia404Node(ODD, lambda: [temperature], inputs=1, heartbeat_ms=heartbeat_ms, event_ms=event_ms)


@asynccontextmanager
async def twins(options: dict[str, object], **sending: int) -> AsyncIterator[tuple[Twins, Driver, SlcanAdapter]]:
    """Read as one node with one input; the other is not there yet."""
    pair = Twins(twin(20.0, **sending), twin(40.0, **sending))
    pair.both = False
    adapter = SlcanAdapter([pair])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.2})
    driver = make_device("node", bus, "cia404", ODD, {"c": 0}, {"vendor": "jumo", **options}, SystemClock())
    pair.one.start(adapter.send)
    try:
        await bus.connect()
        await driver.connect()
        yield pair, driver, adapter
    finally:
        pair.one.stop()
        pair.other.stop()
        await bus.close()
        await adapter.stop()


@pytest.mark.parametrize("transfer", ["sdo", "sync", "timer"])
async def test_two_nodes_with_one_id_have_no_values(transfer: str) -> None:
    event_ms = 60 if transfer == "timer" else 0
    async with twins({"transfer": transfer}, event_ms=event_ms) as (pair, driver, adapter):
        assert await values(driver) == [20.0]
        pair.both = True
        pair.other.start(adapter.send)
        pair.other.on_frame(0, bytes((1, ODD)))  # operational, as the first one is
        for _ in range(8):
            await values(driver)  # the second answer comes after the first one was taken; SYNC may owe some frames
            await asyncio.sleep(event_ms / 1000)
        for _ in range(5):
            seen = await values(driver)
            assert isinstance(seen, list), seen
            assert "two nodes have id 5" in str(seen[0])
        pair.both = False
        pair.other.stop()
        async with asyncio.timeout(60.0):
            while await values(driver) != [20.0]:
                await asyncio.sleep(0.5)


async def test_two_nodes_with_one_id_beat_twice_as_often() -> None:
    async with twins({"transfer": "timer"}, heartbeat_ms=200, event_ms=100) as (pair, driver, adapter):
        for _ in range(60):
            assert await values(driver) == [20.0]
            await asyncio.sleep(0.1)
        await asyncio.sleep(0.07)  # out of step
        pair.other.start(adapter.send)
        async with asyncio.timeout(60.0):
            while "two nodes" not in str(await values(driver)):
                await asyncio.sleep(0.1)


async def test_node_whose_heartbeat_never_comes_is_read() -> None:
    """Its object 1017 says that it sends one; without one nobody can tell when it stops."""
    async with twins({}, heartbeat_ms=50) as (pair, driver, _):
        pair.one.heartbeat_stopped = True
        for _ in range(5):
            assert await values(driver) == [20.0]
            await asyncio.sleep(0.2)


@pytest.mark.parametrize(("sends_ms", "code"), [(0, "canopen_no_heartbeat"), (50, "canopen_never_beats")])
async def test_that_a_node_is_not_watched_is_told(sends_ms: int, code: str) -> None:
    node = twin(20.0, heartbeat_ms=sends_ms)
    node.heartbeat_stopped = True
    adapter = SlcanAdapter([node])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.2})
    driver = make_device("node", bus, "cia404", ODD, {"c": 0}, {"vendor": "jumo"}, SystemClock())
    node.start(adapter.send)
    try:
        await bus.connect()
        for _ in range(4):
            assert await values(driver) == [20.0]
            await asyncio.sleep(0.1)
        assert isinstance(bus, Learns)
        assert [(text.code, text.value_of("node")) for text in bus.learnt()] == [(code, ODD)]
    finally:
        node.stop()
        await bus.close()
        await adapter.stop()
