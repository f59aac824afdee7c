"""The report of a day: as the gateway made it, in a page that can do nothing."""

import gzip
from collections.abc import Callable
from datetime import date

import pytest

from gateway.telemetry.answers import ReportPage
from tests.benches.mill_page import mill_page

HTML = b"<!doctype html><title>mill</title><script>1</script>"


class Reporting:
    """A stand-in for the session with a gateway."""

    def __init__(self, answer: Callable[[], bytes]) -> None:
        self.answer, self.asked = answer, list[tuple[str, date, str, str, float | None]]()

    def ask(self, *_: object) -> None:
        raise AssertionError("nobody asks for a course")

    def ask_with_temperatures(self, *_: object) -> None:
        raise AssertionError("nobody asks for a course")

    ask_with_inputs = ask_scenario = ask_with_temperatures

    def ask_reasons(self, *_: object) -> None:
        raise AssertionError("nobody asks for reasons")

    def ask_report(self, machine: str, day: date, zone: str, language: str, tolerance_um: float | None) -> ReportPage:
        self.asked.append((machine, day, zone, language, tolerance_um))
        return ReportPage(day.isoformat(), zone, self.answer())

    def give(self, *_: object) -> None:
        raise AssertionError("nobody gives a command")


def test_it_is_passed_on_in_a_sandbox_that_loads_nothing() -> None:
    source = Reporting(lambda: gzip.compress(HTML))
    answer = mill_page(source).get(
        "/machine/mill/report/2026-03-02", params={"zone": "Europe/Zurich", "lang": "de", "tolerance": "8"}
    )
    assert (answer.status_code, answer.content) == (200, HTML)
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    policy = answer.headers["content-security-policy"].split("; ")
    assert policy[0] == "sandbox allow-scripts", "not of this page's origin"
    assert {"default-src 'none'", "form-action 'none'", "frame-ancestors 'none'"} < set(policy)
    assert "connect-src" not in answer.headers["content-security-policy"]
    assert source.asked == [("mill", date(2026, 3, 2), "Europe/Zurich", "de", 8.0)]


@pytest.mark.parametrize(
    "address",
    [
        "/machine/mill/report/today",
        "/machine/mill/report/2026-02-30",
        "/machine/a%20b/report/2026-03-02",
        "/machine/mill/report/2026-03-02?zone=Europe;day=2026-01-01",
        "/machine/mill/report/2026-03-02?zone=" + "a" * 65,
        "/machine/mill/report/2026-03-02?tolerance=0",
    ],
)
def test_an_invalid_day_machine_zone_or_tolerance_is_not_asked_for(address: str) -> None:
    source = Reporting(lambda: gzip.compress(HTML))
    assert mill_page(source).get(address).status_code == 404
    assert source.asked == []


def refused() -> bytes:
    raise OSError("report: <b>matplotlib</b> not installed")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (refused, "report: <b>matplotlib</b> not installed"),
        (lambda: HTML, "the answer is not a page"),
        (lambda: gzip.compress(HTML)[:-9], "the answer is not a page"),
        (lambda: gzip.compress(HTML)[:10] + b"\xff" * 20, "the answer is not a page"),
        (lambda: gzip.compress(bytes(4_000_001)), "the page has more than 4 MB"),
    ],
)
def test_a_gateway_that_cannot_make_it_is_reported_as_text(answer: Callable[[], bytes], said: str) -> None:
    found = mill_page(Reporting(answer)).get("/machine/mill/report/2026-03-02")
    assert (found.status_code, found.headers["content-type"]) == (503, "text/plain; charset=utf-8")
    assert found.text.startswith("There is no report of 2026-03-02 from mill: ")
    assert said in found.text


def test_without_a_connection_there_is_no_report_and_nothing_can_be_sent() -> None:
    assert mill_page(None).get("/machine/mill/report/2026-03-02").status_code == 503
    assert mill_page(Reporting(refused)).post("/machine/mill/report/2026-03-02").status_code == 405
