"""What a browser is sent: what has changed, and the newest messages of a full queue."""

import asyncio
import json
from contextlib import aclosing
from html.parser import HTMLParser

import pytest
from starlette.testclient import TestClient

from drivers.base import Quality
from gateway.listeners.web.app import build_app
from gateway.listeners.web.at_tool import WorkPoint
from gateway.listeners.web.settings import WebSettings
from gateway.listeners.web.streams import MOST_BROWSERS, Browser, BrowserQueue, Streams
from gateway.listeners.web.verdict import Viewpoint
from gateway.telemetry.codec import encode
from gateway.telemetry.messages import EventMessage, Published, ReadingMessage
from gateway.telemetry.subscriber.site import SiteSeen
from tests.benches.heard import BEGAN, HeardMachine
from tests.benches.mill_page import mill_seen

LOOKING = Viewpoint(WorkPoint(120.0, 0.0, 80.0).matrix(0.12), 10.0)
LIMIT_S = 60.0


def event(n: int, text: str = "bus rtu1: no answer") -> bytes:
    return encode(EventMessage("b", n, BEGAN.isoformat(), "system", None, "problem", text, None, None, None))


def reading(channel: str) -> bytes:
    now = BEGAN.isoformat()
    return encode(ReadingMessage("b", 1, now, "system", channel, 20.0, "degC", Quality.GOOD, now, 0.0, 1, ""))


def kind_of(message: bytes) -> str:
    return message.partition(b"\n")[0].removeprefix(b"event: ").decode()


async def test_a_full_queue_drops_the_oldest() -> None:
    queue = BrowserQueue(3)
    assert [queue.put(b"%d" % i) for i in range(5)] == [False, False, False, True, True]
    assert [await queue.take() for _ in range(3)] == [b"2", b"3", b"4"]


async def test_what_has_not_changed_is_not_sent_again_unless_something_was_dropped() -> None:
    browser = Browser("mill", lambda _: LOOKING, BrowserQueue(2))
    browser.send("view", 1)
    browser.send("view", 1)
    browser.send("events", ())
    assert [kind_of(await browser.queue.take()) for _ in range(2)] == ["view", "events"]
    for value in (2, 3, 4):  # nobody takes them
        browser.send("view", value)
    browser.send("events", ())
    left = [await browser.queue.take() for _ in range(2)]
    assert [kind_of(message) for message in left] == ["view", "events"]
    assert left[0].endswith(b"data: 4\n\n")


async def test_an_open_page_gets_the_whole_state_and_then_each_change() -> None:
    heard = mill_seen()
    streams = Streams(heard)
    sending = asyncio.create_task(streams.run())
    found: list[str] = []
    try:
        async with asyncio.timeout(LIMIT_S), aclosing(streams.messages(Browser("mill", lambda _: LOOKING))) as messages:
            async for message in messages:
                found.append(kind_of(message))
                if found == ["tick", "view", "events", "course"]:
                    heard.life("talc/mill/alive", alive=True)
                    heard.take("talc/mill/event", event(1, "</script>\n\ndata: forged"))
                if message.startswith(b"event: events") and b"forged" in message:
                    break
    finally:
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
    assert message.count(b"\n") == 3, "no foreign text ends a message"
    (shown,) = json.loads(message.partition(b"data: ")[2])
    assert shown["said"]["values"]["text"]["s"] == "</script>\n\ndata: forged"


class OnSite(HeardMachine):
    """Its messages go to a site."""

    def __init__(self, heard: SiteSeen) -> None:
        super().__init__()
        self._site = heard

    def hear(self, suffix: str, message: Published) -> None:
        self._site.take(f"talc/mill/{suffix}", encode(message))


async def test_when_the_gateway_goes_its_forecast_leaves_the_charts() -> None:
    heard = mill_seen()
    heard.life("talc/mill/alive", alive=True)
    machine = OnSite(heard)
    machine.compensation()
    machine.decision()
    machine.forecast({"EZ0A": (1.0, 2.0, 3.0)})
    streams = Streams(heard)
    sending = asyncio.create_task(streams.run())
    charts: list[dict[str, list[float]]] = []
    try:
        async with asyncio.timeout(LIMIT_S), aclosing(streams.messages(Browser("mill", lambda _: LOOKING))) as messages:
            async for message in messages:
                if kind_of(message) == "course":
                    charts.append(json.loads(message.partition(b"data: ")[2]))
                    heard.life("talc/mill/alive", alive=False)
                if len(charts) == 2:
                    break
    finally:
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
    before, after = charts
    assert (len(before["ahead_t"]), after["ahead_t"]) == (4, [])
    assert before["t"] == after["t"]


async def test_when_nothing_more_can_be_sent_open_pages_lose_their_connection() -> None:
    """Otherwise they would show the last state without end as the present one."""
    times = [0.0, 0.0]

    def now_s() -> float:
        return times.pop()

    heard = SiteSeen("talc", ("mill",), lambda: BEGAN, now_s)
    streams = Streams(heard)
    sending = asyncio.create_task(streams.run())
    async with asyncio.timeout(LIMIT_S), aclosing(streams.messages(Browser("mill", lambda _: LOOKING))) as messages:
        async for message in messages:
            if message.startswith(b"event: view"):
                heard.life("talc/mill/alive", alive=True)
    (error,) = await asyncio.gather(sending, return_exceptions=True)
    assert isinstance(error, IndexError)


async def test_a_machine_that_is_not_heard_of_yet_has_a_page_that_says_so() -> None:
    """A panel starts before its gateway does."""
    async with (
        asyncio.timeout(LIMIT_S),
        aclosing(Streams(mill_seen()).messages(Browser("lathe", lambda _: LOOKING))) as sent,
    ):
        await anext(sent)
        shown = json.loads((await anext(sent)).partition(b"data: ")[2])
    assert (shown["machine"], shown["verdict"]["word"]) == ("lathe", "word.never")


def page_of(heard: SiteSeen) -> TestClient:
    return TestClient(build_app(heard, WebSettings()), base_url="http://localhost")


class FirstState(HTMLParser):
    """The state that a page brings with it, as a browser finds it."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self._within, self.text, self.scripts = False, "", 0
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"
        self._within = tag == "script" and ("id", "first") in attrs

    def handle_data(self, data: str) -> None:
        self.text += data if self._within else ""


@pytest.mark.parametrize("name", ["</script><script>alert(1)</script>", "<!--<script>", "a&lt;b"])
def test_the_page_brings_the_state_with_it_and_what_others_name_stays_a_name(name: str) -> None:
    heard = mill_seen()
    heard.life("talc/mill/alive", alive=True)
    heard.take("talc/mill/reading/forged", reading(name))
    heard.take("talc/mill/event", event(2, name))
    found = FirstState(page_of(heard).get("/machine/mill").text)
    first = json.loads(found.text)
    assert list(first) == ["tick", "view", "events", "course"]
    assert first["tick"] == BEGAN.timestamp() * 1e3
    assert [c["channel"] for c in first["view"]["channels"]] == [name]
    assert first["events"][0]["said"]["values"]["text"]["s"] == name
    assert found.scripts == 4


def test_the_corrections_follow_by_the_stream() -> None:
    heard = mill_seen()
    heard.life("talc/mill/alive", alive=True)
    machine = OnSite(heard)
    machine.decision()
    machine.reasons()
    with heard.machines() as machines:
        assert machines["mill"].explanations == 1
    assert "corrections" not in json.loads(FirstState(page_of(heard).get("/machine/mill").text).text)


def test_a_page_that_is_one_too_many_brings_no_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would look as if the page went on from there."""
    monkeypatch.setattr("gateway.listeners.web.streams.MOST_BROWSERS", 0)
    assert FirstState(page_of(mill_seen()).get("/machine/mill").text).text == ""


def test_the_list_brings_its_machines() -> None:
    first = json.loads(FirstState(page_of(mill_seen()).get("/?all=1").text).text)
    assert [(m["machine"], m["word"]) for m in first["list"]] == [("mill", "word.never")]


async def test_a_page_that_was_closed_is_no_longer_served() -> None:
    streams = Streams(mill_seen())
    open_pages = []
    for _ in range(MOST_BROWSERS):
        messages = streams.messages(Browser(None, lambda _: LOOKING))
        await anext(messages)
        open_pages.append(messages)
    full = [streams.full]
    await open_pages.pop().aclose()
    full.append(streams.full)
    assert full == [True, False]
    for messages in open_pages:
        await messages.aclose()
