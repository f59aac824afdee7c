"""Reports the state of the service to systemd, with datagrams as in sd_notify(3). Without systemd nothing is sent."""

import logging
import os
import socket
from collections.abc import Mapping

from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of

log = logging.getLogger(__name__)


class ServiceManager:
    """The manager that started this process.

    Parameters
    ----------
    environment: `NOTIFY_SOCKET` names the manager's socket, `WATCHDOG_USEC` how long it waits for a sign of life
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        path = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + path[1:] if path.startswith("@") else path
        usec, pid = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
        ours = not pid or pid == str(os.getpid())
        self.watchdog_s = int(usec) * 1e-6 if self._address and usec.isdecimal() and ours else None
        """It restarts the service after this time without `alive`; None: never."""

    def ready(self, text: str) -> None:
        """The service has started, or has taken in another configuration."""
        self._send("READY=1", f"STATUS={text}")

    def alive(self) -> None:
        """Every loop makes progress."""
        self._send("WATCHDOG=1")

    def stopping(self, text: str, longest_s: float) -> None:
        """The service ends, and needs up to this long for it, whatever the unit file says."""
        self._send("STOPPING=1", f"STATUS={text}", f"EXTEND_TIMEOUT_USEC={round(longest_s * 1e6)}")

    def _send(self, *lines: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            sender.setblocking(False)  # a manager that does not read must not stop the gateway
            try:
                sender.sendto("\n".join(lines).encode(), self._address)
            except OSError as error:
                log.warning("%s", Text(NoticeCode.SYSTEMD_UNREACHED, of=lines[0], error=text_of(error)))
