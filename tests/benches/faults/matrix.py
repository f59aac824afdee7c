"""The table of faults: what is done to which wire, what happens to the channel, and what the user reads.

`test_fault_matrix` plays each row.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.base import Quality
from tests.benches.faults.actions import (
    LOGGER,
    LONG_TIMEOUT_S,
    OTHER_SENSOR,
    OTHERS_SDO,
    SDO,
    SENSOR,
    TPDO,
    Do,
    abort,
    aborted,
    among,
    answered_by,
    around,
    behind,
    bus_off,
    cast,
    emergencies,
    half_open,
    heartbeat,
    let_go,
    me,
    now,
    of_length,
    plug,
    rebooted,
    restarted,
    right_type,
    sensor,
    served_again,
    silent,
    spoilt,
    talking,
    tcp,
    unplug,
    whole,
    wrong_type,
)
from tests.benches.faults.plant import NEIGHBOUR, TIMEOUT_S, VICTIM
from tests.benches.faults.plants import CAN, CANOPEN, ME_LINE, MODBUS_LINE, PLANTS
from tests.benches.faults.sensor_faults import SENSOR_FAULTS
from tests.benches.rtu_talk import frame

COMM, STALE = Quality.COMM_FAULT, Quality.STALE


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
    """The fault affects the wire, so the neighbour on it is lost too; only the other bus must keep its period."""
    whole_device: bool = False
    """All channels of the victim change, not only the first."""
    timeout_s: float = TIMEOUT_S
    """The bus's timeout."""
    then: str = ""
    """What the reading says later, when one problem turns into another; each is reported once."""
    in_part: bool = False
    """In the end the victim's other channels are good."""


EVERY = tuple(name for name in PLANTS if name != "heartbeat")
TYPED = ("rtu", "tcp", *CANOPEN, "multicast")
ASKED = ("rtu", "tcp", "slcan", "me_rs485")
"""One of each kind whose devices answer only when asked: a silent one takes the time of others."""

ABSENT = {
    "tcp": "closed the connection|cannot connect to",
    "wago": "closed the connection|cannot connect to",
    "me_ethernet": "closed the connection|cannot connect to",
    "multicast": "no answer within",
}
SILENT = {
    "slcan": "node 1: no answer within",
    "multicast": "node 1: no answer within",
    "sync": "did not arrive after SYNC",
    "timer": "did not arrive on the node's timer",
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
    *(
        Case(
            "dead device, long timeout",
            plant,
            silent,
            talking,
            SILENT.get(plant, "unit 1 did not answer within"),
            timeout_s=LONG_TIMEOUT_S,
        )
        for plant in ASKED
    ),
    *(
        Case("half-open connection", plant, half_open, served_again, says, whole_bus=True)
        for plant, says in (
            ("tcp", "did not answer within"),
            ("wago", "did not answer within"),
            ("me_ethernet", "no measured values within"),
        )
    ),
    *cases(
        "gateway to a dead device",
        ("tcp", "wago"),
        spoilt(now(lambda f: tcp(f, f[6:7] + bytes((f[7] | 0x80, 11))))),
        whole,
        "exception 11: gateway target did not respond",
    ),
    *cases(
        "wrong device answers",
        ("rtu",),
        spoilt(now(lambda f: frame(b"\x07" + f[1:-2]))),
        whole,
        "unit 7 answered",
    ),
    *cases("wrong device answers", ("tcp",), spoilt(now(lambda f: f[:6] + b"\x07" + f[7:])), whole, "unit 7 answered"),
    *cases("wrong device answers", ("slcan",), spoilt(now(lambda f: b"t587" + f[4:]), SDO), whole, "no answer within"),
    *cases(
        "wrong device answers",
        ("sync",),
        spoilt(now(lambda f: b"t187" + f[4:]), TPDO),
        whole,
        "0x181, 0x281 did not arrive after SYNC",
    ),
    *cases(
        "wrong device answers",
        ME_LINE,
        spoilt(now(lambda f: me(f[4:5] + b"\x11" + f[6:-2])), SENSOR),
        whole,
        "no valid answer",
    ),
    # An answer on RS-485 carries no number, nor does a TPDO: if a Micro-Epsilon sensor, or a node read by SYNC, stays
    # one answer behind, nobody can see it. One block of a Modbus device is good for as long as its late answer comes in
    # time for the same question (test_disturbed_line). They are late until they are let go.
    *cases(
        "late answer",
        ("pta", "analogue", "tcp", "wago"),
        behind((VICTIM,), before=()),
        let_go,
        "unit 1 did not answer",
    ),
    *cases("late answer", ME_LINE, behind(SENSOR, before=()), let_go, "did not answer within"),
    *cases(
        "late answer, in another's time",
        (*MODBUS_LINE, "tcp", "wago"),
        behind((VICTIM,), before=(NEIGHBOUR,)),
        whole,
        "unit 1 did not answer",
    ),
    *cases(
        "late answer, in another's time",
        ("slcan", "multicast"),
        behind(SDO, before=OTHERS_SDO),
        whole,
        "no answer within",
    ),
    *cases(
        "late answer, in another's time",
        ME_LINE,
        behind(SENSOR, before=OTHER_SENSOR),
        whole,
        "did not answer within",
    ),
    *cases("wrong device answers", ("multicast",), spoilt(now(answered_by(7)), SDO), whole, "no answer within"),
    # After a failure a node is asked for its device type first, so no late answer belongs to the object asked for:
    # test_canopen_late shows whether the bus would take one.
    *cases("late answer", ("slcan", "multicast"), behind(SDO), let_go, "no answer within"),
    *cases("late answer", ("sync",), behind((*SDO, *TPDO), before=()), let_go, "did not arrive after SYNC"),
    *cases(
        "checksum error",
        ("rtu",),
        spoilt(now(lambda f: f[:-1] + bytes((f[-1] ^ 1,)))),
        whole,
        "no valid answer",
    ),
    *cases(
        "checksum error",
        ME_LINE,
        spoilt(now(lambda f: f[:-2] + bytes((f[-2] ^ 1, f[-1]))), SENSOR),
        whole,
        "no valid answer",
    ),
    *cases("truncated frame", ("rtu",), spoilt(now(lambda f: f[:-3])), whole, "no valid answer"),
    *cases("truncated frame", ("tcp",), spoilt(now(lambda f: f[:-3])), whole, "not a complete Modbus TCP answer"),
    *cases(
        "truncated frame",
        ("slcan",),
        spoilt(now(lambda f: b"t5814" + f[5:13] + b"\r"), SDO),
        whole,
        "no answer within",
    ),
    *cases("truncated frame", ("multicast",), spoilt(now(of_length(4)), SDO), whole, "no answer within"),
    *cases("truncated datagram", ("multicast",), spoilt(now(lambda f: f[:-3]), SDO), whole, "no answer within"),
    *cases(
        "truncated frame",
        ("sync",),
        spoilt(now(lambda f: f[:4] + b"2" + f[5:9] + b"\r"), TPDO),
        whole,
        "is missing in",
    ),
    *cases(
        "truncated frame",
        ("timer",),
        spoilt(now(lambda f: f[:4] + b"2" + f[5:9] + b"\r"), TPDO),
        whole,
        "is missing in",
    ),
    *cases(
        "truncated frame",
        ("dbc",),
        spoilt(now(lambda f: f[:4] + b"1" + f[5:7] + b"\r"), LOGGER),
        whole,
        "frame of 1 bytes",
    ),
    *cases("truncated frame", ME_LINE, spoilt(now(lambda f: f[:-3]), SENSOR), whole, "no valid answer"),
    *cases("truncated frame", ("me_ethernet",), spoilt(now(lambda f: f[:-3]), None), whole, "no complete block"),
    *cases(
        "overlong frame",
        ("rtu",),
        spoilt(now(lambda f: frame(f[:2] + bytes((f[2] + 2,)) + f[3:-2] + b"\0\0"))),
        whole,
        "the answer does not fit",
    ),
    *cases(
        "overlong frame",
        ("tcp",),
        spoilt(now(lambda f: tcp(f, f[6:8] + bytes((f[8] + 2,)) + f[9:] + b"\0\0"))),
        whole,
        "the answer does not fit",
    ),
    *cases(
        "overlong frame",
        ("slcan",),
        spoilt(now(lambda f: f[:4] + b"9" + f[5:-1] + b"00\r"), SDO),
        whole,
        "no answer within",
    ),
    *cases("overlong frame", ("multicast",), spoilt(now(of_length(9)), SDO), whole, "no answer within"),
    *cases(
        "overlong frame",
        ("dbc",),
        spoilt(now(lambda f: f[:4] + b"9" + f[5:-1] + b"00\r"), LOGGER),
        whole,
        "none of the frames",
    ),
    *cases(
        "overlong frame",
        ("me_rs485",),
        spoilt(now(lambda f: me(f[4:-2] + b"\0\0")), SENSOR),
        whole,
        "10 data bytes, not 8",
    ),
    *cases(
        "overlong frame",
        ("dt6120",),
        spoilt(now(lambda f: me(f[4:-2] + b"\0\0")), SENSOR),
        whole,
        "do not hold 1 values",
    ),
    *cases("overlong frame", ("me_ethernet",), spoilt(now(lambda f: f + b"\0\0"), None), whole, "no complete block"),
    *cases(
        "exception code", MODBUS_LINE, spoilt(now(lambda f: frame(bytes((f[0], f[1] | 0x80, 6))))), whole, "device busy"
    ),
    *cases(
        "exception code",
        ("tcp", "wago"),
        spoilt(now(lambda f: tcp(f, f[6:7] + bytes((f[7] | 0x80, 6))))),
        whole,
        "exception 6: device busy",
    ),
    Case(
        "silent for one address",
        "blocks",
        spoilt(lambda f: () if f[1] == 4 else ((0.0, f),)),
        whole,
        "unit 1 does not answer function 4, address 20, count 3",
        in_part=True,
    ),
    *cases("exception code", ("slcan",), spoilt(now(abort), SDO), whole, "node 1 refused object 6150:01"),
    *cases("exception code", ("multicast",), spoilt(now(cast(aborted)), SDO), whole, "node 1 refused object 6150:01"),
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
    *(
        Case(fault, plant, sensor(kind), sensor(None), says, quality)
        for fault, kind, rows in SENSOR_FAULTS
        for plants, says, quality in rows
        for plant in plants
    ),
]


@dataclass(frozen=True)
class Harmless:
    """A disturbance that must not show in any reading: every value right, every period kept, nothing reported."""

    disturbance: str
    plant: str
    disturb: Do
    """Called once a period."""


HARMLESS: Sequence[Harmless] = [
    *(Harmless("garbage between frames", plant, around(b"\x00\xff\x01\x04", b"\x01\x84\x02")) for plant in MODBUS_LINE),
    *(
        Harmless("garbage between frames", plant, around(b"\x00\x07\x00\x00\x00\x50", b"\xff\0"))
        for plant in ("tcp", "wago")
    ),
    *(Harmless("garbage between frames", plant, around(b"\xfft58\rt9\a", b"t1818AB\rz\r")) for plant in CAN),
    Harmless("garbage between frames", "multicast", among(b"\x00", b"\xff\x81\xa3foo", b"")),
    *(Harmless("garbage between frames", plant, around(b"\x68\x0b\x16", b"\x68\xff")) for plant in ME_LINE),
    Harmless("garbage between frames", "me_ethernet", around(b"\0\xffMEAS\x07")),
    *(Harmless("storm of emergencies", plant, emergencies) for plant in (*CANOPEN, "multicast")),
    *(Harmless("node restarts between two reads", plant, restarted) for plant in (*CANOPEN, "multicast")),
]
