"""What the log says at the start of where a gateway can be reached."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from gateway.cli.opening import opening
from gateway.config import GatewayConfig, validate


def with_metrics(metrics: Mapping[str, object], telemetry: Mapping[str, object] | None = None) -> GatewayConfig:
    return validate({"machine": {"name": "mill"}, "metrics": metrics, "telemetry": telemetry or {"enabled": False}})


@pytest.mark.parametrize("place", ["127.0.0.1:9464", "[::1]:9464"])
def test_it_says_where_the_metrics_are_read(place: str) -> None:
    assert f"metrics: http://{place}/metrics" in list(opening(with_metrics({"listen": place})))


def test_it_says_that_they_are_read_by_tls(tmp_path: Path) -> None:
    for name in ("mill.pem", "mill.key"):
        (tmp_path / name).write_text("", encoding="utf-8")
    tls = {"tls": {"certificate": str(tmp_path / "mill.pem"), "key": str(tmp_path / "mill.key")}}
    lines = list(opening(with_metrics({"listen": "0.0.0.0:9464", "tls": True}, tls)))
    assert "metrics: https://0.0.0.0:9464/metrics" in lines


def test_without_metrics_it_says_nothing_of_them() -> None:
    assert [line for line in opening(with_metrics({})) if line.startswith("metrics")] == []
