"""A device driven by a scenario: its values and faults over time, seen in its answers."""

import asyncio

import pytest

from simulators.devices import M7015
from simulators.devices.modbus_unit import answer
from simulators.devices.scenario import Scenario
from tests.benches.manual_clock import ManualClock

SCENARIO = """
[[at]]
s = 0
values = [20, 30]

[[at]]
s = 10
values = [20, 40]
fault = "open"
channel = 0

[[at]]
s = 15
mend = 0
silent = true

[[at]]
s = 20
silent = false

[[at]]
s = 30
values = [25.5, 0]
"""
READ_TWO = bytes.fromhex("04 00 00 00 02")


@pytest.mark.parametrize(
    ("time_s", "values"),
    [(-5, [20, 30]), (0, [20, 30]), (5, [20, 35]), (10, [20, 40]), (20, [22.75, 20]), (30, [25.5, 0]), (99, [25.5, 0])],
)
def test_values_run_straight_between_the_entries(time_s: float, values: list[float]) -> None:
    assert Scenario.parse(SCENARIO).values(time_s) == pytest.approx(values)


async def test_device_answers_what_the_script_says_at_that_time() -> None:
    clock, scenario = ManualClock(1000.0), Scenario.parse(SCENARIO)
    module = M7015(lambda: [*told(), 0.0, 0.0, 0.0, 0.0])
    told = scenario.source(clock)
    playing = asyncio.create_task(scenario.play(module.faults.actions(), clock))
    seen = {}
    for second in (0, 5, 10, 14, 15, 20, 30):
        await clock.pass_to(1000.0 + second)
        seen[second] = "silent" if module.silent else answer(module, READ_TWO)[2:].hex()
    await playing
    assert seen == {
        0: "00c8012c",
        5: "00c8015e",
        10: "7fff0190",  # open: the sentinel; 40.0
        14: "7fff0140",
        15: "silent",
        20: "00e400c8",
        30: "00ff0000",
    }


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no entry with `values`"),
        ("[[at]]\nvalues = [1]", r"at\[0\].s = None: expected seconds"),
        ("[[at]]\ns = 1\nvalues = [1]\n[[at]]\ns = 0", r"at\[1\].s = 0: expected seconds, not before 1"),
        ("[[at]]\ns = 0\nvalues = [1]\n[[at]]\ns = 1\nvalues = [1, 2]", r"at\[1\].values = .*expected 1 of them"),
        ("[[at]]\ns = 0\nvalues = []", "expected numbers"),
        ('[[at]]\ns = 0\nfault = "broken"\nchannel = 0', "fault = 'broken': expected one of open, short, over, under"),
        ('[[at]]\ns = 0\nfault = "open"', r"at\[0\].channel = None: expected a channel's number"),
        ("[[at]]\ns = 0\nmend = -1", r"at\[0\].mend = -1"),
        ("[[at]]\ns = nan\nvalues = [1]", r"at\[0\].s = nan: expected seconds"),
        ("[[at]]\ns = 0\nvalues = [1, inf]", r"at\[0\].values = \[1, inf\]: expected numbers"),
        (
            '[[at]]\ns = 0\nvalues = [1, 2]\n[[at]]\ns = 1\nfault = "open"\nchannel = 2',
            r"at\[1\].channel = 2: `values` has channels 0 to 1",
        ),
        ("[[at]]\ns = 0\nvalues = [1, 2]\n[[at]]\ns = 1\nmend = 7", r"at\[1\].mend = 7: `values` has channels 0 to 1"),
        ("[[at]]\ns = 0\nsilent = 1", r"at\[0\].silent = 1: expected true or false"),
        ("[[at]]\ns = 0\nvalue = [1]", "unknown key 'value'; known: abort, channel, crc, .*, values"),
        ("[[at]]\ns = 0\ndelay_s = -1", r"at\[0\].delay_s = -1: expected seconds, 0 to end it"),
        ("[[at]]\ns = 0\ndelay_s = inf", r"at\[0\].delay_s = inf: expected seconds"),
        ('[[at]]\ns = 0\ncrc = "wrong"', r"at\[0\].crc = 'wrong': expected true or false"),
        ("[[at]]\ns = 0\ntruncated = 3", r"at\[0\].truncated = 3: expected true or false"),
        ("[[at]]\ns = 0\nexception = 256", r"at\[0\].exception = 256: expected a Modbus exception code up to 255"),
        ("[[at]]\ns = 0\nabort = true", r"at\[0\].abort = True: expected an SDO abort code"),
        ("[[at]]\ns = 0\nheartbeat = 0", r"at\[0\].heartbeat = 0: expected true or false"),
        ("[[at]]\ns = 0\nemcy = 0x10000", r"at\[0\].emcy = 65536: expected an emergency's code"),
        ("[[at]]\ns = 0\nreboot = false", r"at\[0\].reboot = False: expected true"),
        ("[[at]]\ns = 0\ntype_code = 30", r"at\[0\].channel = None: expected a channel's number"),
        (
            "[[at]]\ns = 0\nvalues = [1]\ntype_code = 30\nchannel = 1",
            r"at\[0\].channel = 1: `values` has channels 0 to 0",
        ),
        ("[[at]]\ns = 0\ntype_code = -1\nchannel = 0", r"at\[0\].type_code = -1: expected a code"),
    ],
)
def test_mistakes_are_named(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Scenario.parse(text)
