"""What the log says at the start: what a gateway has, where it can be reached, and what is not armed."""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.service.opening import opening

MILL: dict[str, Any] = {
    "machine": {"name": "mill"},
    "bus": [
        {"name": "rtu1", "kind": "modbus_rtu", "port": "/dev/serial/by-id/one", "period_s": 2.0},
        {"name": "tcp1", "kind": "modbus_tcp", "host": "10.0.0.7"},
    ],
    "device": [
        {"name": "rtd1", "bus": "rtu1", "profile": "icpdas_m7015", "channels": {"bed": 0, "column": 1}},
        {"name": "rtd2", "bus": "rtu1", "unit": 2, "profile": "icpdas_m7015", "channels": {"room": 0}},
        {"name": "adam", "bus": "tcp1", "profile": "adam6015", "channels": {"oil": 0}},
    ],
    "nc": {"kind": "sinumerik", "url": "opc.tcp://10.0.0.9:4840", "security": "none"},
    "storage": {"path": "/data/mill.sqlite"},
    "telemetry": {"listen": ["tcp/127.0.0.1:7447"], "connect": ["tcp/10.0.0.8:7447"], "prefix": "hall"},
}


def test_it_says_version_buses_channels_control_mode_store_and_endpoints() -> None:
    config = validate(MILL)
    lines = list(opening(config))
    assert lines[:5] == [
        f"talc-gateway {version('talc-gateway')} runs machine mill, configuration {config.fingerprint()[:16]}: "
        "2 buses, 3 devices, 4 channels, 0 machine states",
        "bus rtu1: modbus_rtu at /dev/serial/by-id/one, 3 channels every 2 s",
        "bus tcp1: modbus_tcp at 10.0.0.7:502, 1 channel every 1 s",
        "control: sinumerik at opc.tcp://10.0.0.9:4840; compensation monitor, probing not armed",
        "store: /data/mill.sqlite; published as hall/mill/**, listening on tcp/127.0.0.1:7447, "
        "connecting to tcp/10.0.0.8:7447",
    ]
    told = [line.partition(":")[0] for line in lines[5:]]
    assert told == ["nothing will be learnt", "nothing is written to the control"]


def test_a_gateway_that_nobody_can_reach_says_so() -> None:
    telemetry = {**MILL["telemetry"], "listen": [], "connect": []}
    assert any(line.endswith("no endpoint") for line in opening(validate({**MILL, "telemetry": telemetry})))


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
