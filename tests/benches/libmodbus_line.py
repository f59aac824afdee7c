"""Debian's libmodbus as a slave, for tests with marker `peer`; on a serial line, which may be an odd one."""

import os
import subprocess
import sys
import termios
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

from drivers.modbus.bus import ModbusBus
from simulators.devices.pty_port import PtyPort
from tests.benches.buses import make_bus

TIMEOUT_S = 5.0
"""A busy computer may need this long for another program's answer."""
UNIT = 3
"""The unit id on the serial line."""
SLAVE = Path(__file__).parent / "libmodbus_slave.py"


@contextmanager
def slave(*arguments: str) -> Iterator[str]:
    """A slave process; gives the line it prints when it is ready."""
    with subprocess.Popen([sys.executable, str(SLAVE), *arguments], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline().strip()
            assert line, "the slave did not start: apt-get install libmodbus5"
            yield line
        finally:
            process.kill()


@asynccontextmanager
async def libmodbus_line(heard: Callable[[bytes], bytes] = bytes, *, echoes: bool = False) -> AsyncIterator[ModbusBus]:
    """A connected bus whose line has libmodbus at its far end.

    heard: what arrives of what libmodbus sends
    echoes: the kernel's terminal sends back every byte on its way to libmodbus
    """
    near: PtyPort
    far = PtyPort(lambda data: near.write(heard(data)))
    near = PtyPort(far.write)
    near_path, far_path = await near.start(), await far.start()
    bus = make_bus("rtu1", "modbus_rtu", {"port": near_path, "baud": 19200, "timeout_s": TIMEOUT_S})
    assert isinstance(bus, ModbusBus)
    try:
        with slave("rtu", far_path):
            if echoes:
                _echo(far_path)
            await bus.connect()
            yield bus
            await bus.close()
    finally:
        await near.stop()
        await far.stop()


def _echo(path: str) -> None:
    """libmodbus, which has opened the terminal, has switched this off."""
    terminal = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        flags = termios.tcgetattr(terminal)
        flags[3] = (flags[3] | termios.ECHO) & ~termios.ECHOCTL
        termios.tcsetattr(terminal, termios.TCSANOW, flags)
    finally:
        os.close(terminal)
