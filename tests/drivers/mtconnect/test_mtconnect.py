"""The driver of controls with an MTConnect agent, on a third-party agent and on answers that no agent should give."""

import asyncio
import math
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused, SetupError, SystemClock, WrongDevice
from drivers.mtconnect.items import number
from drivers.mtconnect.make import make_mtconnect
from drivers.mtconnect.settings import MtConnectSettings
from drivers.nc import NumericalControl, OperatingMode, ProgramState, WatchdogTerms
from drivers.problems import settings_of
from tests.benches.manual_clock import ManualClock
from tests.benches.mtconnect_agent import mtconnect_agent
from tests.benches.refusals import refusing
from tests.benches.stream_server import http_answer, stream_server

pytestmark = pytest.mark.filterwarnings("ignore:datetime:DeprecationWarning")
LIMIT_S = 60.0
POSITIONS = {axis: f"{axis}pos" for axis in "XYZAC"}
STATES = {"spindle_speed": "Srpm", "speed_X": "Xfrt", "speed_C": "Cfrt", "coolant": "flood"}
NAMED = {"mode": "mode", "program": "exec", "tool": "tool", "emergency_stop": "estop"}
VALUES: Mapping[str, Any] = {
    "Xpos": 100.5, "Ypos": -20.0, "Zpos": 30.0, "Apos": 10.0, "Cpos": 720.0, "Srpm": -6000.0, "Xfrt": 20.0,
    "Cfrt": 36.0, "flood": "ACTIVE", "mode": "AUTOMATIC", "exec": "FEED_HOLD", "tool": "17", "estop": "ARMED",
}  # fmt: skip


def control(url: str, /, **changed: object) -> NumericalControl:
    given: dict[str, object] = {"url": url, "positions": POSITIONS, "states": STATES, "timeout_s": LIMIT_S, **NAMED}
    return make_mtconnect(settings_of(MtConnectSettings, given | changed), SystemClock())


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[tuple[Any, str]]:
    """A third-party agent, which has observed VALUES."""
    with mtconnect_agent(tmp_path) as (it, url):
        for item, value in VALUES.items():
            it.push_data(item, value)
        yield it, url


async def test_the_agent_of_others_is_read_in_the_gateways_units(agent: tuple[Any, str]) -> None:
    nc = control(agent[1], origin_mm=(0.5, 0.0, -10.0))
    await nc.connect()
    it = await nc.snapshot()
    assert it.positions == {"X": 100.0, "Y": -20.0, "Z": 40.0, "A": 10.0, "C": 720.0}
    assert it.states == pytest.approx({"spindle_speed": 6000.0, "speed_X": 1200.0, "speed_C": 6.0, "coolant": 1.0})
    assert (it.mode, it.program, it.tool) == (OperatingMode.AUTO, ProgramState.INTERRUPTED, 17)
    assert (it.ready, it.cannot_probe) == (None, "the control is only read")
    agent[0].push_data("estop", "TRIGGERED")
    agent[0].push_data("tool", "T5-left")
    later = await nc.snapshot()
    assert (later.ready, later.tool) == (False, None)
    await nc.close()


async def test_what_the_agent_no_longer_knows_is_not_reported(agent: tuple[Any, str]) -> None:
    nc = control(agent[1])
    await nc.connect()
    agent[0].push_data("Srpm", "UNAVAILABLE")
    assert "spindle_speed" not in (await nc.snapshot()).states
    agent[0].push_data("Ypos", "UNAVAILABLE")
    with refusing(BadAnswer, "mtc_no_position names=Y"):
        await nc.snapshot()


@pytest.mark.parametrize(
    ("item", "word", "name"),
    [
        ("flood", "MIST", "coolant"),
        ("mode", "THREAD", "mode"),
        ("exec", "IN_CUT", "program"),
        ("estop", "PRESSED", "emergency_stop"),
    ],
)
async def test_a_word_that_is_not_known_costs_only_itself(
    item: str, word: str, name: str, agent: tuple[Any, str]
) -> None:
    nc = control(agent[1])
    await nc.connect()
    before = await nc.snapshot()
    assert before.not_known == {}
    agent[0].push_data(item, word)
    it = await nc.snapshot()
    assert it.positions == before.positions
    assert it.not_known == {name: f"'{word}' (data item {item})"}
    assert it.states == {state: value for state, value in before.states.items() if state != name}
    assert it.mode is (OperatingMode.UNKNOWN if item == "mode" else before.mode)
    assert it.program is (ProgramState.UNKNOWN if item == "exec" else before.program)
    assert it.ready is None


async def test_an_editor_in_use_is_known(agent: tuple[Any, str]) -> None:
    """MTConnect defines the word; the gateway has no such mode."""
    agent[0].push_data("mode", "EDIT")
    nc = control(agent[1])
    await nc.connect()
    it = await nc.snapshot()
    assert (it.mode, it.not_known) == (OperatingMode.UNKNOWN, {})


async def test_it_is_never_written_to(agent: tuple[Any, str]) -> None:
    nc = control(agent[1])
    await nc.connect()
    for question in (nc.claim(7, WatchdogTerms(10.0, 1.0)), nc.heartbeat(7), nc.write_compensation((1.0, 0.0, 0.0))):
        with pytest.raises(Refused, match="the control is only read"):
            await question
    with pytest.raises(Refused, match="the control is only read"):
        await nc.request_probing(1)
    assert await nc.read_compensation() == (0.0, 0.0, 0.0)
    await nc.close()
    with pytest.raises(ConnectError, match="connect first"):
        await nc.snapshot()


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"positions": POSITIONS | {"C": "c1"}}, r"positions\.C = 'c1': the agent has no such data item \(see its"),
        ({"positions": POSITIONS | {"X": "Xwork"}}, r"positions\.X = 'Xwork' is in WORK coordinates"),
        ({"positions": POSITIONS | {"X": "Apos"}}, r"positions\.X = 'Apos' is in DEGREE: expected MILLIMETER"),
        (
            {"states": {"spindle_speed": "Sovr"}},
            r"states\.spindle_speed = 'Sovr' is in PERCENT: expected REVOLUTION/MI",
        ),
        ({"states": {"speed_X": "flood"}}, r"states\.speed_X = 'flood' is in no unit: expected MILLIMETER/SECOND"),
        ({"mode": "exec"}, r"mode = 'exec' is of type EXECUTION: expected CONTROLLER_MODE"),
    ],
)
async def test_a_data_item_that_is_something_else_is_named(
    changed: dict[str, object], says: str, agent: tuple[Any, str]
) -> None:
    with pytest.raises(WrongDevice, match=says):
        await control(agent[1], **changed).connect()


async def test_an_address_or_machine_that_the_server_does_not_have_is_reported(agent: tuple[Any, str]) -> None:
    with pytest.raises(BadAnswer, match=r"probe: HTTP status 404 \(check url and machine\)"):
        await control(agent[1], machine="lathe").connect()


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"url": "https://127.0.0.1:5000"}, "http_url"),
        ({"url": "http://127.0.0.1:99999"}, "http_url"),
        ({"positions": {"X": "Xpos", "Y": "Ypos"}}, "mtconnect_positions"),
        ({"mode": "a b"}, "mtconnect_an_id"),
        ({"machine": "../probe?x"}, "mtconnect_a_machine"),
    ],
)
def test_settings_that_cannot_work_are_refused(changed: dict[str, object], code: str) -> None:
    with pytest.raises(SetupError) as raised:
        control("http://127.0.0.1:5000", **changed)
    assert raised.value.field == tuple(changed)
    assert raised.value.what.says(code)


@asynccontextmanager
async def answering(answer: bytes, *, then_hang_up: bool = True) -> AsyncIterator[str]:
    """A server that answers each connection with these bytes; its address."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(answer)
        if then_hang_up:
            writer.close()

    async with stream_server(serve) as port:
        yield f"http://127.0.0.1:{port}"


ERROR = b'<MTConnectError><Errors><Error errorCode="NO_DEVICE">no device mill2</Error></Errors></MTConnectError>'
BOMB = b'<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><x>&b;</x>'


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (http_answer(ERROR, "404 Not Found"), "probe: HTTP status 404, the agent reports NO_DEVICE: no device mill2"),
        (http_answer(ERROR), "probe: the agent reports NO_DEVICE"),
        (http_answer(BOMB), "probe: it has a document type, which is not accepted"),
        (http_answer(b"<a>" * 60), "more than 50 elements within each other"),
        (http_answer(b"<a>" + b"<b/>" * 1_900_000 + b"</a>"), "probe: more than 100000 elements"),
        (http_answer(b"<a><b></a>"), "it is not XML: mismatched tag"),
        (http_answer(b"\x00\x01"), "it is not XML"),
        (http_answer(b"x" * 8_000_001), "more than 8000000 bytes"),
        (http_answer(b"<html>moved</html>", "302 Found"), "HTTP status 302"),
    ],
)
async def test_what_no_agent_should_answer_is_a_bad_answer(answer: bytes, says: str) -> None:
    async with answering(answer) as url:
        with pytest.raises(BadAnswer, match=says):
            await control(url).connect()


@pytest.mark.realtime
async def test_the_largest_document_does_not_hold_up_what_else_the_gateway_does() -> None:
    """Tolerance: the loop is never held up for more than half of the time that the document takes."""
    largest, longest_s, ended = b"<a>" + b'<b c="1"/>' * 99_000 + b"</a>", 0.0, False

    async def look() -> None:
        nonlocal longest_s
        loop = asyncio.get_running_loop()
        while not ended:
            before_s = loop.time()
            await asyncio.sleep(0.001)
            longest_s = max(longest_s, loop.time() - before_s)

    async with answering(http_answer(largest)) as url:
        looking = asyncio.create_task(look())
        began_s = time.monotonic()
        with pytest.raises(WrongDevice, match="the agent has no such data item"):
            await control(url, timeout_s=60.0).connect()
        took_s = time.monotonic() - began_s
        ended = True
        await looking
    print(f"{took_s:.2f} s, of which at most {longest_s:.3f} s without anything else")
    assert longest_s < took_s / 2, "in the loop's own thread it would be nearly all of it"


CHUNKED = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"


@pytest.mark.parametrize(
    "answer", [b"SSH-2.0-OpenSSH_9.2\r\n", CHUNKED + b"-5\r\n", CHUNKED + b"7fffffffffffffffffff\r\n"]
)
async def test_a_server_that_does_not_speak_http_is_not_a_connection(answer: bytes) -> None:
    async with answering(answer) as url:
        with pytest.raises(ConnectError, match=url):
            await control(url).connect()


@pytest.mark.simulated_time
async def test_an_answer_that_never_ends_is_given_up() -> None:
    async with answering(b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\n<a", then_hang_up=False) as url:
        with pytest.raises(NoAnswer, match=r"no answer to probe within 0\.2 s"):
            await control(url, timeout_s=0.2).connect()


@pytest.mark.simulated_time
async def test_an_agent_that_sends_byte_by_byte_is_hung_up_on() -> None:
    gone = asyncio.Event()

    async def drip(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\n\r\n")
        try:
            while not writer.is_closing():
                writer.write(b" ")
                await writer.drain()
                await asyncio.sleep(0.02)
        except ConnectionError:
            pass
        gone.set()
        writer.close()

    async with stream_server(drip) as port:
        with pytest.raises(NoAnswer, match=r"no answer to probe within 0\.3 s"):
            await control(f"http://127.0.0.1:{port}", timeout_s=0.3).connect()
        async with asyncio.timeout(LIMIT_S):
            await gone.wait()


@pytest.mark.parametrize("text", ["1_000", "١٢", "1e999", "nan", "infinity", "0x10", "1 2"])
def test_a_text_that_only_python_takes_for_a_number_is_refused(text: str) -> None:
    with pytest.raises(BadAnswer, match=r"Xpos = .*: expected a number"):
        number("Xpos", text, 1.0)


def test_a_number_is_finite_in_the_gateways_unit_too() -> None:
    assert number("Srpm", " 2.5e1 ", 60.0) == 1500.0
    with pytest.raises(BadAnswer, match="Srpm = '1e308': expected a number"):
        number("Srpm", "1e308", 60.0)


ITEMS = "".join(
    f'<DataItem id="{item}" units="{unit}"/>'
    for item, unit in [
        *((f"{axis}pos", "MILLIMETER") for axis in "XYZ"),
        *((f"{axis}pos", "DEGREE") for axis in "AC"),
        ("Srpm", "REVOLUTION/MINUTE"),
    ]
)


@pytest.mark.parametrize("item", ["Srpm", "Cpos"])
async def test_a_word_is_not_a_speed_or_a_position(item: str) -> None:
    told = dict.fromkeys(POSITIONS.values(), "1.5") | {"Srpm": "6000"} | {item: "ACTIVE"}
    text = "".join(f'<P dataItemId="{one}">{value}</P>' for one, value in told.items())
    async with answering(http_answer(f"<MTConnect>{ITEMS}{text}</MTConnect>".encode())) as url:
        nc = control(
            url, machine="mill", states={"spindle_speed": "Srpm"}, mode="", program="", tool="", emergency_stop=""
        )
        if item == "Cpos":
            with pytest.raises(BadAnswer, match="Cpos = 'ACTIVE': expected a number"):
                await nc.connect()
            return
        await nc.connect()
        it = await nc.snapshot()
        assert (it.states, it.not_known) == ({}, {"spindle_speed": "'ACTIVE' (data item Srpm of mill)"})


class Rewritten:
    """An agent whose documents are written by hand: positions all 2.0 in a unit, of one instance."""

    unit, instance, encoding = "MILLIMETER", 1, "UTF-8"
    described = observed = 0
    """How often X is described, and observed with another value, beyond once."""

    def __init__(self) -> None:
        self.probes = 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        probe = b"probe" in await reader.readuntil(b"\r\n\r\n")
        self.probes += probe
        body = "".join(
            f'<DataItem id="{axis}pos" name="Größe" units="{self.unit if axis in "XYZ" else "DEGREE"}"/>'
            if probe
            else f'<P dataItemId="{axis}pos">2.0</P>'
            for axis in "XYZAC" + "X" * self.described * probe
        )
        if not probe:
            body += '<P dataItemId="Xpos">3.0</P>' * self.observed
        head = f'<?xml version="1.0" encoding="{self.encoding}"?><M><Header sender="Süd" instanceId="{self.instance}"/>'
        writer.write(http_answer(f"{head}{body}</M>".encode(self.encoding)))
        writer.close()


POSITIONS_ONLY: Mapping[str, Any] = {"states": {}, "mode": "", "program": "", "tool": "", "emergency_stop": ""}


async def test_a_restarted_agent_is_asked_for_its_units_again() -> None:
    agent = Rewritten()
    async with stream_server(agent.serve) as port:
        nc = control(f"http://127.0.0.1:{port}", **POSITIONS_ONLY)
        await nc.connect()
        assert (await nc.snapshot()).positions["X"] == 2.0
        assert agent.probes == 1
        agent.unit, agent.instance = "INCH", 2
        for _ in range(2):
            with pytest.raises(DriverError):
                await nc.snapshot()
        agent.unit, agent.instance = "MILLIMETER", 3
        await nc.connect()
        assert (await nc.snapshot()).positions["X"] == 2.0


async def test_a_unit_that_changes_without_a_restart_is_noticed_within_a_minute() -> None:
    agent, clock = Rewritten(), ManualClock()
    async with stream_server(agent.serve) as port:
        given = {"url": f"http://127.0.0.1:{port}", "positions": POSITIONS, "timeout_s": LIMIT_S}
        nc = make_mtconnect(settings_of(MtConnectSettings, given), clock)
        await nc.connect()
        agent.unit = "INCH"
        await nc.snapshot()
        clock.move_to(60.0)
        with pytest.raises(WrongDevice):
            await nc.snapshot()


@pytest.mark.parametrize(
    ("described", "observed", "says"),
    [(1, 0, "positions.X = 'Xpos': several data items"), (0, 1, "Xpos = '2.0 and 3.0': expected a number")],
)
async def test_an_id_of_two_data_items_is_nobodys(described: int, observed: int, says: str) -> None:
    agent = Rewritten()
    agent.described, agent.observed = described, observed
    async with stream_server(agent.serve) as port:
        with pytest.raises(DriverError, match=says):
            await control(f"http://127.0.0.1:{port}", **POSITIONS_ONLY).connect()


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "windows-1252", "UTF-16"])
async def test_a_document_is_read_in_the_encoding_that_it_states(encoding: str) -> None:
    agent = Rewritten()
    agent.encoding = encoding
    async with stream_server(agent.serve) as port:
        nc = control(f"http://127.0.0.1:{port}", **POSITIONS_ONLY)
        await nc.connect()
        assert (await nc.snapshot()).positions["Z"] == 2.0


NASTY = st.text(st.characters(codec="utf-8", exclude_characters="<&\x00", min_codepoint=32), max_size=12)
ANY = st.one_of(NASTY, st.floats().map(str), st.sampled_from(["UNAVAILABLE", "1e400", "-inf", "ON", "", "1 2 3"]))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.sampled_from([*POSITIONS.values(), "Srpm"]), ANY), st.integers(0, 400), st.binary(max_size=4))
def test_whatever_is_observed_a_snapshot_is_finite_or_a_drivers_error(
    told: dict[str, str], at: int, spoilt: bytes
) -> None:
    values = dict.fromkeys(POSITIONS.values(), "1.5") | told
    text = "".join(f'<P dataItemId="{item}">{value}</P>' for item, value in values.items())
    body = f"<MTConnect>{ITEMS}{text}</MTConnect>".encode()
    body = body[:at] + spoilt + body[at + len(spoilt) :]

    async def tried() -> None:
        async with answering(http_answer(body)) as url:
            nc = control(url, states={"spindle_speed": "Srpm"}, mode="", program="", tool="", emergency_stop="")
            try:
                await nc.connect()
                it = await nc.snapshot()
            except DriverError:
                return
            assert all(map(math.isfinite, (*it.positions.values(), *it.states.values())))

    asyncio.run(tried())
