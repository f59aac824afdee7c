"""ser2net, Debian's device server, for tests with marker `peer`: it puts one serial port on the network."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.benches.foreign_server import RestartableServer
from tests.benches.free_port import free_port

_CONFIG = """%YAML 1.1
---
connection: &line
  accepter: {accepter},tcp,127.0.0.1,{port}
  connector: serialdev,{device},1200n81,local
  options:
    kickolduser: {newest_wins}
"""


class Ser2net(RestartableServer):
    """A device server on loopback; it can be stopped and started again on its port.

    Parameters
    ----------
    folder: for its files
    device: the serial port, opened at 1200 baud unless the client says otherwise
    scheme: `rfc2217`, or `socket` for raw TCP
    newest_wins: a new client takes the port from the one before; otherwise it is refused
    """

    def __init__(self, folder: Path, device: str, scheme: str, *, newest_wins: bool = True) -> None:
        program = shutil.which("ser2net", path="/usr/sbin:/usr/bin")
        assert program is not None, "ser2net is missing: install Debian's ser2net"
        port = free_port()
        config = folder / "ser2net.yaml"
        accepter = "telnet(rfc2217)" if scheme == "rfc2217" else ""
        wins = str(newest_wins).lower()
        text = _CONFIG.format(accepter=accepter, port=port, device=device, newest_wins=wins)
        config.write_text(text.replace(" ,tcp", " tcp"))
        super().__init__([program, "-n", "-u", "-d", "-c", str(config)], port, folder / "ser2net.log")
        self.url = f"{scheme}://127.0.0.1:{port}"


@contextmanager
def ser2net(folder: Path, device: str, scheme: str, *, newest_wins: bool = True) -> Iterator[Ser2net]:
    """A server that runs."""
    server = Ser2net(folder, device, scheme, newest_wins=newest_wins)
    with server.running():
        yield server
