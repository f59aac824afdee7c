"""A program that ends with code 7 while a callback of its session works: `… PORT closed|forgotten`."""

import sys
import threading
import time

import zenoh

from gateway.config.telemetry import Telemetry
from gateway.telemetry.kept import Kept, KeptSession
from gateway.telemetry.session import own_access, reader_config

_WORKS_S = 0.5


def _end(port: str, how: str) -> None:
    heard, declared = threading.Event(), threading.Event()
    telemetry = Telemetry(listen=(), connect=(f"tcp/127.0.0.1:{port}",))

    def take(_: zenoh.Sample) -> None:
        heard.set()
        end_s = time.monotonic() + _WORKS_S
        while time.monotonic() < end_s:  # needs the interpreter, also while that ends
            pass

    def opened(session: zenoh.Session) -> None:
        session.declare_subscriber("talc/**", take)
        declared.set()

    kept = KeptSession(
        Kept(lambda: reader_config(telemetry.connect, own_access(telemetry)), None, telemetry.connect), opened
    )
    kept.start()
    declared.wait(10.0)
    print("hears", flush=True)
    heard.wait(10.0)
    if how == "closed":
        kept.close()
    sys.exit(7)


if __name__ == "__main__":
    _end(*sys.argv[1:])
