"""Multiplexed messages: frames that cantools has encoded, several contents on one identifier."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import cantools
import pytest

from drivers.base import Driver, NoAnswer, Quality, SystemClock
from drivers.build import make_device
from simulators.devices import SlcanAdapter
from tests.benches.buses import make_bus

pytestmark = pytest.mark.simulated_time

DBC = """VERSION ""
NS_ :
\tSG_MUL_VAL_
BU_: L
BO_ 768 Inputs: 8 L
 SG_ Select M : 3|4@0+ (1,0) [0|15] "" L
 SG_ Supply : 8|8@1+ (0.1,0) [0|25] "V" L
 SG_ T1 m0 : 16|16@1- (0.1,0) [-200|850] "degC" L
 SG_ T2 m1 : 16|16@1- (0.1,0) [-200|850] "degC" L
 SG_ T3 m2 : 16|16@1- (0.1,0) [-200|850] "degC" L
BO_ 769 Nested: 8 L
 SG_ Group M : 0|8@1+ (1,0) [0|255] "" L
 SG_ Sub m3M : 20|12@1+ (1,0) [0|4095] "" L
 SG_ Deep m0 : 32|16@1- (0.1,0) [-200|850] "degC" L
BO_ 770 Wide: 8 L
 SG_ Page M : 3|12@0+ (1,0) [0|4095] "" L
 SG_ Far m0 : 16|16@1- (0.1,0) [-200|850] "degC" L
SG_MUL_VAL_ 769 Sub Group 3-3;
SG_MUL_VAL_ 769 Deep Sub 2-4, 700-700;
SG_MUL_VAL_ 770 Far Page 2748-2748;
"""
NAMES = (
    ("Inputs", "T1"),
    ("Inputs", "T2"),
    ("Inputs", "T3"),
    ("Inputs", "Supply"),
    ("Nested", "Deep"),
    ("Wide", "Far"),
)


@asynccontextmanager
async def bench(folder: Path) -> AsyncIterator[tuple[SlcanAdapter, Driver]]:
    (folder / "inputs.dbc").write_text(DBC)
    signals = "".join(f'[[signal]]\nmessage = "{message}"\nname = "{name}"\n' for message, name in NAMES)
    (folder / "inputs.toml").write_text(
        f'protocol = "can_dbc"\ntitle = "inputs"\nunit = "degC"\ndbc = "inputs.dbc"\n{signals}'
    )
    adapter = SlcanAdapter([])
    bus = make_bus("can1", "can", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 1.0})
    channels = {name: number for number, (_, name) in enumerate(NAMES)}
    driver = make_device("inputs", bus, str(folder / "inputs.toml"), 1, channels, {}, SystemClock())
    try:
        await bus.connect()
        yield adapter, driver
    finally:
        await bus.close()
        await adapter.stop()


def frame(message: str, values: Mapping[str, float]) -> tuple[int, bytes]:
    """A frame encoded by cantools, which knows nothing of our pages."""
    database = cantools.database.load_string(DBC, "dbc")
    assert isinstance(database, cantools.database.can.Database)
    encoded = database.get_message_by_name(message)
    return encoded.frame_id, encoded.encode(dict(values))


ByName = dict[str, tuple[float | str, str]]


async def sent(
    adapter: SlcanAdapter, driver: Driver, frames: Sequence[tuple[int, bytes]], done: Callable[[ByName], bool]
) -> ByName:
    """Send the frames again and again, until what was read is `done`."""
    async with asyncio.timeout(600.0):
        while True:
            adapter.send(frames)
            await asyncio.sleep(0.1)
            with suppress(NoAnswer):
                found: ByName = {
                    r.channel: (round(r.value, 6) if r.quality is Quality.GOOD else r.quality.value, r.detail)
                    for r in await driver.read()
                }
                if done(found):
                    return found


def good(*names: str) -> Callable[[ByName], bool]:
    return lambda found: all(isinstance(found[name][0], float) for name in names)


async def test_each_page_is_kept_for_itself(tmp_path: Path) -> None:
    frames = [
        frame("Inputs", {"Select": 0, "Supply": 24.0, "T1": 21.5}),
        frame("Nested", {"Group": 3, "Sub": 700, "Deep": 55.5}),
        frame("Inputs", {"Select": 1, "Supply": 24.0, "T2": -3.3}),
    ]
    async with bench(tmp_path) as (adapter, driver):
        found = await sent(adapter, driver, frames, good("T1", "T2", "Deep"))
    assert found == {
        "T1": (21.5, ""),
        "T2": (-3.3, ""),
        "T3": ("comm_fault", "message Inputs (0x300) with T3 did not arrive"),
        "Supply": (24.0, ""),
        "Deep": (55.5, ""),
        "Far": ("comm_fault", "message Wide (0x302) with Far did not arrive"),
    }


async def test_another_page_never_becomes_a_value(tmp_path: Path) -> None:
    identifier, deep = frame("Nested", {"Group": 3, "Sub": 3, "Deep": 10.0})
    _, third = frame("Inputs", {"Select": 2, "Supply": 22.0, "T3": 1.0})
    frames = [
        (identifier, bytes([4]) + deep[1:]),  # another group
        (identifier, deep[:2] + bytes([deep[2] | 0x50]) + deep[3:]),  # another sub-page
        (0x300, bytes([third[0] | 0x0F]) + third[1:]),  # a page that the DBC file does not have
    ]
    async with bench(tmp_path) as (adapter, driver):
        found = await sent(adapter, driver, frames, good("Supply"))
        assert found["Supply"] == (22.0, ""), "it needs no page"
        assert {found[name][0] for name in ("T1", "T2", "T3", "Deep")} == {"comm_fault"}
        found = await sent(adapter, driver, [(identifier, deep)], good("Deep"))
        assert found["Deep"] == (10.0, "")


async def test_a_page_that_stops_is_lost_alone(tmp_path: Path) -> None:
    first, second = (frame("Inputs", {"Select": i, "Supply": 24.0, f"T{i + 1}": 21.5 + i}) for i in (0, 1))
    async with bench(tmp_path) as (adapter, driver):
        await sent(adapter, driver, [first, second], good("T1", "T2"))
        found = await sent(adapter, driver, [second], lambda found: not good("T1")(found) and good("T2")(found))
    assert (found["T1"][0], found["T2"][0]) == ("comm_fault", 22.5)


async def test_a_selector_that_goes_over_two_bytes_the_highest_bit_first(tmp_path: Path) -> None:
    identifier, far = frame("Wide", {"Page": 0xABC, "Far": 12.5})
    assert far[:2] == b"\x0a\xbc", "four bits of the first byte, and the second"
    others = [
        (identifier, bytes([a, b]) + far[2:]) for a, b in ((0x0A, 0xBD), (0x0A, 0x3C), (0x0B, 0xBC), (0x02, 0xBC))
    ]
    supply = frame("Inputs", {"Select": 0, "Supply": 24.0, "T1": 21.5})
    async with bench(tmp_path) as (adapter, driver):
        found = await sent(adapter, driver, [supply, *others], good("Supply"))
        assert found["Far"][0] == "comm_fault"
        found = await sent(adapter, driver, [(identifier, far)], good("Far"))
        assert found["Far"] == (12.5, "")
