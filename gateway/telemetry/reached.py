"""How others reach a gateway's telemetry: the session that is kept open, and whether what it publishes comes back."""

from gateway.config.telemetry import Telemetry
from gateway.model.connection import Connection
from gateway.telemetry import keys
from gateway.telemetry.echo import Echo
from gateway.telemetry.kept import Kept, KeptSession
from gateway.telemetry.session import own_access, session_config


class Reached:
    """One gateway's session and its echo; nothing is opened before they are started.

    Parameters
    ----------
    settings: the [telemetry] section
    machine: second part of every key
    boot: identifies this run of the process
    """

    def __init__(self, settings: Telemetry, machine: str, boot: str) -> None:
        kept = Kept(
            lambda: session_config(settings), lambda: own_access(settings), settings.connect, settings.listening
        )
        self.session, self.echo = KeptSession(kept), Echo(settings, keys.root(settings.prefix, machine), boot)

    def connection(self) -> Connection:
        """Whether the session is open and connected, as it was found last."""
        return self.echo.known(self.session.connection)
