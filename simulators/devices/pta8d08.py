"""An emulated Eletechsup PTA8D08 (eight Pt100 inputs), which does not detect broken sensors."""

from collections.abc import Mapping

from simulators.devices.source import Faults, SensorFault, ValueSource

INPUTS = 8
_SHOWN = {SensorFault.OPEN: 97.7, SensorFault.SHORT: -200.0, SensorFault.OVER: 400.0, SensorFault.UNDER: -200.0}
_A, _B = 3.9083e-3, -5.775e-7  # Callendar-Van Dusen, IEC 60751


class Pta8d08:
    """A unit for an RtuLine. Function 3: registers 0.. in 0.1 degC, 32.. in 0.1 ohm."""

    def __init__(self, source: ValueSource) -> None:
        self._source = source
        self.faults = Faults()

    @property
    def silent(self) -> bool:
        return self.faults.silent

    def memory(self, function: int) -> Mapping[int, int]:
        if function != 3:
            return {}
        shown = [self._measured(channel, value) for channel, value in enumerate(self._source())]
        values = {i: round(value * 10) & 0xFFFF for i, value in enumerate(shown)}
        return values | {32 + i: round(pt100_ohm(value) * 10) for i, value in enumerate(shown)}

    def _measured(self, channel: int, value: float) -> float:
        fault = self.faults.by_channel.get(channel)
        return value if fault is None else _SHOWN[fault]


def pt100_ohm(temperature: float) -> float:
    """Resistance of a Pt100 (IEC 60751, without the term below 0 degC, which is under 0.2 ohm down to -100 degC)."""
    return 100.0 * (1 + _A * temperature + _B * temperature**2)
