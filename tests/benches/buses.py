"""A bus from its kind and its fields, as a test writes them."""

from collections.abc import Mapping

from drivers.base import Bus
from drivers.build import BUS_KINDS, bus_from_settings
from drivers.problems import read_settings
from drivers.tap import Tap


def make_bus(name: str, kind: str, options: Mapping[str, object], tap: Tap | None = None) -> Bus:
    """Build a bus of that kind (a key of BUS_KINDS); `options` are the fields of its settings class.

    tap: receives everything that passes on the wire

    Raises SetupError naming the bus, the field and the value.
    """
    return bus_from_settings(name, read_settings(BUS_KINDS[kind], options, bus=name), tap)
