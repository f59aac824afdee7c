"""Runs in the guest under a copy of the service's unit: tries what the unit forbids, and reports as JSON what
happened."""

import ctypes
import errno
import json
import os
import socket
from collections.abc import Callable
from pathlib import Path

PUBLIC = ("203.0.113.1", 9)
"""A public address (RFC 5737) that the guest's own loopback has here, so nothing but the unit keeps it away."""


def _called(result: int) -> None:
    if result < 0:
        raise OSError(ctypes.get_errno(), "")


def _send(address: tuple[str, int]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.sendto(b"x", address)


def main() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    own, new_namespace = Path("/var/lib/talc-gateway/probe"), 0x10000000  # CLONE_NEWUSER
    tries: dict[str, Callable[[], object]] = {
        "write to its own folder": lambda: own.write_text("x"),
        "write to /opt/talc-gateway": lambda: Path("/opt/talc-gateway/version").open("a").close(),
        "write to /etc/talc-gateway": lambda: Path("/etc/talc-gateway/gateway.toml").open("a").close(),
        "read /root": lambda: list(Path("/root").iterdir()),
        "read its credential": lambda: (Path(os.environ.get("CREDENTIALS_DIRECTORY", "/")) / "nc-password").read_text(),
        "read the credential's file": lambda: Path("/etc/talc-gateway/secrets/nc-password").read_text(),
        "ask the kernel for the clock": lambda: _called(libc.adjtimex(ctypes.create_string_buffer(512))),
        "open a device that is not listed": lambda: os.close(os.open("/dev/unlisted", os.O_RDWR)),
        "open a raw socket": lambda: socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_ICMP).close(),
        "open a packet socket": lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW).close(),
        "send to its own computer": lambda: _send(("127.0.0.1", 9)),
        "send to a public address": lambda: _send(PUBLIC),
        "give a file away": lambda: os.chown(own, 0, 0),
        "make a file set-user-ID": lambda: own.chmod(0o4755),
        "make a namespace": lambda: _called(libc.unshare(new_namespace)),
    }
    found = {}
    for what, attempt in tries.items():
        try:
            attempt()
        except OSError as error:
            found[what] = errno.errorcode[error.errno or 0]
        else:
            found[what] = "done"
    print(json.dumps(found))


if __name__ == "__main__":
    main()
