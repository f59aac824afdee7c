"""Figures for Prometheus: their names and values as Prometheus reads them, where they are served, and the dashboard."""

import asyncio
import json
import math
import re
import socket
import ssl
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import pytest
from prometheus_client import CollectorRegistry, Metric, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from drivers.base import Quality
from gateway.config.applied import ConfigurationApplied
from gateway.config.file import parse
from gateway.config.metrics import Metrics
from gateway.config.problems import ConfigError
from gateway.config.telemetry import TelemetryTls
from gateway.model.control_state import NcState
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    Health,
    HealthChecked,
    MeasurementEnded,
    ReadingsTaken,
    StoreHealth,
)
from gateway.model.sample import Sample
from gateway.model.text import plain
from gateway.service.metrics import GatewayFigures, MetricsError, MetricsServer
from gateway.service.serving import serve
from tests.benches import telemetry_examples as example
from tests.benches.free_port import free_port
from tests.benches.plant_authority import PlantAuthority
from tests.benches.service_file import TEXT, UNPUBLISHED, m7015, rtu_bus
from tests.benches.stepped_clock import SteppedClock

DASHBOARD = Path(__file__).parents[3] / "deploy" / "grafana" / "talc-gateway.json"
ROW = re.compile(r"^\| (`talc_[^|]*) \| ([^|]*)\|", re.MULTILINE)
LIMIT_S = 60.0
NO_TLS = TelemetryTls()


def whole() -> GatewayFigures:
    """Metrics of a gateway in which everything has happened once."""
    figures = GatewayFigures("mill", "0.1.0")
    figures.take(ReadingsTaken([example.READING, example.BAD_READING]))
    figures.take(DecisionMade(example.DECISION))
    figures.take(CompensationStepped(example.WRITE))
    figures.take(MeasurementEnded(example.OUTCOME))
    figures.take(MeasurementEnded(example.REFUSED))
    figures.take(EventReported(example.PROBLEM, None))
    store = StoreHealth(plain("disk is full"), 5.0, 40, 3, 900.0)
    figures.take(HealthChecked(Health(60.0, 30, 29, NcState.STALE, True, (plain("an operator"),), store)))
    return figures


def served(figures: GatewayFigures) -> Iterator[Metric]:
    """The text that Prometheus reads."""
    registry = CollectorRegistry()
    registry.register(figures)
    yield from text_string_to_metric_families(generate_latest(registry).decode())


def values(figures: GatewayFigures) -> dict[str, float]:
    """By name and labels."""
    found = {}
    for family in served(figures):
        for sample in family.samples:
            labels = ",".join(f"{name}={value}" for name, value in sorted(sample.labels.items()))
            found[f"{sample.name}{{{labels}}}" if labels else sample.name] = sample.value
    return found


def test_each_figure_is_served_with_its_value() -> None:
    found = values(whole())
    expected = {
        "talc_build{machine=mill,version=0.1.0}": 1.0,
        "talc_uptime_seconds": 60.0,
        "talc_channels": 30.0,
        "talc_channels_good": 29.0,
        "talc_waits_for": 1.0,
        "talc_clock_synchronised": 1.0,
        "talc_nc{talc_nc=stale}": 1.0,
        "talc_nc{talc_nc=ready}": 0.0,
        "talc_phase{talc_phase=compensation}": 1.0,
        "talc_store_failing": 1.0,
        "talc_store_waiting_rows": 40.0,
        "talc_store_dropped_rows_total": 3.0,
        "talc_store_free_bytes": 900e6,
        "talc_reading{channel=bed_front,unit=degC}": 20.0,
        "talc_reading_good{channel=bed_front}": 1.0,
        "talc_reading_good{channel=Öl}": 0.0,
        "talc_error_predicted{error=EY0A}": 1.5,
        "talc_error_corrected{error=EC0C}": 1.5,
        "talc_error_sigma{error=EC0C}": 4.25,
        "talc_offset_um{axis=X}": 1.0,
        "talc_measurements_total{result=used}": 1.0,
        "talc_measurements_total{result=rejected}": 1.0,
        "talc_events_total{kind=problem}": 1.0,
        "talc_readings_total": 2.0,
        "talc_decisions_total": 1.0,
    }
    assert {name: found.get(name) for name in expected} == expected
    assert "talc_reading{channel=Öl,unit=degC}" not in found, "it has no good value"
    assert "talc_error_predicted{error=EY0C}" not in found, "it is not a number"
    assert all(math.isfinite(value) for value in found.values())


def test_what_has_not_happened_yet_is_not_served_as_zero() -> None:
    found = values(GatewayFigures("mill", "0.1.0"))
    assert found["talc_readings_total"] == 0.0
    assert not [name for name in found if name.startswith(("talc_reading{", "talc_error", "talc_phase", "talc_store"))]


def test_a_channel_that_a_reload_removes_is_gone() -> None:
    config = parse(UNPUBLISHED + rtu_bus() + m7015(), Path("gateway.toml"))
    figures = whole()
    figures.take(ReadingsTaken([Sample("bed_rear", 20.0, "degC", Quality.GOOD, example.NOW, 0.0, sequence=1)]))
    figures.take(ConfigurationApplied(config))
    assert [name for name in values(figures) if name.startswith("talc_reading_good")] == [
        "talc_reading_good{channel=bed_front}"
    ]


def test_the_dashboard_names_only_figures_and_labels_that_are_served() -> None:
    dashboard = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    labels: dict[str, set[str]] = {}
    for family in served(whole()):
        for sample in family.samples:
            labels.setdefault(sample.name, {"instance"}).update(sample.labels)
    variable = next(v for v in dashboard["templating"]["list"] if v["name"] == "instance")
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    legends = [target["legendFormat"] for panel in dashboard["panels"] for target in panel["targets"]]
    assert len(expressions) > 20
    for expression, legend in zip(expressions, legends, strict=True):
        ((name, matchers),) = re.findall(r"(talc_\w+)\{(.*?)\}", expression)
        used = {*re.findall(r"(\w+)=", matchers.replace("=~", "=")), *re.findall(r"\{\{(\w+)\}\}", legend)}
        assert name in labels, expression
        assert used <= labels[name], expression
    assert re.findall(r"talc_\w+", variable["definition"]) == ["talc_build"]
    assert variable["query"]["query"] == variable["definition"]
    places = [tuple(panel["gridPos"].values()) for panel in dashboard["panels"]]
    assert len({(x, y) for x, y, _, _ in places}) == len(places)
    assert all(x + w <= 24 for x, _, w, _ in places)


def test_a_port_in_use_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(MetricsError, match=f"listen = '{listen}': Address already in use"):
            MetricsServer(Metrics(listen=listen), NO_TLS, whole()).__enter__()


def test_by_tls_prometheus_shows_its_certificate(tmp_path: Path) -> None:
    authority, port = PlantAuthority(tmp_path / "plant"), free_port()
    certificate, key = authority.issue("mill")
    tls = TelemetryTls(certificate=certificate, key=key, authority=authority.path, mutual=True)
    where = f"https://127.0.0.1:{port}/metrics"
    context = ssl.create_default_context(cafile=str(authority.path))
    with MetricsServer(Metrics(listen=f"127.0.0.1:{port}", tls=True), tls, whole()):
        with (
            pytest.raises(OSError),
            urlopen(where, timeout=LIMIT_S, context=context) as answer,
        ):
            answer.read()
        context.load_cert_chain(*authority.issue("prometheus"))
        with urlopen(where, timeout=LIMIT_S, context=context) as answer:
            assert b"talc_channels_good 29.0" in answer.read()


@pytest.mark.parametrize(
    ("metrics", "said"),
    [
        ('listen = "9464"', r"[metrics] listen: '9464': expected HOST:PORT such as 127.0.0.1:9464"),
        ('listen = "0.0.0.0:9464"', "[metrics] listen: '0.0.0.0:9464' can be read by everyone in that network"),
        ('listen = "127.0.0.1:9464"\ntls = true', "[metrics] tls: true, but there is no [telemetry.tls] certificate"),
    ],
)
def test_an_impossible_or_open_address_is_refused(metrics: str, said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        parse(f"{TEXT}\n[metrics]\n{metrics}\n", Path("gateway.toml"))
    open_to_all = '[metrics]\nlisten = "0.0.0.0:9464"\nallow_unencrypted = true\n'
    assert parse(f"{TEXT}\n{open_to_all}", Path("gateway.toml")).metrics.allow_unencrypted


def test_the_page_lists_every_figure_and_its_labels() -> None:
    page = (Path(__file__).parents[3] / "docs" / "metrics.md").read_text(encoding="utf-8")
    rows = [(re.findall(r"`(talc_\w+)`", a), {*re.findall(r"`(\w+)`", b)}) for a, b in re.findall(ROW, page)]
    listed = {name: labels for names, labels in rows for name in names}
    assert listed == {sample.name: set(sample.labels) for family in served(whole()) for sample in family.samples}


async def test_a_gateway_that_is_configured_to_serves_them_and_stops_with_them(tmp_path: Path) -> None:
    port, stop, texts = free_port(), asyncio.Event(), list[str]()
    text = f'{UNPUBLISHED}[metrics]\nlisten = "127.0.0.1:{port}"\n' + rtu_bus() + m7015()
    config = parse(text, tmp_path / "gateway.toml")

    def read() -> str:
        with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=LIMIT_S) as answer:
            return str(answer.read().decode())

    async def ask() -> None:
        try:
            async with asyncio.timeout(LIMIT_S):
                while "talc_channels 1.0" not in (text := await asyncio.to_thread(read)):
                    await asyncio.sleep(0)
            texts.append(text)
        finally:
            stop.set()

    asking: list[asyncio.Task[None]] = []
    await serve(
        config, SteppedClock(), stop, simulated=False, started=lambda _: asking.append(asyncio.create_task(ask()))
    )
    await asking[0]
    assert 'talc_build{machine="mill"' in texts[0]
    with pytest.raises(OSError, match="refused"):
        await asyncio.to_thread(read)
