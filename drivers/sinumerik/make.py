"""Builds the driver of a SINUMERIK control."""

from drivers.base import Clock
from drivers.nc import NumericalControl
from drivers.sinumerik.settings import SinumerikSettings


def make_sinumerik(settings: SinumerikSettings, clock: Clock) -> NumericalControl:
    """The driver for these settings; with route `k0_slope` it implements FollowsPosition, with `errors` FollowsErrors.
    No network."""
    # Importing OPC UA takes half a second and 20 MB: only for a control that needs it.
    from drivers.sinumerik.control import Sinumerik
    from drivers.sinumerik.errors import SinumerikWithErrors
    from drivers.sinumerik.slope import SinumerikWithSlopes

    kinds = {"k0_slope": SinumerikWithSlopes, "errors": SinumerikWithErrors}
    return kinds.get(settings.compensation.route, Sinumerik)(settings, clock)
