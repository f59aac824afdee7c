"""Figures for Prometheus: their names and values as Prometheus reads them, where they are served, and the dashboard."""

import asyncio
import json
import math
import re
import socket
import ssl
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
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
from gateway.model.commands import Pause
from gateway.model.connection import Connection
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
from talc.names import THERMAL_ERRORS
from tests.benches import telemetry_examples as example
from tests.benches.free_port import free_port
from tests.benches.plant_authority import PlantAuthority
from tests.benches.service_file import TEXT, UNPUBLISHED, m7015, rtu_bus
from tests.benches.stepped_clock import SteppedClock

DEPLOY = Path(__file__).parents[3] / "deploy"
RULES = DEPLOY / "prometheus" / "talc-gateway.rules.yml"
LIMIT_S = 60.0


NO_TLS = TelemetryTls()


@pytest.fixture(scope="module")
def applied(tmp_path_factory: pytest.TempPathFactory) -> ConfigurationApplied:
    """A configuration that has a certificate."""
    plant = PlantAuthority(tmp_path_factory.mktemp("plant"))
    certificate, key = plant.issue("mill")
    tls = f'[telemetry.tls]\ncertificate = "{certificate}"\nkey = "{key}"\n'
    text = UNPUBLISHED + tls + rtu_bus() + m7015()
    return ConfigurationApplied(parse(text, Path("gateway.toml")))


@pytest.fixture
def whole(applied: ConfigurationApplied) -> GatewayFigures:
    """Metrics of a gateway in which everything has happened once."""
    figures = GatewayFigures("mill", "0.1.0", lambda: example.NOW, lambda: {"front": 4}, lambda: {"readings": 2})
    figures.take(applied)
    figures.take(ReadingsTaken([example.READING, example.BAD_READING]))
    figures.take(DecisionMade(example.DECISION))
    figures.take(CompensationStepped(example.WRITE))
    figures.take(MeasurementEnded(example.OUTCOME))
    figures.take(MeasurementEnded(example.REFUSED))
    figures.take(EventReported(example.PROBLEM, None))
    store = StoreHealth(plain("disk is full"), 5.0, 40, 3, 900.0)
    telemetry = Connection(datetime(2026, 3, 2, tzinfo=UTC), "tls/router:7447", confirmed=True)
    waits = (plain("an operator"),)
    paused = Pause("anna", example.NOW)
    health = Health(60.0, 30, 29, NcState.STALE, True, waits, store, paused, telemetry=telemetry)
    figures.take(HealthChecked(health))
    return figures


def served(figures: GatewayFigures) -> Iterator[Metric]:
    """The text that Prometheus reads."""
    registry = CollectorRegistry()
    registry.register(figures)
    yield from text_string_to_metric_families(generate_latest(registry).decode())


def values(figures: GatewayFigures) -> dict[str, float]:
    """By name and labels without the machine, which all have."""
    found = {}
    for family in served(figures):
        for sample in family.samples:
            labels = {**sample.labels}
            assert labels.pop("machine") == "mill"
            shown = ",".join(f"{name}={value}" for name, value in sorted(labels.items()))
            found[f"{sample.name}{{{shown}}}" if shown else sample.name] = sample.value
    return found


def test_each_figure_is_served_with_its_value(whole: GatewayFigures, applied: ConfigurationApplied) -> None:
    found = values(whole)
    expected = {
        f"talc_build{{configuration={applied.config.fingerprint()[:16]},version=0.1.0}}": 1.0,
        "talc_time_seconds": example.NOW.timestamp(),
        "talc_unarmed": 2.0,
        "talc_paused": 1.0,
        "talc_disarmed": 0.0,
        "talc_periods_missed_total{bus=front}": 4.0,
        "talc_messages_dropped_total{kind=readings}": 2.0,
        "talc_error_limit{error=EC0C}": 5.0,
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


def test_a_channel_that_a_reload_removes_is_gone(whole: GatewayFigures) -> None:
    config = parse(UNPUBLISHED + rtu_bus() + m7015(), Path("gateway.toml"))
    figures = whole
    figures.take(ReadingsTaken([Sample("bed_rear", 20.0, "degC", Quality.GOOD, example.NOW, 0.0, sequence=1)]))
    figures.take(ConfigurationApplied(config))
    assert [name for name in values(figures) if name.startswith("talc_reading_good")] == [
        "talc_reading_good{channel=bed_front}"
    ]


@pytest.mark.parametrize("name", ["talc-gateway", "talc-fleet"])
def test_a_dashboard_names_only_figures_and_labels_that_are_served_or_recorded(
    name: str, whole: GatewayFigures
) -> None:
    dashboard = json.loads((DEPLOY / "grafana" / f"{name}.json").read_text(encoding="utf-8"))
    labels: dict[str, set[str]] = {
        "machine:talc_within_limits": {"machine"},
        "ALERTS": {"machine", "alertname", "alertstate"},
    }
    assert named("record") == {"machine:talc_within_limits"}
    for family in served(whole):
        for sample in family.samples:
            labels.setdefault(sample.name, {"instance"}).update(sample.labels)
    for panel in dashboard["panels"]:
        for target in panel["targets"]:
            found = re.findall(r"((?:machine:)?talc_\w+|ALERTS)\{(.*?)\}", target["expr"])
            assert found, target["expr"]
            for figure, matchers in found:
                used = {*re.findall(r"(\w+)=", matchers.replace("=~", "="))}
                used |= {*re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])}
                assert used <= labels[figure], target["expr"]
    (variable,) = (v for v in dashboard["templating"]["list"] if v["name"] == "machine")
    assert variable["definition"] == variable["query"]["query"] == "label_values(talc_build, machine)"
    places = [tuple(panel["gridPos"].values()) for panel in dashboard["panels"]]
    assert len({(x, y) for x, y, _, _ in places}) == len(places)
    assert all(x + w <= 24 for x, _, w, _ in places)


def named(key: str) -> set[str]:
    """What the shipped rules record, or alert."""
    return {*re.findall(rf"^ *- {key}: (\S+)$", RULES.read_text(encoding="utf-8"), re.MULTILINE)}


CAUSES = {
    "TalcRestarts": {"talc_uptime_seconds": "0+240x186 0 240 0 240 0 240 0 240 0"},
    "TalcNothingDecided": {"talc_decision_grid_index": "7x195"},
    "TalcNoGood": {"talc_phase{talc_phase=no_good}": "1x195"},
    "TalcStoreFailing": {"talc_store_failing": "1x195"},
    "TalcDiskFull": {"talc_store_free_bytes": "1e6x195"},
    "TalcCertificateEnds": {"talc_certificate_ends_seconds{field=[telemetry.tls] certificate}": "2e6x195"},
    "TalcCertificateEndsSoon": {"talc_certificate_ends_seconds{field=[telemetry.tls] certificate}": "4e5x195"},
    "TalcChannelsBad": {"talc_channels_good": "29x195"},
    "TalcPeriodsMissed": {"talc_periods_missed_total{bus=front}": "0+10x195"},
    "TalcDropped": {"talc_messages_dropped_total{kind=readings}": "0x190 0+1x4"},
    "TalcNotPublished": {"talc_telemetry_confirmed": "0x195"},
    "TalcTwoOfOneName": {"talc_two_of_one_name": "1x195"},
    "TalcClockUnsynchronised": {"talc_clock_synchronised": "0x195"},
    "TalcClockOff": {"talc_time_seconds": "10800+240x195"},
    "TalcPaused": {"talc_paused": "1x195"},
    "TalcDisarmed": {"talc_disarmed": "1x195"},
    "TalcUnarmed": {"talc_unarmed": "1x195"},
    "TalcControlAway": {"talc_nc{talc_nc=away}": "1x195"},
    "TalcUncertain": {"talc_error_sigma{error=EC0C}": "4x195"},
}
"""The figure of a gateway that is not well, each four minutes, by the alert that says so."""
WELL = {
    "talc_uptime_seconds": "0+240x195",
    "talc_decision_grid_index": "0+1x195",
    "talc_channels_good": "30x195",
    "talc_time_seconds": "0+240x195",
    "talc_certificate_ends_seconds{field=[telemetry.tls] certificate}": "1e9x195",
    "talc_store_failing": "0x195",
    "talc_paused": "0x195",
    "talc_unarmed": "0x195",
    "talc_nc{talc_nc=stale}": "0x195",
    **{f"talc_error_sigma{{error={error}}}": "1x195" for error in THERMAL_ERRORS},
}
"""What one that is well has instead of the figures of `whole`."""


@pytest.mark.peer
def test_each_alert_is_given_for_its_cause_and_for_nothing_else(whole: GatewayFigures, tmp_path: Path) -> None:
    """By Prometheus's own tool, from the names and labels that the gateway serves: a gateway for each cause."""
    asked = set(re.findall(r"talc_\w+", RULES.read_text(encoding="utf-8")))
    served_now = {name: f"{value:g}x195" for name, value in values(whole).items()} | WELL
    usual = {name: course for name, course in served_now.items() if name.partition("{")[0] in asked}
    series = [{"series": f'up{{job="talc-gateway",instance="{one}"}}', "values": "0x195"} for one in ("gone", "never")]
    series.append({"series": 'talc_build{machine="mill",instance="gone"}', "values": "1x5"})
    for machine, cause in {"well": dict[str, str](), **CAUSES}.items():
        assert cause.keys() <= usual.keys(), machine
        for name, course in {**usual, **cause}.items():
            figure, _, labels = name.rstrip("}").partition("{")
            pairs = [one.partition("=") for one in (f"machine={machine}", *labels.split(",")) if one]
            quoted = ",".join(f'{key}="{value}"' for key, _, value in pairs)
            series.append({"series": f"{figure}{{{quoted}}}", "values": course})
    expected = [("TalcGatewayGone", "mill"), ("TalcGatewayGone", "never"), *((alert, alert) for alert in CAUSES)]
    expected.append(("TalcCertificateEnds", "TalcCertificateEndsSoon"))
    assert {alert for alert, _ in expected} == named("alert")
    firing = {
        "expr": 'count by (alertname, machine) (ALERTS{alertstate="firing"})',
        "eval_time": "780m",
        "exp_samples": [
            {"labels": f'{{alertname="{alert}",machine="{machine}"}}', "value": 1} for alert, machine in expected
        ],
    }
    tests = [{"interval": "4m", "input_series": series, "promql_expr_test": [firing]}]
    file = tmp_path / "tests.yml"
    whole_file = {"rule_files": [str(RULES)], "evaluation_interval": "4m", "tests": tests}
    file.write_text(json.dumps(whole_file), encoding="utf-8")  # JSON is YAML
    done = subprocess.run(["promtool", "test", "rules", file], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_port_in_use_is_named(whole: GatewayFigures) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(MetricsError, match=f"listen = '{listen}'"):
            MetricsServer(Metrics(listen=listen), NO_TLS, whole).__enter__()


def test_by_tls_prometheus_shows_its_certificate(whole: GatewayFigures, tmp_path: Path) -> None:
    authority, port = PlantAuthority(tmp_path / "plant"), free_port()
    certificate, key = authority.issue("mill")
    tls = TelemetryTls(certificate=certificate, key=key, authority=authority.path, mutual=True)
    where = f"https://127.0.0.1:{port}/metrics"
    context = ssl.create_default_context(cafile=str(authority.path))
    with MetricsServer(Metrics(listen=f"127.0.0.1:{port}", tls=True), tls, whole):
        with (
            pytest.raises(OSError),
            urlopen(where, timeout=LIMIT_S, context=context) as answer,
        ):
            answer.read()
        context.load_cert_chain(*authority.issue("prometheus"))
        with urlopen(where, timeout=LIMIT_S, context=context) as answer:
            assert b'talc_channels_good{machine="mill"} 29.0' in answer.read()


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


def test_every_figure_explains_itself_and_names_its_machine(whole: GatewayFigures) -> None:
    families = list(served(whole))
    assert all(family.documentation for family in families)
    assert all("machine" in sample.labels for family in families for sample in family.samples)


async def test_a_gateway_that_is_configured_to_serves_them_and_stops_with_them(tmp_path: Path) -> None:
    port, stop, texts = free_port(), asyncio.Event(), list[str]()
    text = f'{UNPUBLISHED}[metrics]\nlisten = "127.0.0.1:{port}"\n' + rtu_bus() + m7015()
    config = parse(text, tmp_path / "gateway.toml")

    def read() -> str:
        with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=LIMIT_S) as answer:
            return str(answer.read().decode())

    def descriptors() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    async def ask() -> None:
        place = ("127.0.0.1", port)
        try:
            async with asyncio.timeout(LIMIT_S):
                before = descriptors()
                with ExitStack() as stack:
                    for _ in range(200):
                        silent = stack.enter_context(await asyncio.to_thread(socket.create_connection, place))
                        silent.send(b"GET /metrics HTTP/1.1\r\nHo")
                    await asyncio.to_thread(read)
                    assert descriptors() - before < 200 + 40, "so many devices could be reached"
                while 'talc_channels{machine="mill"} 1.0' not in (text := await asyncio.to_thread(read)):
                    await asyncio.sleep(0)
            texts.append(text)
        finally:
            stop.set()

    asking: list[asyncio.Task[None]] = []
    await serve(
        config, SteppedClock(), stop, simulated=False, started=lambda _: asking.append(asyncio.create_task(ask()))
    )
    await asking[0]
    assert f'talc_build{{configuration="{config.fingerprint()[:16]}",machine="mill"' in texts[0]
    with pytest.raises(OSError, match="refused"):
        await asyncio.to_thread(read)
