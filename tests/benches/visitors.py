"""Memory of the programs that listen while strangers connect: `python -m tests.benches.visitors --connections 5000`.

To each port come as many connections as that, some at a time: silent ones, half a request, a byte now and then, half a
hello of TLS, a whole handshake and no more. Between them somebody asks as one should, and must be answered.
"""

import asyncio
import logging
import random
import resource
import ssl
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click

from tests.benches.free_port import free_port
from tests.benches.plant_authority import PlantAuthority
from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus
from tests.benches.waits import wait_until

MOST_MB = 20
_TOGETHER = 250
"""Connections at a time of one batch; those of the batches before stay open until the server ends them."""
_ANSWERED_S, _PAUSE_S = 20.0, 0.05
_KINDS = ("idle", "half", "slow", "half of TLS", "silent after TLS")
_HELLO = bytes.fromhex("160301020001000200")
_REQUEST = b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"


class Port(NamedTuple):
    """A program that listens."""

    name: str
    arguments: tuple[str, ...]
    port: int
    tls: bool = False
    asks: bytes = _REQUEST


def ports(folder: Path) -> list[Port]:
    """Metrics and page, plain and by TLS, and umati."""
    certificate, key = PlantAuthority(folder).issue("localhost")
    found = []
    for tls in (False, True):
        to, listen = (
            ("", "")
            if not tls
            else ("tls = true\n", f'[telemetry.tls]\ncertificate = "{certificate}"\nkey = "{key}"\n')
        )
        number, config = free_port(), folder / f"metrics{tls}.toml"
        store = f'[storage]\npath = "{folder}/{tls}.sqlite"\n'
        config.write_text(
            f'{UNPUBLISHED}{listen}{store}{rtu_bus()}{m7015()}[metrics]\nlisten = "127.0.0.1:{number}"\n{to}'
        )
        asks = _REQUEST.replace(b"/ ", b"/metrics ", 1)
        found.append(Port("metrics", ("run", str(config)), number, tls, asks))
        number, settings = free_port(), folder / f"web{tls}.toml"
        settings.write_text(f'[tls]\ncertificate = "{certificate}"\nkey = "{key}"\n' if tls else "")
        page = ("web", "--connect", "tcp/127.0.0.1:1", "--settings", str(settings), "--listen", f"127.0.0.1:{number}")
        found.append(Port("page", page, number, tls))
    number = free_port()
    shown = folder / "umati.toml"
    shown.write_text("[machine.mill]\n")
    umati = ("opcua", "--connect", "tcp/127.0.0.1:1", "--settings", str(shown), "--listen", f"127.0.0.1:{number}")
    hello = b"opc.tcp://127.0.0.1/"
    sizes = b"".join(n.to_bytes(4, "little") for n in (0, 65536, 65536, 0, 0, len(hello)))
    asks = b"HELF" + (8 + len(sizes) + len(hello)).to_bytes(4, "little") + sizes + hello
    return [*found, Port("umati", umati, number, asks=asks)]


def _mb(pid: int, what: str) -> float:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith(what)) / 1024


async def _connect(port: Port, kind: str, tls: ssl.SSLContext) -> asyncio.StreamWriter | None:
    with suppress(OSError, asyncio.IncompleteReadError):
        shakes = tls if kind == "silent after TLS" and port.tls else None
        _, writer = await asyncio.open_connection(
            "127.0.0.1", port.port, ssl=shakes, ssl_handshake_timeout=_wait(shakes)
        )
        writer.write({"half": port.asks[:-9], "slow": port.asks[:1], "half of TLS": _HELLO}.get(kind, b""))
        return writer
    return None


def _wait(shakes: ssl.SSLContext | None) -> float | None:
    return None if shakes is None else _ANSWERED_S


async def _asked(port: Port, tls: ssl.SSLContext) -> bool:
    async with asyncio.timeout(_ANSWERED_S):
        while True:
            with suppress(OSError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port.port, ssl=tls if port.tls else None)
                writer.write(port.asks)
                answered = await reader.read(4)
                writer.close()
                if answered:
                    return True
            await asyncio.sleep(_PAUSE_S)


async def visited(port: Port, connections: int, seed: int) -> None:
    """All of them, one batch after the other. Raises TimeoutError if nobody is answered meanwhile."""
    draw, tls, open_ = random.Random(seed), ssl.create_default_context(), list[asyncio.StreamWriter]()
    tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    for begin in range(0, connections, _TOGETHER):
        came = await asyncio.gather(
            *(_connect(port, draw.choice(_KINDS), tls) for _ in range(begin, min(begin + _TOGETHER, connections)))
        )
        open_ += [writer for writer in came if writer is not None]
        for writer in open_[:: 1 + len(open_) // 50]:
            with suppress(OSError):
                writer.write(b"G")
        await _asked(port, tls)
    for writer in open_:
        writer.close()


@click.command()
@click.option("--connections", default=5000, show_default=True, help="To each port.")
@click.option("--seed", default=0, show_default=True)
def main(connections: int, seed: int) -> None:
    """Print what each program took more at most. Exit code 1: more than 20 MB, or somebody was not answered."""
    logging.disable(logging.CRITICAL)  # asyncio's of connections that the server has ended
    resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
    wrong = False
    with TemporaryDirectory() as name, ExitStack() as stack:
        for port in ports(Path(name)):
            command = [str(Path(sys.executable).with_name("talc-gateway")), *port.arguments]
            program = stack.enter_context(
                subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            )
            stack.callback(program.terminate)
            wait_until(lambda at=port: _listens(at))  # type: ignore[misc]
            asyncio.run(visited(port, _TOGETHER, seed))  # what is loaded once is loaded then
            before, began_s = _mb(program.pid, "VmRSS"), time.monotonic()
            Path(f"/proc/{program.pid}/clear_refs").write_text("5", encoding="ascii")
            answered = True
            try:
                asyncio.run(visited(port, connections, seed))
            except TimeoutError:
                answered = False
            more = _mb(program.pid, "VmHWM") - before
            wrong |= more > MOST_MB or not answered
            what = f"{port.name}{' by TLS' if port.tls else ''}"
            click.echo(
                f"{what:16} {connections} connections in {time.monotonic() - began_s:.0f} s: {before:.0f} MB, at most"
                f" {more:.1f} MB more, {'' if answered else 'NOT '}answered"
            )
    sys.exit(wrong)


def _listens(port: Port) -> bool:
    with suppress(OSError, TimeoutError):
        asyncio.run(visited(port, 1, 0))
        return True
    return False


if __name__ == "__main__":
    main()
