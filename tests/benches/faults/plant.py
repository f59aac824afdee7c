"""A small plant of the fault matrix: one wire with a victim and a neighbour, and what a test may do to them."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.base import Bus, Driver, SystemClock
from drivers.build import make_device
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.loopback import LoopbackServer
from simulators.devices.slcan_adapter import CanFrame
from simulators.devices.source import Faults
from tests.benches.faults.said import Said
from tests.benches.rigs import Spoilable

TIMEOUT_S = 0.045
VICTIM, NEIGHBOUR = 1, 2
SENSORS = (0x7E, 0x7D)
RANGE_UM = 500.0
CHANNELS = {"victim": 0, "beside": 1}
"""Channel 0 of the victim is broken; channel 1 sits on the same device."""

FaultStep = Callable[[], Awaitable[None]]


@dataclass
class FaultyPlant:
    """One bus under test, its two devices, and what the test may do to them."""

    bus: Bus
    drivers: tuple[Driver, ...]
    said: Sequence[Said]
    """What each device measures."""
    faults: Faults
    unplug: FaultStep
    plug: FaultStep
    wire: Spoilable | None = None
    adapter: SlcanAdapter | None = None
    node: Cia404Node | None = None
    server: LoopbackServer | None = None
    send: Callable[[list[CanFrame]], None] = lambda _: None
    """Frames that another node on a CAN bus sends."""
    retype: Callable[[int], None] = lambda _: None
    """Another type code at the victim's channel 0; 0 is the right one again."""
    stop: Sequence[FaultStep] = ()
    last_word: bool = True
    """A reading comes from one request: it shows the last value that the device sent, not only one sent since the last
    reading."""


def pair(bus: Bus, profiles: tuple[str, str], options: Mapping[str, object]) -> tuple[Driver, Driver]:
    """Victim and neighbour on one wire."""
    clock = SystemClock()
    return (
        make_device("victim", bus, profiles[0], VICTIM, CHANNELS, options, clock),
        make_device("neighbour", bus, profiles[1], NEIGHBOUR, {"neighbour": 0}, options, clock),
    )


def _point(link: Path, path: str | None) -> None:
    """What udev does: the name is there while the adapter is."""
    link.unlink(missing_ok=True)
    if path is not None:
        link.symlink_to(path)


def cable(link: Path, start: Callable[[], Awaitable[str]], stop: FaultStep) -> tuple[FaultStep, FaultStep]:
    """Plug and unplug: a new terminal each time, under the same name."""

    async def plug() -> None:
        _point(link, await start())

    async def unplug() -> None:
        _point(link, None)
        await stop()

    return plug, unplug
