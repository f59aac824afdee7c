"""The typed client against a publisher over Zenoh on loopback, and the example of its page."""

import asyncio
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, date, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from msgspec.structs import replace

from gateway.model.codes import NoticeCode
from gateway.model.control_state import NcState
from gateway.model.events import DecisionMade, Health, HealthChecked, ReadingsTaken, StoreHealth
from gateway.model.reading_blocks import READING_ROW, pack
from gateway.model.text import Text, plain
from gateway.telemetry.answers import HistoryBlock, HistoryPage
from gateway.telemetry.asking import QueryRefusal
from gateway.telemetry.client import Machine, MachineError
from gateway.telemetry.history_queries import HistoryRequest
from gateway.telemetry.messages import DecisionMessage, EventMessage, Published, ReadingMessage
from tests.benches.free_port import free_port
from tests.benches.telemetry_peer import decision, problem, reading, telemetry
from tests.benches.waits import wait_until

PAGE = (Path(__file__).parents[3] / "docs" / "keys.md").read_text(encoding="utf-8")
LIMIT_S = 120.0
BEGIN = datetime(2026, 3, 2, tzinfo=UTC)


def here(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


def next_text(messages: Iterator[Published]) -> str:
    message = next(messages)
    assert isinstance(message, EventMessage)
    return message.text


async def test_silent_connections_do_not_shut_out_a_client() -> None:
    port = free_port()
    async with telemetry(port):
        silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(300)]
        with Machine(connect=here(port)) as machine:
            assert machine.running()
        for connection in silent:
            connection.close()


async def test_a_follower_gets_the_last_message_and_then_each_one_once_and_in_order() -> None:
    port = free_port()
    async with telemetry(port) as publisher:
        publisher.publish(problem("before"))
        publisher.publish(ReadingsTaken([reading(20.0)]))
        with Machine(connect=here(port)) as machine:
            wait_until(lambda: machine.latest("event"))  # the publishing thread may still be at it
            messages = machine.follow("event", quiet_s=LIMIT_S)
            assert next_text(messages) == "before"
            for n in range(20):
                publisher.publish(problem(f"number {n}"))
            assert [next_text(messages) for _ in range(20)] == [f"number {n}" for n in range(20)]
            messages.close()
            assert machine.missed == 0


async def test_last_messages_are_typed_and_by_key() -> None:
    port = free_port()
    async with telemetry(port) as publisher:
        publisher.publish(ReadingsTaken([reading(20.0)]))
        publisher.publish(DecisionMade(decision(7)))
        publisher.publish(
            HealthChecked(Health(60.0, 30, 29, NcState.READY, None, (plain("an operator"),), StoreHealth()))
        )
        publisher.publish(problem("the last"))
        with Machine("mill", connect=here(port)) as machine:
            wait_until(lambda: machine.latest("event"))
            latest = machine.latest()
            status = machine.status()
            assert list(machine.latest("reading", "decision")) == ["reading/t0", "decision"]
    assert isinstance(latest["decision"], DecisionMessage)
    assert isinstance(latest["reading/t0"], ReadingMessage)
    assert (latest["reading/t0"].value, latest["decision"].k) == (20.0, 7)
    assert (status.channels_good, status.channels, status.waits_for) == (29, 30, ("an operator",))


async def test_silence_longer_than_its_limit_ends_a_follower() -> None:
    port = free_port()
    async with telemetry(port):
        with (
            Machine(connect=here(port)) as machine,
            pytest.raises(TimeoutError, match=r"nothing was published for 0\.1 s"),
        ):
            next(machine.follow(quiet_s=0.1))


async def test_an_absent_machine_is_named() -> None:
    port = free_port()
    with pytest.raises(MachineError, match=f"no answer at tcp/127.0.0.1:{port}: .*nothing listens"):
        Machine(connect=here(port)).__enter__()
    async with telemetry(port):
        with pytest.raises(MachineError, match="no gateway of machine lathe runs under talc; running: mill"):
            Machine("lathe", connect=here(port)).__enter__()
        with Machine(connect=here(port)) as machine:
            assert machine.name == "mill"
            with pytest.raises(ValueError, match="'readings': no such kind of key; known are reading, frame"):
                machine.latest("readings")


@pytest.mark.parametrize(
    ("name", "connect", "said"),
    [("a*", "tcp/127.0.0.1:7447", "name = 'a\\*'"), (None, "7447", "connect = '7447': expected Zenoh endpoints")],
)
def test_invalid_arguments_are_refused_at_once(name: str | None, connect: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Machine(name, connect=connect)
    with pytest.raises(ValueError, match="prefix = 'a//b': expected letters, digits, _ and -, parts separated by /"):
        Machine(prefix="a//b", connect="tcp/127.0.0.1:7447")
    with pytest.raises(MachineError, match="not connected"):
        Machine(connect="tcp/127.0.0.1:7447").status()


def stored(asked: HistoryRequest) -> HistoryPage:
    """Two pages; the channel b appears in the second, and has one value that is not good, at a separate time."""
    if asked.channels == ("bed",):
        raise ValueError("channels: 'bed' was never stored")
    first = asked.begin.timestamp()
    if asked.after is None:
        return HistoryPage(60.0, ("a",), ("degC",), [first], [0], [20.0], ["good"], "r1")
    assert asked.after == "r1"
    times = [first + 60.125, first + 60.125, first + 61.0, first + 62.0]
    values: list[float | None] = [21.0, -1.5, 23.0, 30.0]
    quality = ["good", "good", "good", "stale"]
    return HistoryPage(0.0, ("a", "b"), ("degC", "um"), times, [0, 1, 0, 1], values, quality, None)


async def test_a_day_is_a_table_of_its_good_values_by_channel() -> None:
    port, asked = free_port(), list[HistoryRequest]()

    def find(request: HistoryRequest) -> HistoryPage:
        asked.append(request)
        return stored(request)

    async with telemetry(port, history=find):
        with Machine(connect=here(port)) as machine:
            day = machine.day(date(2026, 3, 2))
            only = machine.day(date(2026, 3, 2), ["b", "a"], zone=timezone(timedelta(hours=1)))
            minutes = machine.history(BEGIN, BEGIN + timedelta(minutes=3), every_s=60.0)
            with pytest.raises(MachineError, match="mill: history: channels: 'bed' was never stored"):
                machine.day(date(2026, 3, 2), ["bed"])
            with pytest.raises(ValueError, match="expected times with a time zone"):
                machine.history(datetime(2026, 3, 2), BEGIN)  # noqa: DTZ001
    at = [BEGIN, BEGIN + timedelta(seconds=60.125), BEGIN + timedelta(seconds=61)]
    expected = pd.DataFrame(
        {"a": [20.0, 21.0, 23.0], "b": [np.nan, -1.5, np.nan]}, index=pd.DatetimeIndex(at, name="time")
    )
    pd.testing.assert_frame_equal(day, expected, check_index_type=False)
    assert list(only.columns) == ["b", "a"]
    means = pd.DataFrame(
        {"a": [20.0, 22.0, np.nan], "b": [np.nan, -1.5, np.nan]},
        index=pd.DatetimeIndex([BEGIN + timedelta(minutes=n) for n in range(3)], name="time"),
    )
    pd.testing.assert_frame_equal(minutes, means, check_index_type=False)
    assert (asked[0].begin, asked[0].end) == (BEGIN, BEGIN + timedelta(days=1))
    assert (asked[2].begin, asked[2].end) == (BEGIN - timedelta(hours=1), BEGIN + timedelta(hours=23))


@pytest.mark.parametrize("earlier", [False, True], ids=["means of the gateway", "an earlier gateway, of the readings"])
async def test_a_table_of_means_is_that_of_the_gateway_where_it_makes_them(earlier: bool) -> None:
    port, asked = free_port(), list[int | None]()

    def find(request: HistoryRequest) -> HistoryPage:
        asked.append(request.every_s)
        if request.every_s is None:
            return stored(request)
        if earlier:
            raise ValueError(Text(NoticeCode.PARAMETER_UNKNOWN, name="every", known=("from", "to")))
        times = [request.begin.timestamp(), request.begin.timestamp() + request.every_s]
        return HistoryPage(float(request.every_s), ("a",), ("degC",), times, [0, 0], [20.0, 22.0], ["good"] * 2, None)

    end = BEGIN + timedelta(minutes=3)
    async with telemetry(port, history=find):
        with Machine(connect=here(port)) as machine:
            table = machine.history(BEGIN, end, every_s=60)
            for begin, every_s in (
                (BEGIN + timedelta(seconds=0.5), 30),
                (BEGIN + timedelta(seconds=30), 60),
                (BEGIN, 0.5),
                (BEGIN, 3601),
            ):
                machine.history(begin, end, every_s=every_s)
            with pytest.raises(ValueError, match="every_s = nan: expected more than 0"):
                machine.history(BEGIN, end, every_s=float("nan"))
    assert table["a"].tolist() == pytest.approx([20.0, 22.0, np.nan], nan_ok=True)
    assert [every_s for every_s in asked if every_s is not None] == [60], "of others, the readings themselves"


def as_blocks(page: HistoryPage) -> HistoryPage:
    """The same readings, each channel and quality by a number that is not its place."""
    rows = np.zeros(len(page.time), READING_ROW)
    rows["time"], rows["channel"], rows["value"] = page.time, [7 + 3 * at for at in page.channel], page.value
    qualities = ("bad", "stale", "good")
    rows["quality"] = [qualities.index(quality) for quality in page.quality]
    numbers = tuple(7 + 3 * at for at in range(len(page.names)))
    blocks = tuple(HistoryBlock(*pack(part)) for part in (rows[:1], rows[1:]) if len(part))
    return HistoryPage(page.period_s, page.names, page.units, [], [], [], [], page.next, blocks, numbers, qualities)


@pytest.mark.parametrize(
    ("how", "forms"),
    [("new", [True, True]), ("of an earlier program", [True, False, False]), ("damaged", [True, False, False])],
)
@pytest.mark.parametrize("every_s", [None, 0.5])
async def test_a_table_of_single_readings_comes_in_blocks_where_it_can(
    how: str, forms: list[bool], every_s: float | None
) -> None:
    port, asked = free_port(), list[bool]()

    def find(request: HistoryRequest) -> HistoryPage:
        asked.append(request.blocks)
        if not request.blocks:
            return stored(request)
        if how == "of an earlier program":
            raise ValueError(Text(NoticeCode.PARAMETER_UNKNOWN, name="form", known=("from", "to")))
        page = as_blocks(stored(request))
        return page if how == "new" else replace(page, blocks=(replace(page.blocks[0], value=b"x"),))

    span = (BEGIN, BEGIN + timedelta(minutes=3))
    async with telemetry(port, history=find):
        with Machine(connect=here(port)) as machine:
            table = machine.history(*span, every_s=every_s)
            only = machine.history(*span, ["b"], every_s=every_s)
    assert asked == forms * 2
    found = {(at - BEGIN).total_seconds(): row for at, *row in table.itertuples() if not np.isnan(row).all()}
    half = every_s is not None
    expected = {0.0: [20.0, np.nan], 60.0 if half else 60.125: [21.0, -1.5], 61.0: [23.0, np.nan]}
    assert list(found) == list(expected)
    for at, row in found.items():
        assert row == pytest.approx(expected[at], nan_ok=True)
    assert only["b"].dropna().tolist() == [-1.5]


def test_a_refusal_without_a_code_is_of_a_program_that_may_lack_anything() -> None:
    unknown = QueryRefusal(Text(NoticeCode.PARAMETER_UNKNOWN, name="form", known=("from", "to")))
    disk = QueryRefusal(Text(NoticeCode.QUERY_REFUSED, kind="history", why="the disk does not answer"))
    assert [refusal.lacks("form") for refusal in (unknown, disk, QueryRefusal("in any words"))] == [True, False, True]
    assert not unknown.lacks("every")


async def test_what_a_gateway_refuses_is_not_asked_for_a_second_time_in_another_form() -> None:
    port, asked = free_port(), list[bool]()

    def find(request: HistoryRequest) -> HistoryPage:
        asked.append(request.blocks)
        raise OSError("the disk does not answer")

    async with telemetry(port, history=find):
        with (
            Machine(connect=here(port)) as machine,
            pytest.raises(MachineError, match="history: the disk does not answer"),
        ):
            machine.day(date(2026, 3, 2))
    assert asked == [True]


@pytest.mark.slow
async def test_the_example_of_the_page_follows_a_machine_and_reads_its_day() -> None:
    found = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    port = free_port()
    code = found[1].replace("tcp/192.168.1.5:7447", here(port))
    assert code != found[1]
    async with telemetry(port, history=stored) as publisher:
        publisher.publish(
            HealthChecked(Health(60.0, 30, 29, NcState.READY, None, (plain("an operator"),), StoreHealth()))
        )
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-uc", code), stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        try:
            assert process.stdout is not None
            said = b""
            async with asyncio.timeout(LIMIT_S):
                for k in (7, 8):  # it gets the last decision, and then each one
                    publisher.publish(DecisionMade(decision(k)))
                    while said.count(b"calibration") < k - 6:
                        said += await process.stdout.read(1000) or pytest.fail(str(await process.communicate()))
        finally:
            with suppress(ProcessLookupError):
                process.kill()
            await process.communicate()  # closes its pipes
    assert b"29 of 30" in said
    assert b"an operator" in said
    assert b"21.0" in said
