"""Controls whose agent reports values that are channels."""

from drivers.agent.profile import AgentProfile
from drivers.agent.settings import AgentBusSettings
from drivers.base import Bus, Clock, Driver
from drivers.family import BusKind, DeviceKind, Family, NoOptions, PlacedDevice
from drivers.tap import Tap


def _bus(name: str, settings: AgentBusSettings, tap: Tap | None) -> Bus:
    from drivers.agent.bus import AgentBus

    return AgentBus(name, settings, tap)


def _device(device: PlacedDevice[AgentProfile, NoOptions], bus: Bus, clock: Clock) -> Driver:
    from drivers.agent.bus import AgentBus
    from drivers.agent.device import AgentDevice

    if not isinstance(bus, AgentBus):
        raise device.foreign(bus)
    return AgentDevice(device.name, bus, device.profile, device.channels, clock)


FAMILY = Family(
    buses=(BusKind(AgentBusSettings, _bus),),
    devices=(DeviceKind(AgentProfile, NoOptions, _device),),
)
