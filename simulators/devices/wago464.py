"""An emulated WAGO 750-464 (four Pt100 inputs) in the process image of a Modbus coupler."""

from collections.abc import Mapping

from simulators.devices.source import Faults, SensorFault, ValueSource

INPUTS = 4
_LOW, _HIGH = -2000, 8500
_STATUS = {SensorFault.UNDER: 0x41, SensorFault.OVER: 0x42, SensorFault.SHORT: 0x51, SensorFault.OPEN: 0x62}


class Wago464:
    """A unit for a TcpHost. Input i: status in register `start + 2 i`, value in 0.1 degC in the next one."""

    def __init__(self, source: ValueSource, *, start: int = 0) -> None:
        self._source, self._start = source, start
        self.faults = Faults()

    @property
    def silent(self) -> bool:
        return self.faults.silent

    def memory(self, function: int) -> Mapping[int, int]:
        if function != 4:
            return {}
        image: dict[int, int] = {}
        for channel, value in enumerate(self._source()):
            status, tenths = self._input(channel, round(value * 10))
            image[self._start + 2 * channel] = status
            image[self._start + 2 * channel + 1] = tenths & 0xFFFF
        return image

    def _input(self, channel: int, tenths: int) -> tuple[int, int]:
        """Status byte and value; the value clamps at an end of the range."""
        fault = self.faults.by_channel.get(channel)
        if fault is None:
            fault = SensorFault.OVER if tenths > _HIGH else SensorFault.UNDER if tenths < _LOW else None
        if fault is None:
            return 0, tenths
        return _STATUS[fault], _HIGH if fault in (SensorFault.OVER, SensorFault.OPEN) else _LOW
