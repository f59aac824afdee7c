"""Builds the driver of a control with an MTConnect agent."""

from drivers.base import Clock
from drivers.mtconnect.settings import MtConnectSettings
from drivers.nc import NumericalControl


def make_mtconnect(settings: MtConnectSettings, clock: Clock) -> NumericalControl:
    """The driver for these settings. No network."""
    from drivers.mtconnect.control import MtConnectControl  # loads an HTTP client, which few gateways need

    return MtConnectControl(settings, clock)
