"""Faults inflicted on a plant: plugs pulled, devices silenced, sensors broken, frames corrupted on the wire."""

import asyncio
from collections.abc import Awaitable, Callable, Collection, Sequence

import can
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from simulators.devices.cia404_node import Nmt
from simulators.devices.source import SensorFault
from simulators.devices.spoil import Spoil
from tests.benches.faults.plant import NEIGHBOUR, SENSORS, TIMEOUT_S, VICTIM, FaultyPlant
from tests.benches.late_answers import Late

PERIOD_S = 0.4
LONG_TIMEOUT_S = PERIOD_S / 2

Do = Callable[[FaultyPlant], Awaitable[None] | None]
OnWire = Sequence[tuple[float, bytes]]
"""Bytes on the wire, each after a number of seconds."""


def unplug(plant: FaultyPlant) -> Awaitable[None]:
    return plant.unplug()


def plug(plant: FaultyPlant) -> Awaitable[None]:
    return plant.plug()


def silent(plant: FaultyPlant) -> None:
    plant.faults.silent = True


def talking(plant: FaultyPlant) -> None:
    plant.faults.silent = False


def sensor(fault: SensorFault | None) -> Do:
    return lambda plant: plant.faults.set(0, fault)


def spoilt(heard: Callable[[bytes], OnWire], senders: Collection[int] | None = (VICTIM,)) -> Do:
    """Spoil the victim's frames, or everybody's."""

    def on_wire(sender: int, frame: bytes) -> OnWire:
        return heard(frame) if senders is None or sender in senders else ((0.0, frame),)

    def do(plant: FaultyPlant) -> None:
        assert plant.wire is not None
        plant.wire.spoil = on_wire

    return do


def whole(plant: FaultyPlant) -> None:
    assert plant.wire is not None
    plant.wire.spoil = unspoilt


unspoilt: Spoil = lambda _, frame: ((0.0, frame),)  # noqa: E731


def bus_off(off: bool) -> Do:
    def do(plant: FaultyPlant) -> None:
        assert plant.adapter is not None
        plant.adapter.bus_off = off

    return do


def rebooted(plant: FaultyPlant) -> None:
    """The node comes back, sends its boot-up, and waits to be started."""
    assert plant.node is not None
    talking(plant)
    plant.send(list(plant.node.on_frame(0, bytes((Nmt.RESET_NODE, VICTIM)))))


def heartbeat(stopped: bool) -> Do:
    def do(plant: FaultyPlant) -> None:
        assert plant.node is not None
        plant.node.heartbeat_stopped = stopped

    return do


def wrong_type(plant: FaultyPlant) -> None:
    """The device is replaced by another one, which is noticed at the next connect."""
    silent(plant)
    plant.retype(0x0FFF)
    asyncio.get_running_loop().call_later(2 * PERIOD_S, talking, plant)


def right_type(plant: FaultyPlant) -> None:
    talking(plant)
    plant.retype(0)


def now(change: Callable[[bytes], bytes]) -> Callable[[bytes], OnWire]:
    return lambda frame: ((0.0, change(frame)),)


def behind(senders: Collection[int], before: Collection[int] | None = None) -> Do:
    """Their answers come with other answers, after the request was given up: see `Late`."""

    def do(plant: FaultyPlant) -> None:
        assert plant.wire is not None
        plant.wire.spoil = Late(senders, TIMEOUT_S / 4, before)

    return do


def let_go(plant: FaultyPlant) -> None:
    """The answer that is still kept comes at the next request, before its own."""
    assert plant.wire is not None
    assert isinstance(plant.wire.spoil, Late)
    plant.wire.spoil.let_go()


def half_open(plant: FaultyPlant) -> None:
    """The other end disappears silently, and new connections fail in the same way."""
    assert plant.server is not None
    plant.server.forget(True)


def served_again(plant: FaultyPlant) -> None:
    """Only new connections are affected: existing ones stay as they are."""
    assert plant.server is not None
    plant.server.forget(False)


# Modbus: function code and data are f[1:-2] on a line, f[7:] behind the seven bytes of a TCP header.


def tcp(header: bytes, body: bytes) -> bytes:
    """The header with the length of this body (unit, function code, data)."""
    return header[:4] + len(body).to_bytes(2, "big") + body


# An adapter's line: t, three digits of the identifier, one of the length, two for each byte, carriage return.

SDO, TPDO = (0x580 + VICTIM,), (0x180 + VICTIM, 0x280 + VICTIM)
OTHERS_SDO = (0x580 + NEIGHBOUR,)
LOGGER = (0x300,)
SENSOR, OTHER_SENSOR = SENSORS[:1], SENSORS[1:]


def abort(line: bytes) -> bytes:
    """The same SDO answered with an abort: the object does not exist."""
    return line[:5] + b"80" + line[7:13] + b"00000206\r"


# A datagram of UDP multicast contains one CAN frame as python-can packs it.


def cast(change: Callable[[can.Message], object]) -> Callable[[bytes], bytes]:
    """The same frame, changed in place."""

    def changed(datagram: bytes) -> bytes:
        message = unpack_message(datagram)
        change(message)
        return pack_message(message)

    return changed


def answered_by(node: int) -> Callable[[bytes], bytes]:
    def change(message: can.Message) -> None:
        message.arbitration_id += node - VICTIM

    return cast(change)


def of_length(count: int) -> Callable[[bytes], bytes]:
    def change(message: can.Message) -> None:
        message.data = bytearray((*message.data, *bytes(count))[:count])
        message.dlc = count

    return cast(change)


def aborted(message: can.Message) -> None:
    message.data = bytearray((0x80, *message.data[1:4], *bytes.fromhex("00000206")))


def among(*strangers: bytes) -> Do:
    """Before and after each frame, datagrams of another program."""
    foreign = [(0.0, datagram) for datagram in strangers]
    return spoilt(lambda frame: (*foreign, (0.0, frame), *foreign), None)


# Micro-Epsilon on RS-485: 68 LE LE 68, then address, sender, function, data; check sum, 16.


def me(body: bytes) -> bytes:
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


def around(before: bytes, after: bytes = b"", senders: Collection[int] | None = None) -> Do:
    return spoilt(now(lambda frame: before + frame + after), senders)


def emergencies(plant: FaultyPlant) -> None:
    for _ in range(20):
        plant.send([(0x80 + VICTIM, bytes.fromhex("00 10 01 00 00 00 00 00"))] * 10)


def restarted(plant: FaultyPlant) -> None:
    """Power failed briefly between two reads: the node boots, and waits to be started."""
    asyncio.get_running_loop().call_later(PERIOD_S / 2, rebooted, plant)
