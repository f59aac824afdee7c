"""An emulated ICP DAS M-7015: six RTD inputs, engineering format in 0.1 degC, or hexadecimal: parts of the range."""

from collections.abc import Mapping, Sequence

from simulators.devices.source import Faults, SensorFault, ValueSource

INPUTS = 6
PT100_200 = 0x2E
"""Type code: Pt100, -200 to 200 degC."""

_RANGES = {0x2E: (-200.0, 200.0), 0x20: (-100.0, 100.0), 0x21: (0.0, 100.0), 0x80: (-200.0, 600.0)}
_OVER, _UNDER = 0x7FFF, 0x8000


class M7015:
    """A unit for an RtuLine. Bits 128.. (function 2): inputs out of range; registers 256.. (function 3): type codes.

    Coil 268 (function 1): data format, set when it is engineering.
    """

    def __init__(self, source: ValueSource, *, type_codes: Sequence[int] = (PT100_200,) * INPUTS) -> None:
        self._source, self._type_codes = source, list(type_codes)
        self.faults = Faults()
        self.engineering = True
        """Data format, as a technician sets it with the maker's tool."""

    @property
    def silent(self) -> bool:
        return self.faults.silent

    def set_type_code(self, channel: int, code: int) -> None:
        """Sets a type code, as a technician does with the maker's tool."""
        self._type_codes[channel] = code

    def memory(self, function: int) -> Mapping[int, int]:
        if function == 4:
            return dict(enumerate(self._registers()))
        if function == 2:
            return {128 + i: int(word in (_OVER, _UNDER)) for i, word in enumerate(self._registers())}
        if function == 1:
            return {268: int(self.engineering)}
        if function == 3:
            return {256 + i: code for i, code in enumerate(self._type_codes)}
        return {}

    def _registers(self) -> list[int]:
        return [self._register(channel, value) for channel, value in enumerate(self._source())]

    def _register(self, channel: int, value: float) -> int:
        low, high = _RANGES.get(self._type_codes[channel], (-200.0, 200.0))
        match self.faults.by_channel.get(channel):
            case SensorFault.OPEN | SensorFault.OVER:
                return _OVER
            case SensorFault.SHORT | SensorFault.UNDER:
                return _UNDER
            case None:
                if value > high:
                    return _OVER
                if value < low:
                    return _UNDER
                raw = value * 10 if self.engineering else value / max(-low, high) * _OVER
                return round(raw) & 0xFFFF
