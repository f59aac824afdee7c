"""An emulated Advantech ADAM-6015: seven RTD inputs, uint16 over the range of each input's type code."""

from collections.abc import Mapping, Sequence

from simulators.devices.source import Faults, SensorFault, ValueSource, clamp

INPUTS = 7
PT100_150 = 0x03A4
"""Type code: Pt100, -50 to 150 degC."""

_RANGES = {
    0x03A2: (-200.0, 200.0),
    0x03A4: (-50.0, 150.0),
    0x03A5: (0.0, 100.0),
    0x03A6: (0.0, 200.0),
    0x03A7: (0.0, 400.0),
}
_FULL_SCALE = 65535


class Adam6015:
    """A unit for a TcpHost. Coils 120.. (function 1) report burnout, registers 200.. (function 3) the type codes."""

    def __init__(self, source: ValueSource, *, type_codes: Sequence[int] = (PT100_150,) * INPUTS) -> None:
        self._source, self._type_codes = source, list(type_codes)
        self.faults = Faults()

    @property
    def silent(self) -> bool:
        return self.faults.silent

    def set_type_code(self, channel: int, code: int) -> None:
        """Sets a type code, as a technician does with the maker's tool."""
        self._type_codes[channel] = code

    def memory(self, function: int) -> Mapping[int, int]:
        if function == 3:
            values = {i: self._register(i, value) for i, value in enumerate(self._source())}
            return values | {200 + i: code for i, code in enumerate(self._type_codes)}
        if function == 1:
            return {120 + i: int(self.faults.by_channel.get(i) is SensorFault.OPEN) for i in range(INPUTS)}
        return {}

    def _register(self, channel: int, value: float) -> int:
        match self.faults.by_channel.get(channel):
            case SensorFault.OPEN | SensorFault.OVER:
                return _FULL_SCALE
            case SensorFault.SHORT | SensorFault.UNDER:
                return 0
            case None:
                low, high = _RANGES.get(self._type_codes[channel], _RANGES[PT100_150])
                return round(clamp((value - low) / (high - low), 0.0, 1.0) * _FULL_SCALE)
