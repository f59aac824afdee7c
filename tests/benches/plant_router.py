"""The plant's router of `deploy/zenoh`, with the rules that stand there, on loopback."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import zenoh

from tests.benches.free_port import free_port
from tests.benches.plant_authority import DAY, PlantAuthority

ROUTER = Path(__file__).parents[2] / "deploy" / "zenoh" / "router.json5"


@contextmanager
def plant_router(plant: PlantAuthority, lasts: timedelta = 90 * DAY, begins: timedelta = -30 * DAY) -> Iterator[str]:
    """As the text stands there, but for its files and its address, which it yields. lasts, begins: its certificate"""
    text, where = ROUTER.read_text(encoding="utf-8"), f"tls/127.0.0.1:{free_port()}"
    certificate, key = plant.issue(f"router of {where[-5:]}", lasts, begins)
    for old, new in (
        ("tls/0.0.0.0:7447", where),
        ("/etc/zenoh/authority.pem", str(plant.path)),
        ("/etc/zenoh/router.pem", str(certificate)),
        ("/etc/zenoh/router.key", str(key)),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    with zenoh.open(zenoh.Config.from_json5(text)):
        yield where
