"""Controls with an MTConnect agent, which are only read: positions, speeds and states.

`make_mtconnect` makes the driver itself: it loads an HTTP client.
"""

from drivers.mtconnect.make import make_mtconnect
from drivers.mtconnect.settings import MtConnectSettings

__all__ = ["MtConnectSettings", "make_mtconnect"]
