"""Reports of each device about a broken sensor: rows of the fault matrix."""

from collections.abc import Sequence

from drivers.base import Quality
from simulators.devices.source import SensorFault
from tests.benches.faults.plants import CANOPEN, ME_LINE

BROKEN, BEYOND = Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE
BUSES = (*CANOPEN, "multicast")
DISTANCE = (*ME_LINE, "me_ethernet")
SENSOR_FAULTS: Sequence[tuple[str, SensorFault, Sequence[tuple[Sequence[str], str, Quality]]]] = [
    (
        "sensor open",
        SensorFault.OPEN,
        [
            (("rtu",), "the module reports this input broken", BROKEN),
            (("pta",), "97.7 degC is the reading of this device", BROKEN),
            (("analogue",), "0 µm is outside 5 to 500 µm", BEYOND),
            (("blocks",), "sensor is broken", BROKEN),
            (("tcp",), "burnout: open circuit at this input", BROKEN),
            (("wago",), "broken wire", BROKEN),
            (BUSES, "sensor fault", BROKEN),
            (("dbc",), "open", BROKEN),
            (("me_rs485",), "the sensor sends no number", BROKEN),
            (("dt6120", "me_ethernet"), "of the measuring range", BEYOND),
        ],
    ),
    (
        "sensor short",
        SensorFault.SHORT,
        [
            (("rtu",), "the module reports this input broken", BROKEN),
            (("pta",), "-200 degC is outside", BEYOND),
            (("analogue",), "0 µm is outside 5 to 500 µm", BEYOND),
            (("blocks",), "sensor is broken", BROKEN),
            (("tcp",), "at or below the start", BEYOND),
            (("wago",), "short circuit", BROKEN),
            (BUSES, "sensor fault", BROKEN),
            (("dbc",), "short", BROKEN),
            (("me_rs485",), "the sensor sends no number", BROKEN),
            (("dt6120", "me_ethernet"), "of the measuring range", BEYOND),
        ],
    ),
    (
        "over range",
        SensorFault.OVER,
        [
            (("rtu",), "above the input's range", BROKEN),
            (("pta",), "400 degC is outside", BEYOND),
            (("analogue",), "above the module's input range", BEYOND),
            (("blocks",), "beyond the range", BEYOND),
            (("tcp",), "at or above the end", BEYOND),
            (("wago",), "above 850 degC", BEYOND),
            (BUSES, "above the measuring range", BEYOND),
            (("dbc",), "900 is beyond the range of the DBC file", BEYOND),
            (DISTANCE, "of the measuring range", BEYOND),
        ],
    ),
    (
        "under range",
        SensorFault.UNDER,
        [
            (("rtu",), "below the input's range", BROKEN),
            (("pta",), "-200 degC is outside", BEYOND),
            (("analogue",), "below the module's input range", BEYOND),
            (("blocks",), "beyond the range", BEYOND),
            (("tcp",), "at or below the start", BEYOND),
            (("wago",), "below -200 degC", BEYOND),
            (BUSES, "below the measuring range", BEYOND),
            (("dbc",), "-250 is beyond the range of the DBC file", BEYOND),
            (DISTANCE, "of the measuring range", BEYOND),
        ],
    ),
]
"""By fault: which plants, what their reading says, and its quality."""
