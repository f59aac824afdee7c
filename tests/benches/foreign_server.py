"""Third-party servers on loopback: entered when their port accepts a connection, whatever they print before or
after."""

import os
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

LIMIT_S = 300.0
"""For what takes a second: a server that neither accepts nor ends is broken, not slow."""


def until_it_accepts(address: tuple[str, int], process: "subprocess.Popen[str]", log: Path) -> None:
    """Wait for a server's port. Raises AssertionError with the log if the server ends, or does not accept at all."""
    latest_s = time.monotonic() + LIMIT_S
    while process.poll() is None and time.monotonic() < latest_s:
        try:
            socket.create_connection(address, LIMIT_S).close()
        except ConnectionRefusedError:
            time.sleep(0.02)
        else:
            return
    state = "accepts nobody" if process.poll() is None else "ended"
    said = log.read_text(encoding="utf-8", errors="replace")
    raise AssertionError(f"the server at {address[0]}:{address[1]} {state}; {log}:\n{said}")


def started(
    command: Sequence[str], port: int, log: Path, environment: Mapping[str, str] | None = None
) -> "subprocess.Popen[str]":
    """A server whose port on 127.0.0.1 accepts. What it prints is in `log`: nobody must empty a pipe for it."""
    with log.open("w", encoding="utf-8") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=os.environ | (environment or {}), text=True
        )
    try:
        until_it_accepts(("127.0.0.1", port), process, log)
    except BaseException:
        ended(process)
        raise
    return process


def ended(process: "subprocess.Popen[str]") -> None:
    """End it as a service manager does."""
    process.terminate()
    process.wait(LIMIT_S)


@contextmanager
def foreign_server(
    command: Sequence[str], port: int, log: Path, environment: Mapping[str, str] | None = None
) -> Iterator[None]:
    """A server; yields once its port on 127.0.0.1 accepts a connection."""
    process = started(command, port, log, environment)
    try:
        yield
    finally:
        ended(process)


class RestartableServer:
    """A server that can be stopped and started again on its port.

    Parameters
    ----------
    command: what starts it
    port: on 127.0.0.1
    log: gets what it prints
    """

    def __init__(self, command: Sequence[str], port: int, log: Path) -> None:
        self._command, self._log, self.port = command, log, port
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Returns when its port accepts a connection."""
        self._process = started(self._command, self.port, self._log)

    def stop(self) -> None:
        """Ends all connections."""
        if self._process is not None:
            ended(self._process)
            self._process = None

    @contextmanager
    def running(self) -> Iterator[None]:
        self.start()
        try:
            yield
        finally:
            self.stop()
