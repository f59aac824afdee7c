"""Third-party servers from Debian that accept line protocol: InfluxDB 1 and VictoriaMetrics, on loopback."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlencode
from urllib.request import Request, urlopen

from tests.benches.foreign_server import foreign_server
from tests.benches.free_port import free_port

LIMIT_S = 120.0


def asked(url: str, data: bytes | None = None) -> str:
    """What a server answers."""
    with urlopen(Request(url, data), timeout=LIMIT_S) as answer:
        return str(answer.read().decode())


class InfluxDb1:
    """A database `talc` of an InfluxDB 1."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.ask("CREATE DATABASE talc")

    def ask(self, query: str) -> list[dict[str, object]]:
        """The rows of an InfluxQL query."""
        text = asked(f"{self.url}/query", urlencode({"db": "talc", "epoch": "ns", "q": query}).encode())
        rows = []
        for series in json.loads(text)["results"][0].get("series", []):
            rows += [dict(zip(series["columns"], values, strict=True)) for values in series["values"]]
        return rows


@contextmanager
def influxdb1(folder: Path) -> Iterator[InfluxDb1]:
    """An InfluxDB 1 with an empty database `talc`."""
    port = free_port()
    settings = {
        "INFLUXDB_HTTP_BIND_ADDRESS": f"127.0.0.1:{port}",
        "INFLUXDB_BIND_ADDRESS": f"127.0.0.1:{free_port()}",
        "INFLUXDB_META_DIR": str(folder / "meta"),
        "INFLUXDB_DATA_DIR": str(folder / "data"),
        "INFLUXDB_DATA_WAL_DIR": str(folder / "wal"),
        "INFLUXDB_HTTP_LOG_ENABLED": "false",
        "INFLUXDB_REPORTING_DISABLED": "true",
    }
    with foreign_server(["influxd", "-config", os.devnull], port, folder / "influxd.log", settings):
        yield InfluxDb1(f"http://127.0.0.1:{port}")


@contextmanager
def victoria_metrics(folder: Path) -> Iterator[str]:
    """The address of a VictoriaMetrics, which takes what is meant for a bucket of InfluxDB 2."""
    place = f"127.0.0.1:{(port := free_port())}"
    command = ["victoria-metrics", f"-httpListenAddr={place}", f"-storageDataPath={folder / 'victoria'}",
               "-retentionPeriod=100y"]  # fmt: skip
    with foreign_server(command, port, folder / "victoria.log"):
        yield f"http://{place}"
