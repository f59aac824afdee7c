"""A test's sessions beside a gateway: they find others only by the address that is given."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import zenoh


def client(port: int) -> zenoh.Session:
    """Connects to a publisher on this computer."""
    return _session({"mode": "client", "connect/endpoints": [f"tcp/127.0.0.1:{port}"]})


def listening(port: int) -> zenoh.Session:
    """Waits on this computer for a publisher that connects to it."""
    return _session({"listen/endpoints": [f"tcp/127.0.0.1:{port}"]})


def _session(settings: Mapping[str, object]) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in {**settings, "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


@contextmanager
def router(port: int, mode: str = "tcp", **more: object) -> Iterator[str]:
    """A router, and the endpoint that it listens on. more: of its configuration, with `__` for `/`"""
    where = f"{mode}/127.0.0.1:{port}"
    settings = {"mode": "router", "listen/endpoints": [where]}
    session = _session(settings | {key.replace("__", "/"): value for key, value in more.items()})
    try:
        yield where
    finally:
        session.close()
