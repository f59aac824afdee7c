"""Whatever an adapter, a group or a node sends: a correct value or an error; never a crash, a hang or a wrong value."""

import asyncio
import socket
from collections.abc import Sequence
from contextlib import AsyncExitStack, suppress

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.base import BadAnswer, DriverError, NoAnswer
from drivers.can.bus import CanBus
from drivers.can.interface import slcan_frame
from drivers.can.settings import CanSettings
from drivers.can.wanted import WantedFrame
from drivers.canopen.bus import CanOpenBus
from simulators.devices import Cia404Node
from simulators.devices.multicast_bus import MulticastBus
from simulators.devices.slcan_adapter import CanFrame
from tests.benches.buses import make_bus
from tests.benches.can_talk import NODE, VALUE, talking
from tests.benches.free_port import free_port

pytestmark = pytest.mark.simulated_time

SHORT_S = 0.02
"""The timeout where many requests get no answer."""
TEMPERATURES = [20.0, -3.3]
GROUP = "239.74.163.3"
PLACE = bytes.fromhex("30 91 01")


def line(identifier: int, data: bytes, *, extended: bool = False) -> bytes:
    """A frame as the adapter's manual writes it."""
    return (f"T{identifier:08X}" if extended else f"t{identifier:03X}").encode() + f"{len(data)}{data.hex()}".encode()


@pytest.mark.parametrize(
    ("text", "identifier", "extended", "data"),
    [
        (b"t1855AABBCCDDEE", 0x185, False, "AABBCCDDEE"),
        (b"t7051FF", 0x705, False, "FF"),
        (b"t7000", 0x700, False, ""),
        (b"T18FF00052ABCD", 0x18FF0005, True, "ABCD"),
        (b"t1852AABB1234", 0x185, False, "AABB"),  # with a time stamp
    ],
)
def test_lines_of_the_protocol_are_read(text: bytes, identifier: int, extended: bool, data: str) -> None:
    message = slcan_frame(text)
    assert message is not None
    assert (message.arbitration_id, message.is_extended_id, bytes(message.data)) == (
        identifier,
        extended,
        bytes.fromhex(data),
    )


@pytest.mark.parametrize(
    "text",
    [b"", b"z", b"t1855AABB", b"t1852AABBC", b"t8002AABB", b"tG852AABB", b"t1859" + b"00" * 9, b"r1852", b"\xff"],
)
def test_what_is_not_a_whole_data_frame_is_ignored(text: bytes) -> None:
    assert slcan_frame(text) is None


@given(st.one_of(st.binary(max_size=40), st.from_regex(rb"[tT][0-9A-Fa-f]{0,30}", fullmatch=True)))
def test_any_line_is_a_frame_or_none(text: bytes) -> None:
    message = slcan_frame(text)
    if message is not None:
        written = line(message.arbitration_id, bytes(message.data), extended=message.is_extended_id)
        assert text.lower().startswith(written.lower())
        assert len(text) - len(written) in (0, 4)


class Talker:
    """A node that identifies itself correctly, and for another object sends the test's frames."""

    def __init__(self) -> None:
        self.says: Sequence[CanFrame] = ()

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        if identifier != 0x600 + NODE:
            return ()
        if data[1:4] == bytes.fromhex("00 10 00"):
            return ((0x580 + NODE, bytes.fromhex("43 00 10 00 94 01 02 00")),)
        return self.says


async def answered(bus: CanOpenBus) -> list[bytes]:
    """The node's answer, once earlier frames have passed and the computer has time for it within so short a timeout."""
    for _ in range(10):
        with suppress(NoAnswer, BadAnswer):
            return await bus.upload("node", NODE, [VALUE])
    raise AssertionError("ten times no answer")


COMMANDS = st.one_of(
    st.sampled_from([0x43, 0x43, 0x47, 0x4B, 0x4F, 0x42, 0x40, 0x41, 0x80, 0x00, 0x10]), st.integers(0, 255)
)
ANSWERS = st.one_of(
    st.binary(max_size=8),
    st.builds(lambda command, data: bytes((command,)) + PLACE + data, COMMANDS, st.binary(max_size=4)),
    st.builds(lambda command, data: bytes((command,)) + PLACE + data, COMMANDS, st.binary(min_size=4, max_size=4)),
    st.builds(lambda command, data: bytes((command,)) + data, COMMANDS, st.binary(min_size=7, max_size=7)),
)
IDENTIFIERS = st.sampled_from([*[0x580 + NODE] * 4, 0x586, 0x000, 0x705, 0x085, 0x185, 0x7E4])
ANY = st.lists(st.tuples(IDENTIFIERS, ANSWERS), max_size=6)
RIGHT = st.binary(min_size=4, max_size=4).map(lambda data: (0x580 + NODE, b"\x43" + PLACE + data))
FRAMES = st.one_of(ANY, st.builds(lambda right, others: [right, *others], RIGHT, ANY))


def values_in(frames: Sequence[CanFrame]) -> set[bytes]:
    """What these frames say that the object holds (CiA 301, expedited upload)."""
    found = set()
    for identifier, data in frames:
        if identifier == 0x580 + NODE and len(data) == 8 and data[0] & 0xE2 == 0x42 and data[1:4] == PLACE:
            found.add(data[4:8] if not data[0] & 1 else data[4 : 8 - (data[0] >> 2 & 3)])
    return found


def begins_segments(frames: Sequence[CanFrame]) -> bool:
    return any(i == 0x580 + NODE and len(data) == 8 and data[0] & 0xE2 == 0x40 for i, data in frames)


@pytest.mark.slow
def test_any_frames_from_a_node_give_what_they_say_or_an_error() -> None:
    node, stack, outcomes = Talker(), AsyncExitStack(), [0, 0]
    with asyncio.Runner() as runner:
        bus, _ = runner.run(stack.enter_async_context(talking(node, SHORT_S)))
        before: Sequence[CanFrame] = ()

        @settings(max_examples=200)
        @given(FRAMES)
        def any_frames(frames: Sequence[CanFrame]) -> None:
            nonlocal before
            node.says = frames
            try:
                (data,) = runner.run(bus.upload("node", NODE, [VALUE]))
            except DriverError:
                outcomes[0] += 1
            else:
                outcomes[1] += 1
                heard = [*before, *frames]  # one answer too many cannot be distinguished from the next
                assert data in values_in(heard) or (begins_segments(heard) and 1 <= len(data) <= 8)
            before = frames

        any_frames()
        assert min(outcomes) >= 20, "errors and values, or nothing was tried"
        node.says = [(0x580 + NODE, b"\x43" + PLACE + bytes((7, 0, 0, 0)))]
        assert runner.run(answered(bus)) == [bytes((7, 0, 0, 0))]
        runner.run(stack.aclose())


class Endless:
    """A node whose object never ends: segments that all announce another."""

    def __init__(self, *, empty: bool) -> None:
        self._empty = empty

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        if identifier != 0x600 + NODE or data[0] == 0x80:
            return ()
        if data[0] == 0x40:
            return ((0x580 + NODE, b"\x40" + data[1:4] + bytes(4)),)
        return ((0x580 + NODE, bytes((data[0] & 0x10 | (0x0F if self._empty else 0),)) + bytes(7)),)


@pytest.mark.parametrize(("empty", "says"), [(False, "more than 8 bytes"), (True, "holds nothing")])
async def test_object_without_end_or_content_is_refused_at_once(empty: bool, says: str) -> None:
    async with talking(Endless(empty=empty)) as (bus, _), asyncio.timeout(2):
        with pytest.raises(BadAnswer, match=f"9130:01 {'' if empty else 'holds '}{says}"):
            await bus.upload("node", NODE, [VALUE])


async def test_identifier_of_29_bits_is_not_a_nodes_answer() -> None:
    async with talking(Cia404Node(NODE, lambda: TEMPERATURES, inputs=2)) as (bus, adapter):
        foreign = line(0x580 + NODE, b"\x43" + PLACE + bytes((99, 0, 0, 0)), extended=True) + b"\r"
        adapter.spoil = lambda _, text: ((0.0, foreign), (0.0, text))
        assert await bus.upload("node", NODE, [VALUE]) == [(200).to_bytes(4, "little")]
        adapter.spoil = lambda _, __: ((0.0, foreign),)
        with pytest.raises(NoAnswer):
            await bus.upload("node", NODE, [VALUE])


NOISE = st.one_of(
    st.binary(max_size=30),
    st.from_regex(rb"[tTrzx][0-9A-F]{0,25}\r?", fullmatch=True),
    st.just(b"\a"),
    st.just(line(0x580 + NODE, b"\x43" + PLACE)[:-2] + b"\r"),
)


@pytest.mark.slow
def test_noise_around_an_adapters_lines_gives_the_value_or_an_error() -> None:
    stack, noise = AsyncExitStack(), (b"", b"")
    with asyncio.Runner() as runner:
        bus, adapter = runner.run(
            stack.enter_async_context(talking(Cia404Node(NODE, lambda: TEMPERATURES, inputs=2), SHORT_S))
        )

        @settings(max_examples=150)
        @given(NOISE, NOISE)
        def any_noise(before: bytes, after: bytes) -> None:
            nonlocal noise
            adapter.spoil = lambda _, text: ((0.0, before + text + after),)
            with suppress(DriverError):
                assert runner.run(bus.upload("node", NODE, [VALUE])) == [(200).to_bytes(4, "little")]
            adapter.spoil = None
            adapter.send([(0x7FF, b"")])  # ends what the noise began
            assert runner.run(answered(bus)) == [(200).to_bytes(4, "little")]

        any_noise()
        runner.run(stack.aclose())


def test_foreign_packets_on_the_group_are_ignored() -> None:
    stack, port = AsyncExitStack(), free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger, asyncio.Runner() as runner:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)

        async def start() -> CanOpenBus:
            wire = MulticastBus([Cia404Node(NODE, lambda: TEMPERATURES, inputs=2)], GROUP, port)
            wire.start()
            stack.callback(wire.stop)
            options = {"interface": "udp_multicast", "channel": GROUP, "port": port, "timeout_s": 0.5}
            bus = make_bus("can1", "canopen", options)
            assert isinstance(bus, CanOpenBus)
            stack.push_async_callback(bus.close)
            await bus.connect()
            return bus

        bus = runner.run(start())

        @settings(max_examples=80)
        @given(st.lists(st.binary(max_size=60), max_size=5))
        def any_packets(packets: list[bytes]) -> None:
            for packet in packets:
                stranger.sendto(packet, (GROUP, port))
            assert runner.run(bus.upload("node", NODE, [VALUE])) == [(200).to_bytes(4, "little")]

        any_packets()
        runner.run(stack.aclose())


@pytest.mark.parametrize("kind", ["error", "remote"])
async def test_error_and_remote_frames_are_no_messages_of_their_identifier(kind: str) -> None:
    """An error frame of the kernel has an identifier and eight bytes, too."""
    place = {"interface": "virtual", "channel": f"frames {kind}"}
    bus = CanBus("can1", CanSettings.model_validate(place | {"timeout_s": 5.0}))
    first, last = WantedFrame(4), WantedFrame(5)
    bus.want([first, last])
    try:
        await bus.connect()
        with can.Bus(interface="virtual", channel=place["channel"]) as other:
            other.send(can.Message(arbitration_id=4, is_extended_id=False, data=b"right"))
            odd = can.Message(arbitration_id=4, is_extended_id=False, dlc=8)
            odd.is_error_frame, odd.is_remote_frame = kind == "error", kind == "remote"
            other.send(odd)
            other.send(can.Message(arbitration_id=5, is_extended_id=False, data=b"end"))
            found = await bus.latest("d", [first, last])
            assert {frame: kept.data for frame, kept in found.items()} == {first: b"right", last: b"end"}
    finally:
        await bus.close()
