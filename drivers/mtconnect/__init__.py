"""Controls with an MTConnect agent, which are only read: positions, speeds and states.

`make_mtconnect` makes the driver itself: it loads an HTTP client. `suggest_mtconnect` reads an agent's description for
a first configuration.
"""
