"""The control's variables under their OPC UA names, and the rights to write them, independent of any protocol.

Names as in the SINUMERIK Access MyMachine / OPC UA manual: R-parameters `/Channel/Parameter/R[u1,10]`, machine axes
`/Channel/MachineAxis/...[u1,axis]`, setting data `/NC/_N_AX_SEA_ACX/$SA_...[u<axis>]`, PLC bits `/Plc/M120.0`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from simulators.nc.moves import AXIS_LETTERS
from simulators.nc.nck import CEC_TABLES, NOT_REFERENCED, REFERENCED, MachineState, Nck

Value = float | int | bool


class AccessRight(StrEnum):
    """Rights a user is given with the control's method GiveUserAccess."""

    STATE_READ = "StateRead"
    STATE_WRITE = "StateWrite"
    SEA_READ = "SeaRead"
    SEA_WRITE = "SeaWrite"
    PLC_READ = "PlcRead"
    TEA_READ = "TeaRead"


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable: `read` takes the machine's present state, `write` the value and the time."""

    read: Callable[[MachineState], Value]
    readable_with: AccessRight = AccessRight.STATE_READ
    write: Callable[[float, float], None] | None = None
    writable_with: AccessRight | None = None


COOLANT = "/Plc/M120.0"
PROBE_IN_SPINDLE = "/Plc/M120.1"
DRIVES_ON = "/Plc/M120.2"
"""Bits that a machine builder would define; their addresses are the emulated control's choice."""

ALARMS_SHOWN = 16
"""The oldest first, in the order of the control."""


def variables(nck: Nck) -> Mapping[str, Variable]:
    """Every variable of the control, by name."""
    table = {
        "/Channel/Spindle/actSpeed[u1,1]": Variable(lambda s: s.loads.spindle),
        "/Channel/State/progStatus[u1]": Variable(lambda s: s.program_status),
        "/Channel/State/actTNumber[u1]": Variable(lambda s: s.tool),
        "/Channel/State/actToolLength1[u1]": Variable(lambda _: nck.tool_length_mm),
        "/Bag/State/opMode[u1]": Variable(lambda s: s.mode),
        "/Nck/State/numAlarms": Variable(lambda s: len(s.alarms)),
        COOLANT: Variable(lambda s: s.loads.coolant > 0.5, AccessRight.PLC_READ),
        PROBE_IN_SPINDLE: Variable(lambda s: s.probing, AccessRight.PLC_READ),
        "/NC/_N_NC_TEA_ACX/$MN_SCALING_SYSTEM_IS_METRIC": Variable(lambda _: nck.metric, AccessRight.TEA_READ),
        DRIVES_ON: Variable(lambda _: nck.drives_on, AccessRight.PLC_READ),
    }
    for index in range(ALARMS_SHOWN):
        table[f"/Nck/SequencedAlarms/textIndex[{index + 1}]"] = _alarm(index)
    for index, axis in enumerate(AXIS_LETTERS):
        table[f"/Channel/MachineAxis/actToolBasePos[u1,{index + 1}]"] = _position(axis)
        table[f"/Channel/MachineAxis/actFeedRate[u1,{index + 1}]"] = _feed(index)
        table[f"/Channel/MachineAxis/refPtStatus[u1,{index + 1}]"] = Variable(
            lambda _: REFERENCED if nck.referenced else NOT_REFERENCED
        )
    for number in range(len(nck.r)):
        table[f"/Channel/Parameter/R[u1,{number}]"] = _r_parameter(nck, number)
    for name, values in (
        ("TEMP_COMP_SLOPE", nck.slope),
        ("TEMP_COMP_REF_POSITION", nck.reference_mm),
    ):
        for index in range(3):
            table[f"/NC/_N_AX_SEA_ACX/$SA_{name}[u{index + 1}]"] = _setting(nck, values, index)
    for index in range(len(CEC_TABLES)):
        table[f"/NC/_N_NC_SEA_ACX/$SN_CEC_TABLE_WEIGHT[{index + 1}]"] = _setting(nck, nck.table_weight, index)
    for index in range(3):
        table[f"/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u{index + 1}]"] = _k0(nck, index)
    return table


def _k0(nck: Nck, index: int) -> Variable:
    return Variable(
        lambda _: nck.k0_mm[index],
        AccessRight.SEA_READ,
        lambda value, now_s: nck.write_k0(index, value, now_s),
        AccessRight.SEA_WRITE,
    )


def _alarm(index: int) -> Variable:
    return Variable(lambda s: s.alarms[index] if index < len(s.alarms) else 0)


def _position(axis: str) -> Variable:
    return Variable(lambda s: s.positions[axis])


def _feed(index: int) -> Variable:
    scale = 360.0 if AXIS_LETTERS[index] in "AC" else 1.0  # degrees per minute, as the control shows rotary axes
    return Variable(lambda s: s.loads.as_tuple()[index] * scale)


def _r_parameter(nck: Nck, number: int) -> Variable:
    return Variable(
        lambda _: nck.r[number],
        write=lambda value, now_s: nck.write_r(number, value, now_s),
        writable_with=AccessRight.STATE_WRITE,
    )


def _setting(nck: Nck, values: list[float], index: int) -> Variable:
    def write(value: float, now_s: float) -> None:
        nck.write_setting(values, index, value, now_s)

    return Variable(lambda _: values[index], AccessRight.SEA_READ, write, AccessRight.SEA_WRITE)
