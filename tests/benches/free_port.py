"""Ports of this computer that no other program takes between the choice and the use."""

import fcntl
import os
import random
import socket
import tempfile
from functools import cache
from pathlib import Path

_FEWEST = 2000
_taken: set[int] = set()


def free_port() -> int:
    """A port, TCP and UDP, that nobody uses; each call gives another one.

    The kernel assigns none of these ports to a program that asks for any port. A lock keeps this user's other test
    processes away until this one ends. Raises OSError when no port is free.
    """
    for port in random.SystemRandom().sample(_ports(), _FEWEST):
        if port in _taken:
            continue
        try:
            fcntl.lockf(_locks(), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, port)
        except OSError:  # another test process has it
            continue
        _taken.add(port)
        if _is_free(port, socket.SOCK_STREAM) and _is_free(port, socket.SOCK_DGRAM):
            return port
    raise OSError("no port is free")


@cache
def _locks() -> int:
    """A file in which a byte stands for each port; closing it would give up all locks."""
    return os.open(Path(tempfile.gettempdir()) / f"talc-gateway-ports-{os.getuid()}", os.O_RDWR | os.O_CREAT, 0o600)


@cache
def _ports() -> range:
    """The ports that the kernel does not assign by itself; all ports where it may assign nearly every one."""
    first, last = map(int, Path("/proc/sys/net/ipv4/ip_local_port_range").read_text(encoding="ascii").split())
    outside = max(range(10_000, first), range(last + 1, 65_536), key=len)
    return outside if len(outside) >= _FEWEST else range(10_000, 65_536)


def _is_free(port: int, kind: socket.SocketKind) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as servers do
        try:
            probe.bind(("", port))
        except OSError:
            return False
    return True
