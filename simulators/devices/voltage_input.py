"""An emulated voltage input module with analogue displacement sensors on it."""

from collections.abc import Mapping

from simulators.devices.source import Faults, SensorFault, ValueSource

_SHOWN = {SensorFault.OPEN: 0, SensorFault.SHORT: 0, SensorFault.OVER: 0x7FFF, SensorFault.UNDER: 0x8000}
_MV_AT_FULL_SCALE = 10_000


class VoltageInput:
    """A unit for an RtuLine or TcpHost; registers 0.. (function 4) in mV, 10 V at `range_um`."""

    def __init__(self, source: ValueSource, *, range_um: float) -> None:
        self._source, self._range_um = source, range_um
        self.faults = Faults()

    @property
    def silent(self) -> bool:
        return self.faults.silent

    def memory(self, function: int) -> Mapping[int, int]:
        if function != 4:
            return {}
        return {i: self._register(i, value) for i, value in enumerate(self._source())}

    def _register(self, channel: int, distance_um: float) -> int:
        fault = self.faults.by_channel.get(channel)
        if fault is not None:
            return _SHOWN[fault]
        millivolts = round(distance_um / self._range_um * _MV_AT_FULL_SCALE)
        if millivolts > 0x7FFE:
            return 0x7FFF
        return 0x8000 if millivolts < -0x7FFF else millivolts & 0xFFFF
