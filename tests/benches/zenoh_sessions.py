"""A test's sessions beside a gateway: they find others only by the address that is given."""

import json
from collections.abc import Mapping

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
