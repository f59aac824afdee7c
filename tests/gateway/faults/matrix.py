"""The table of faults: what is done to which wire, what becomes of the channel, and what the user reads.

`test_fault_matrix` plays each row; docs/faults.md is written from it by `page`.
"""

import asyncio
from collections.abc import Awaitable, Callable, Collection, Sequence
from dataclasses import dataclass

from drivers.base import Quality
from simulators.devices.cia404_node import Nmt
from simulators.devices.modbus_servers import crc16
from simulators.devices.source import Fault
from simulators.devices.spoil import Spoil
from tests.gateway.faults.plants import PLANTS, TIMEOUT_S, VICTIM, Plant

PERIOD_S = 0.4

Do = Callable[[Plant], Awaitable[None] | None]
Heard = Sequence[tuple[float, bytes]]
"""Bytes on the wire, each after so many seconds."""

COMM, STALE = Quality.COMM_FAULT, Quality.STALE
BROKEN, BEYOND = Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE


@dataclass(frozen=True)
class Case:
    """One row of the matrix."""

    fault: str
    plant: str
    start: Do
    end: Do
    says: str
    """A part of what the reading says; `|` between two that depend on the moment."""
    quality: Quality = COMM
    whole_bus: bool = False
    """The fault is one of the wire, so the neighbour on it is gone too; only the other bus is held to its period."""
    whole_device: bool = False
    """All channels of the victim turn, not the first alone."""
    then: str = ""
    """What the reading says later, when one problem turns into another; each is told once."""


def unplug(plant: Plant) -> Awaitable[None]:
    return plant.unplug()


def plug(plant: Plant) -> Awaitable[None]:
    return plant.plug()


def silent(plant: Plant) -> None:
    plant.faults.silent = True


def talking(plant: Plant) -> None:
    plant.faults.silent = False


def sensor(fault: Fault | None) -> Do:
    return lambda plant: plant.faults.set(0, fault)


def spoilt(heard: Callable[[bytes], Heard], senders: Collection[int] | None = (VICTIM,)) -> Do:
    """What becomes of the victim's frames, or of everybody's."""

    def on_wire(sender: int, frame: bytes) -> Heard:
        return heard(frame) if senders is None or sender in senders else ((0.0, frame),)

    def do(plant: Plant) -> None:
        assert plant.wire is not None
        plant.wire.spoil = on_wire

    return do


def whole(plant: Plant) -> None:
    assert plant.wire is not None
    plant.wire.spoil = unspoilt


unspoilt: Spoil = lambda _, frame: ((0.0, frame),)  # noqa: E731


def bus_off(off: bool) -> Do:
    def do(plant: Plant) -> None:
        assert plant.adapter is not None
        plant.adapter.bus_off = off

    return do


def rebooted(plant: Plant) -> None:
    """The node is back, says so, and waits for somebody to start it."""
    assert plant.node is not None
    talking(plant)
    plant.send(list(plant.node.on_frame(0, bytes((Nmt.RESET_NODE, VICTIM)))))


def heartbeat(stopped: bool) -> Do:
    def do(plant: Plant) -> None:
        assert plant.node is not None
        plant.node.heartbeat_stopped = stopped

    return do


def wrong_type(plant: Plant) -> None:
    """Gone, and another device is in its place: seen when it is connected anew."""
    silent(plant)
    plant.retype(0x0FFF)
    asyncio.get_running_loop().call_later(2 * PERIOD_S, talking, plant)


def right_type(plant: Plant) -> None:
    talking(plant)
    plant.retype(0)


def _now(change: Callable[[bytes], bytes]) -> Callable[[bytes], Heard]:
    return lambda frame: ((0.0, change(frame)),)


def _late(frame: bytes) -> Heard:
    return ((1.5 * TIMEOUT_S, frame),)


def _lost(_: bytes) -> Heard:
    return ()


# Modbus: function code and data are f[1:-2] on a line, f[7:] behind the seven bytes of a TCP header.


def rtu(body: bytes) -> bytes:
    return body + crc16(body)


def tcp(header: bytes, body: bytes) -> bytes:
    """The header with the length of this body (unit, function code, data)."""
    return header[:4] + len(body).to_bytes(2, "big") + body


# An adapter's line: t, three digits of the identifier, one of the length, two for each byte, carriage return.

SDO, TPDO = (0x580 + VICTIM,), (0x180 + VICTIM, 0x280 + VICTIM)
LOGGER = (0x300,)


def abort(line: bytes) -> bytes:
    """The same SDO answered with an abort: the object does not exist."""
    return line[:5] + b"80" + line[7:13] + b"00000206\r"


# Micro-Epsilon on RS-485: 68 LE LE 68, then address, sender, function, data; check sum, 16.


def me(body: bytes) -> bytes:
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


MODBUS_LINE = ("rtu", "pta", "analogue")
CANOPEN = ("slcan", "sync", "timer")
CAN = (*CANOPEN, "dbc")
ME_LINE = ("me_rs485", "dt6120")
EVERY = tuple(name for name in PLANTS if name != "heartbeat")
TYPED = ("rtu", "tcp", *CANOPEN, "multicast")

ABSENT = {
    "tcp": "closed the connection|cannot connect to",
    "wago": "closed the connection|cannot connect to",
    "me_ethernet": "closed the connection|cannot connect to",
    "multicast": "no answer within",
}
SILENT = {
    "slcan": "node 1: no answer within",
    "multicast": "node 1: no answer within",
    "sync": "did not come after SYNC",
    "timer": "does not come by itself",
    "dbc": "none of the frames 0x300 came within",
    "me_rs485": "sensor 0x7E did not answer within",
    "dt6120": "sensor 0x7E did not answer within",
    "me_ethernet": "no measured values within",
}
OTHER_TYPE = dict.fromkeys(("rtu", "tcp"), "type code 0x0FFF at input 0") | dict.fromkeys(
    (*CANOPEN, "multicast"), "sensor type 4095 at input 0"
)


def cases(fault: str, plants: Sequence[str], start: Do, end: Do, says: str, quality: Quality = COMM) -> list[Case]:
    return [Case(fault, plant, start, end, says, quality) for plant in plants]


MATRIX: Sequence[Case] = [
    *(
        Case("unplugged and back", plant, unplug, plug, ABSENT.get(plant, "is gone|cannot open"), whole_bus=True)
        for plant in EVERY
    ),
    *(
        Case("dead device", plant, silent, talking, SILENT.get(plant, "unit 1 did not answer within"))
        for plant in EVERY
    ),
    Case("half-open connection", "tcp", spoilt(_lost, None), whole, "did not answer within", whole_bus=True),
    Case(
        "half-open connection", "me_ethernet", spoilt(_lost, None), whole, "no measured values within", whole_bus=True
    ),
    *cases(
        "gateway to a dead device",
        ("tcp", "wago"),
        spoilt(_now(lambda f: tcp(f, f[6:7] + bytes((f[7] | 0x80, 11))))),
        whole,
        "exception 11: gateway target did not respond",
    ),
    *cases(
        "wrong device answers",
        ("rtu",),
        spoilt(_now(lambda f: rtu(b"\x07" + f[1:-2]))),
        whole,
        "none of them a valid answer",
    ),
    *cases("wrong device answers", ("tcp",), spoilt(_now(lambda f: f[:6] + b"\x07" + f[7:])), whole, "unit 7 answered"),
    *cases("wrong device answers", ("slcan",), spoilt(_now(lambda f: b"t587" + f[4:]), SDO), whole, "no answer within"),
    *cases(
        "wrong device answers",
        ("sync",),
        spoilt(_now(lambda f: b"t187" + f[4:]), TPDO),
        whole,
        "0x181, 0x281 did not come after SYNC",
    ),
    *cases(
        "wrong device answers",
        ME_LINE,
        spoilt(_now(lambda f: me(f[4:5] + b"\x11" + f[6:-2])), None),
        whole,
        "none of them a valid answer",
    ),
    *cases("late answer", ("rtu", "tcp"), spoilt(_late), whole, "did not answer within"),
    *cases("late answer", ("slcan",), spoilt(_late, SDO), whole, "no answer within"),
    *cases("late answer", ("sync",), spoilt(_late, (*SDO, *TPDO)), whole, "did not come after SYNC"),
    *cases("late answer", ME_LINE, spoilt(_late, None), whole, "did not answer within"),
    *cases(
        "checksum error",
        ("rtu",),
        spoilt(_now(lambda f: f[:-1] + bytes((f[-1] ^ 1,)))),
        whole,
        "none of them a valid answer",
    ),
    *cases(
        "checksum error",
        ME_LINE,
        spoilt(_now(lambda f: f[:-2] + bytes((f[-2] ^ 1, f[-1]))), None),
        whole,
        "none of them a valid answer",
    ),
    *cases("truncated frame", ("rtu",), spoilt(_now(lambda f: f[:-3])), whole, "none of them a valid answer"),
    *cases("truncated frame", ("tcp",), spoilt(_now(lambda f: f[:-3])), whole, "no whole Modbus TCP answer"),
    *cases(
        "truncated frame",
        ("slcan",),
        spoilt(_now(lambda f: b"t5814" + f[5:13] + b"\r"), SDO),
        whole,
        "no answer within",
    ),
    *cases(
        "truncated frame",
        ("sync",),
        spoilt(_now(lambda f: f[:4] + b"2" + f[5:9] + b"\r"), TPDO),
        whole,
        "is missing in",
    ),
    *cases(
        "truncated frame",
        ("timer",),
        spoilt(_now(lambda f: f[:4] + b"2" + f[5:9] + b"\r"), TPDO),
        whole,
        "is missing in",
    ),
    *cases(
        "truncated frame",
        ("dbc",),
        spoilt(_now(lambda f: f[:4] + b"3" + f[5:11] + b"\r"), LOGGER),
        whole,
        "frame of 3 bytes",
    ),
    *cases("truncated frame", ME_LINE, spoilt(_now(lambda f: f[:-3]), None), whole, "none of them a valid answer"),
    *cases("truncated frame", ("me_ethernet",), spoilt(_now(lambda f: f[:-3]), None), whole, "no whole block"),
    *cases(
        "overlong frame",
        ("rtu",),
        spoilt(_now(lambda f: rtu(f[:2] + bytes((f[2] + 2,)) + f[3:-2] + b"\0\0"))),
        whole,
        "none of them a valid answer",
    ),
    *cases(
        "overlong frame",
        ("tcp",),
        spoilt(_now(lambda f: tcp(f, f[6:8] + bytes((f[8] + 2,)) + f[9:] + b"\0\0"))),
        whole,
        "the answer does not fit",
    ),
    *cases(
        "overlong frame",
        ("slcan",),
        spoilt(_now(lambda f: f[:4] + b"9" + f[5:-1] + b"00\r"), SDO),
        whole,
        "no answer within",
    ),
    *cases(
        "overlong frame",
        ("dbc",),
        spoilt(_now(lambda f: f[:4] + b"9" + f[5:-1] + b"00\r"), LOGGER),
        whole,
        "none of the frames",
    ),
    *cases(
        "overlong frame",
        ("me_rs485",),
        spoilt(_now(lambda f: me(f[4:-2] + b"\0\0")), None),
        whole,
        "10 data bytes, not 8",
    ),
    *cases(
        "overlong frame",
        ("dt6120",),
        spoilt(_now(lambda f: me(f[4:-2] + b"\0\0")), None),
        whole,
        "do not hold 1 values",
    ),
    *cases("overlong frame", ("me_ethernet",), spoilt(_now(lambda f: f + b"\0\0"), None), whole, "no whole block"),
    *cases(
        "exception code", MODBUS_LINE, spoilt(_now(lambda f: rtu(bytes((f[0], f[1] | 0x80, 6))))), whole, "device busy"
    ),
    *cases(
        "exception code",
        ("tcp", "wago"),
        spoilt(_now(lambda f: tcp(f, f[6:7] + bytes((f[7] | 0x80, 6))))),
        whole,
        "exception 6: device busy",
    ),
    *cases("exception code", ("slcan",), spoilt(_now(abort), SDO), whole, "node 1 refused object 6150:01"),
    *(Case("bus-off", plant, bus_off(True), bus_off(False), SILENT[plant], whole_bus=True) for plant in CAN),
    *(Case("node reboots", plant, silent, rebooted, SILENT[plant]) for plant in (*CANOPEN, "multicast")),
    *(
        Case("heartbeat lost", plant, heartbeat(True), heartbeat(False), "heartbeat stopped", STALE, whole_device=True)
        for plant in ("heartbeat", "sync", "timer")
    ),
    *(
        Case(
            "returns with another type",
            plant,
            wrong_type,
            right_type,
            SILENT.get(plant, "unit 1 did not answer within"),
            then=OTHER_TYPE[plant],
        )
        for plant in TYPED
    ),
    *cases("sensor open", ("rtu",), sensor(Fault.OPEN), sensor(None), "the module reports this input broken", BROKEN),
    *cases("sensor open", ("pta",), sensor(Fault.OPEN), sensor(None), "97.7 degC is what this device shows", BROKEN),
    *cases("sensor open", ("analogue",), sensor(Fault.OPEN), sensor(None), "0 µm is outside 5 to 500 µm", BEYOND),
    *cases("sensor open", ("tcp",), sensor(Fault.OPEN), sensor(None), "burnout: open circuit at this input", BROKEN),
    *cases("sensor open", ("wago",), sensor(Fault.OPEN), sensor(None), "broken wire", BROKEN),
    *cases("sensor open", (*CANOPEN, "multicast"), sensor(Fault.OPEN), sensor(None), "sensor fault", BROKEN),
    *cases("sensor open", ("dbc",), sensor(Fault.OPEN), sensor(None), "open", BROKEN),
    *cases("sensor open", ("me_rs485",), sensor(Fault.OPEN), sensor(None), "the sensor sends no number", BROKEN),
    *cases(
        "sensor open", ("dt6120", "me_ethernet"), sensor(Fault.OPEN), sensor(None), "of the measuring range", BEYOND
    ),
    *cases("sensor short", ("rtu",), sensor(Fault.SHORT), sensor(None), "the module reports this input broken", BROKEN),
    *cases("sensor short", ("pta",), sensor(Fault.SHORT), sensor(None), "-200 degC is outside", BEYOND),
    *cases("sensor short", ("analogue",), sensor(Fault.SHORT), sensor(None), "0 µm is outside 5 to 500 µm", BEYOND),
    *cases("sensor short", ("tcp",), sensor(Fault.SHORT), sensor(None), "at or below the start", BEYOND),
    *cases("sensor short", ("wago",), sensor(Fault.SHORT), sensor(None), "short circuit", BROKEN),
    *cases("sensor short", (*CANOPEN, "multicast"), sensor(Fault.SHORT), sensor(None), "sensor fault", BROKEN),
    *cases("sensor short", ("dbc",), sensor(Fault.SHORT), sensor(None), "short", BROKEN),
    *cases("sensor short", ("me_rs485",), sensor(Fault.SHORT), sensor(None), "the sensor sends no number", BROKEN),
    *cases(
        "sensor short", ("dt6120", "me_ethernet"), sensor(Fault.SHORT), sensor(None), "of the measuring range", BEYOND
    ),
    *cases("over range", ("rtu",), sensor(Fault.OVER), sensor(None), "above the input's range", BROKEN),
    *cases("over range", ("pta",), sensor(Fault.OVER), sensor(None), "400 degC is outside", BEYOND),
    *cases("over range", ("analogue",), sensor(Fault.OVER), sensor(None), "above the module's input range", BEYOND),
    *cases("over range", ("tcp",), sensor(Fault.OVER), sensor(None), "at or above the end", BEYOND),
    *cases("over range", ("wago",), sensor(Fault.OVER), sensor(None), "above 850 degC", BEYOND),
    *cases(
        "over range", (*CANOPEN, "multicast"), sensor(Fault.OVER), sensor(None), "above the measuring range", BEYOND
    ),
    *cases("over range", ("dbc",), sensor(Fault.OVER), sensor(None), "900 is beyond the range of the DBC file", BEYOND),
    *cases("over range", (*ME_LINE, "me_ethernet"), sensor(Fault.OVER), sensor(None), "of the measuring range", BEYOND),
    *cases("under range", ("rtu",), sensor(Fault.UNDER), sensor(None), "below the input's range", BROKEN),
    *cases("under range", ("pta",), sensor(Fault.UNDER), sensor(None), "-200 degC is outside", BEYOND),
    *cases("under range", ("analogue",), sensor(Fault.UNDER), sensor(None), "below the module's input range", BEYOND),
    *cases("under range", ("tcp",), sensor(Fault.UNDER), sensor(None), "at or below the start", BEYOND),
    *cases("under range", ("wago",), sensor(Fault.UNDER), sensor(None), "below -200 degC", BEYOND),
    *cases(
        "under range", (*CANOPEN, "multicast"), sensor(Fault.UNDER), sensor(None), "below the measuring range", BEYOND
    ),
    *cases(
        "under range", ("dbc",), sensor(Fault.UNDER), sensor(None), "-250 is beyond the range of the DBC file", BEYOND
    ),
    *cases(
        "under range", (*ME_LINE, "me_ethernet"), sensor(Fault.UNDER), sensor(None), "of the measuring range", BEYOND
    ),
]


@dataclass(frozen=True)
class Harmless:
    """A disturbance that no reading may show: every value right, every period kept, nothing told."""

    disturbance: str
    plant: str
    disturb: Do
    """Done once a period."""


def around(before: bytes, after: bytes = b"", senders: Collection[int] | None = None) -> Do:
    return spoilt(_now(lambda frame: before + frame + after), senders)


def emergencies(plant: Plant) -> None:
    for _ in range(20):
        plant.send([(0x80 + VICTIM, bytes.fromhex("00 10 01 00 00 00 00 00"))] * 10)


def restarted(plant: Plant) -> None:
    """Power was gone for a moment, between two reads: the node boots, and waits for somebody to start it."""
    asyncio.get_running_loop().call_later(PERIOD_S / 2, rebooted, plant)


HARMLESS: Sequence[Harmless] = [
    *(Harmless("garbage between frames", plant, around(b"\x00\xff\x01\x04", b"\x01\x84\x02")) for plant in MODBUS_LINE),
    *(
        Harmless("garbage between frames", plant, around(b"\x00\x07\x00\x00\x00\x50", b"\xff\0"))
        for plant in ("tcp", "wago")
    ),
    *(Harmless("garbage between frames", plant, around(b"\xfft58\rt9\a", b"t1818AB\rz\r")) for plant in CAN),
    *(Harmless("garbage between frames", plant, around(b"\x68\x0b\x16", b"\x68\xff")) for plant in ME_LINE),
    Harmless("garbage between frames", "me_ethernet", around(b"\0\xffMEAS\x07")),
    *(Harmless("storm of emergencies", plant, emergencies) for plant in (*CANOPEN, "multicast")),
    *(Harmless("node restarts between two reads", plant, restarted) for plant in (*CANOPEN, "multicast")),
]
