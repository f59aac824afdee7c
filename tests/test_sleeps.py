"""No test sleeps in the hope that something happens meanwhile, or asserts how long something took.

The marks `simulated_time` and `realtime` are for what is about time (tests/README.md).
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benches.waits import turns

TESTS = Path(__file__).parent
TIMES = ("pytest.mark.simulated_time", "pytest.mark.realtime")
LEAST_LIMIT_S = 30.0
"""A limit below this may be a pause: what a slow computer does later passes for what never comes."""
LIMITS = ("asyncio.timeout(", "asyncio.timeout_at(")
TURNS = (["await asyncio.sleep(0)"], ["await asyncio.sleep(0.0)"])
SLEEPS = ("asyncio.sleep", "time.sleep", "sleep", "threading.Event().wait", "Event().wait")
CLOCKS = ("time.monotonic()", "monotonic()", "time.perf_counter()", "perf_counter()", "time.time()", "loop.time()")
MEASURES = "it measures for this long what a program takes"
BENCHES = {
    "disturbed_line.py disturbed": "on simulated time",
    "limits_probe.py used_s": "processor time, which processes share, is measured from one moment on in all of them",
    "linuxcnc_motion.py table": "for docs/linuxcnc.md: LinuxCNC moves for a while before it is measured",
    "linuxcnc_period.py clocks_per_us": "how fast the processor's counter counts, for a realtime test",
    "nc_benches.py ReferenceAgentBench.wait": "on simulated time",
    "nc_benches.py NodeOpcuaBench.wait": "a pause between two looks",
    "nc_disturbances.py NcSite.disturb": "on simulated time; with LinuxCNC each of its servo periods is judged",
    "nc_disturbances.py NcSite.disturb_all": "likewise",
    "nc_disturbances.py disturbed": "on simulated time",
    "outlets_cost.py main": MEASURES,
    "page_browsers.py _publish": "the pace of what it measures",
    "power_cuts.py session": "the pace of readings; the test cuts at what was written",
    "publishing_cost.py main": MEASURES,
    "rigs.py Rig.break_sensor": "on simulated time",
    "rigs.py Rig.cut_wire": "on simulated time",
    "rigs.py Rig.silence": "on simulated time",
    "site.py of_time": "for docs/collect.md; the test lets rows pass",
    "spoilt_answers.py read_spoilt": "on simulated time",
    "tick_latency.py run_ticks": MEASURES,
}
"""Functions of benches that sleep, and the reason that this does not rely on luck."""
MOSQUITTO_SUB = "mosquitto_sub ends after ten minutes, and then there is no next message"
POLLS = {
    "benches/cut_wire.py CutWire._pass_on": "passes on what it reads, until its source ends",
    "benches/fuzz.py fuzzed": "a processor time or a number of examples that it is given",
    "benches/kills.py kill_gateways": "a program of its own, which says how many databases it has taken",
    "benches/linuxcnc_bench.py AgentBench.beating.beat": "a task that its test ends",
    "benches/linuxcnc_disturbances.py disturbed_linuxcnc.record": "a task that its test ends",
    "benches/mosquitto.py Subscriber.until": MOSQUITTO_SUB,
    "benches/played_telemetry.py PlayedGateway.keep_saying": "a thread that its program ends",
    "benches/site_parts.py _until_told": "a process that its test ends",
    "drivers/modbus/test_modbus_blocks.py test_every_place_is_asked_for_or_left_out_and_never_both": "each look leaves "
    "out one request more",
    "gateway/outlets/test_publish.py test_what_a_gateway_publishes_reaches_the_broker_and_its_death_too": MOSQUITTO_SUB,
    "gateway/storage/test_row_pages.py Asker.catch_up": "each look takes a page",
    "system/test_page_beyond_this_computer.py test_tls_and_a_password_open_the_page_and_nothing_else_does": "its "
    "connection has a limit",
    "system/test_stop_on_hanging_disk.py wait_until_ready": "its socket has a limit",
    "test_pages.py paragraphs": "each look is at the next line",
    "test_tree.py modules_of": "each look is at the name behind a name",
}
"""Loops that look again and again, or that a call ends, without a limit of their own, and what ends them."""
CONTROLS_TIME = "the control's time, which the test sets"
OF_THE_LOOP = "what it waits for needs only turns of the loop, no other thread or wire"
PAUSES = {
    "benches/nc_benches.py in_process": CONTROLS_TIME,
    "benches/nc_benches.py sinumerik.opened": CONTROLS_TIME,
    "benches/npm_peer.py running": "afterwards the peer is killed",
    "benches/played_telemetry.py PlayedGateway.keep_saying": "the pace of what it says, until it is stopped",
    "benches/site_parts.py _until_told": "a process that its test ends",
    "benches/stream_server.py stream_server": OF_THE_LOOP,
    "drivers/test_serial_server.py test_a_port_that_opens_when_nobody_waits_any_more_is_closed": "the thread is at "
    "work from the first turn on; how far it has come must not matter",
    "gateway/cli/running/test_alive.py signs": OF_THE_LOOP,
    "simulators/devices/test_loopback.py test_a_client_that_connects_while_the_server_stops_is_disconnected."
    "connect_and_stop": "each of these numbers of turns is right",
}
"""Functions with a short limit, or that let the loop turn some times, and the reason that this does not rely on
luck."""


def sleeps(text: str) -> Iterator[tuple[int, str]]:
    """Lines that sleep in real time other than between two looks at a condition, and their function."""
    for node, name, looking in walked(text) if any(sleep in text for sleep in SLEEPS) else ():
        if isinstance(node, ast.Call) and not looking and node.args and ast.unparse(node.func) in SLEEPS:
            if ast.unparse(node.args[0]) in ("0", "0.0"):
                continue
            yield node.lineno, name


def elapsed(text: str) -> Iterator[tuple[int, str]]:
    """Lines that assert how much real time has passed, and their function. A deadline is not one: it has no
    difference."""
    found = list(walked(text)) if any(clock in text for clock in CLOCKS) else []
    taken = {(name, kept) for node, name, _ in found for kept in durations(node)}
    for node, name, _ in found:
        if isinstance(node, ast.Assert):
            compared = [one for one in ast.walk(node.test) if isinstance(one, ast.Compare)]
            sides = [part for one in compared for side in (one.left, *one.comparators) for part in ast.walk(side)]
            if any(is_difference(part) or (name, ast.unparse(part)) in taken for part in sides):
                yield node.lineno, name


def durations(node: ast.AST) -> list[str]:
    """Names that keep how much time has passed: assigned, added or appended."""
    match node:
        case ast.Assign(targets=[target], value=value) | ast.NamedExpr(target=target, value=value):
            pass
        case ast.AnnAssign(target=target, value=ast.expr() as value) | ast.AugAssign(target=target, value=value):
            pass
        case ast.Call(func=ast.Attribute(value=target, attr="append"), args=[value]):
            pass
        case _:
            return []
    return [ast.unparse(target)] if any(is_difference(part) for part in ast.walk(value)) else []


def polls(text: str) -> Iterator[tuple[int, str]]:
    """Lines that look again and again with no end, so that a test hangs where it should fail, and their function.

    The end is a clock in the loop, or an `asyncio.timeout` around it in the same function.
    """

    def visit(node: ast.AST, name: str, ends: bool) -> Iterator[tuple[int, str]]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if any(ast.unparse(mark).startswith(TIMES[0]) for mark in node.decorator_list):
                return
            name, ends = f"{name}.{node.name}".lstrip("."), False
        if isinstance(node, ast.AsyncWith):
            ends = ends or any(ast.unparse(each.context_expr).startswith(LIMITS) for each in node.items)
        if isinstance(node, ast.While) and not ends and is_poll(node):
            yield node.lineno, name
        for child in ast.iter_child_nodes(node):
            yield from visit(child, name, ends)

    tree = ast.parse(text)
    if not any(TIMES[0] in ast.unparse(node.value) for node in tree.body if isinstance(node, ast.Assign)):
        yield from visit(tree, "", ends=False)


def is_poll(loop: ast.While) -> bool:
    """Whether a loop may go on for ever: it pauses, or does nothing, between two looks, or only what it calls in its
    condition can end it. Work that only a cancellation ends is not one, nor what takes things until there are none."""
    inside = list(ast.walk(loop))
    is_work = ast.unparse(loop.test) == "True" and not any(isinstance(node, ast.Break | ast.Return) for node in inside)
    has_clock = any(clock in ast.unparse(loop) for clock in CLOCKS)
    pauses = any(isinstance(node, ast.Call) and node.args and ast.unparse(node.func) in SLEEPS for node in inside)
    is_idle = all(isinstance(node, ast.Pass) for node in loop.body) and "await " not in ast.unparse(loop.test)
    return (pauses or is_idle or is_told_when_to_end(loop)) and not is_work and not has_clock


def is_told_when_to_end(loop: ast.While) -> bool:
    """Whether nothing but the answer to a call ends it."""
    asked = {ast.unparse(call.func) for call in ast.walk(loop.test) if isinstance(call, ast.Call)} - {
        "len",
        "isinstance",
    }
    takes = any(isinstance(node, ast.NamedExpr | ast.Await) for node in ast.walk(loop.test))
    leaves = any(isinstance(node, ast.Break | ast.Return | ast.Raise) for node in ast.walk(loop))
    return bool(asked) and not takes and not leaves


def pauses(text: str) -> Iterator[tuple[int, str]]:
    """Lines with a limit so short that it may be a pause, or that let the loop turn some times, and their function."""
    sums = [node for node in ast.parse(text).body if isinstance(node, ast.Assign)]
    named = {ast.unparse(node.targets[0]): node.value for node in sums}
    for node, name, _ in walked(text):
        if isinstance(node, ast.For) and len(node.body) == 1 and [ast.unparse(inside) for inside in node.body] in TURNS:
            yield node.lineno, name
        if isinstance(node, ast.Call):
            values = [named.get(ast.unparse(limit), limit) for limit in limits(node)]
            numbers = [value.value for value in values if isinstance(value, ast.Constant)]
            if any(isinstance(number, int | float) and 0 < number < LEAST_LIMIT_S for number in numbers):
                yield node.lineno, name


def limits(call: ast.Call) -> list[ast.expr]:
    """What it is given as its longest time."""
    given = [each.value for each in call.keywords if each.arg == "timeout"]
    match call.func:
        case ast.Attribute(attr="timeout" | "wait" | "join"):
            return [*given, *call.args[:1]]
        case ast.Attribute(attr="wait_for"):
            return [*given, *call.args[1:2]]
    return given


def is_difference(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.BinOp)
        and isinstance(node.op, ast.Sub)
        and any(ast.unparse(side) in CLOCKS for side in (node.left, node.right))
    )


def walked(text: str) -> Iterator[tuple[ast.AST, str, bool]]:
    """What no mark excuses: each node, the function it is in, and whether it is in a loop that looks for something."""

    def visit(node: ast.AST, name: str, looking: bool) -> Iterator[tuple[ast.AST, str, bool]]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if any(ast.unparse(mark).startswith(TIMES) for mark in node.decorator_list):
                return
            name = f"{name}.{node.name}".lstrip(".")
        yield node, name, looking
        looking = looking or looks(node)
        for child in ast.iter_child_nodes(node):
            yield from visit(child, name, looking)

    tree = ast.parse(text)
    marks = [ast.unparse(node.value) for node in tree.body if isinstance(node, ast.Assign) and is_mark(node)]
    if not any(time in mark for mark in marks for time in TIMES):
        yield from visit(tree, "", looking=False)


def looks(node: ast.AST) -> bool:
    """Whether a loop ends when what it waits for is there, not when a time has passed."""
    if not isinstance(node, ast.While | ast.For | ast.AsyncFor):
        return False
    early = any(isinstance(inside, ast.Break | ast.Return) for inside in ast.walk(node))
    if isinstance(node, ast.While):
        return early or not is_only_a_deadline(node.test)
    return early


def is_only_a_deadline(test: ast.expr) -> bool:
    return isinstance(test, ast.Compare) and any(
        clock in ast.unparse(side) for side in (test.left, *test.comparators) for clock in CLOCKS
    )


def is_mark(node: ast.Assign) -> bool:
    return ast.unparse(node.targets[0]) == "pytestmark"


def lines(found: Iterator[tuple[int, str]]) -> list[int]:
    return [line for line, _ in found]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("def test():\n    time.sleep(0.1)\n", [2]),
        ("def test():\n    threading.Event().wait(0.1)\n", [2]),
        ("async def test():\n    await asyncio.sleep(1)\n    assert done\n", [2]),
        ("async def test():\n    await asyncio.sleep(0)\n", []),
        ("def test():\n    while not done:\n        time.sleep(0.1)\n", []),
        ("def test():\n    while time.monotonic() < end:\n        time.sleep(0.1)\n", [3]),
        ("def test():\n    for _ in range(3):\n        time.sleep(0.1)\n", [3]),
        ("def test():\n    for _ in many:\n        if done:\n            break\n        sleep(1)\n", []),
        ("def test():\n    time.sleep(0.1)  # its pace\n", [2]),
        ("@pytest.mark.simulated_time\nasync def test():\n    await asyncio.sleep(1)\n", []),
        ("pytestmark = pytest.mark.realtime\n\n\ndef test():\n    time.sleep(1)\n", []),
    ],
)
def test_what_counts_as_a_fixed_sleep(text: str, expected: list[int]) -> None:
    assert lines(sleeps(text)) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("def test():\n    while not done():\n        pass\n", [2]),
        ("def test():\n    while not done():\n        time.sleep(0.1)\n", [2]),
        ("async def test():\n    while not done():\n        await asyncio.sleep(0)\n", [2]),
        ("def test():\n    while True:\n        if done():\n            return\n        time.sleep(1)\n", [2]),
        ("def test():\n    while True:\n        publish()\n        time.sleep(1)\n", []),
        ("def test():\n    while not done():\n        assert time.monotonic() < end\n        sleep(1)\n", []),
        ("async def test():\n    async with asyncio.timeout(60):\n        while not done():\n            pass\n", []),
        ("async def test():\n    while not await line():\n        pass\n", []),
        ("def test():\n    while turn() <= now:\n        turns += 1\n", [2]),
        ("def test():\n    while turn() <= now:\n        if turns > 9:\n            raise AssertionError\n", []),
        ("def test():\n    while took := take():\n        found.append(took)\n", []),
        ("def test():\n    while len(found) < 9:\n        found.append(1)\n", []),
        ("@pytest.mark.simulated_time\nasync def test():\n    while not a:\n        await asyncio.sleep(1)\n", []),
    ],
)
def test_what_counts_as_a_wait_without_an_end(text: str, expected: list[int]) -> None:
    assert lines(polls(text)) == expected


def test_each_wait_has_an_end() -> None:
    """Most are one of tests/benches/waits.py."""
    files = {str(file.relative_to(TESTS)): file.read_text("utf-8") for file in TESTS.rglob("*.py")}
    found = {f"{file} {name}" for file, text in files.items() if "while " in text for _, name in polls(text)}
    assert found == set(POLLS)


def test_a_loop_that_takes_too_many_turns_fails() -> None:
    taken = turns(3)
    assert [next(taken), next(taken), next(taken)] == [1, 2, 3]
    with pytest.raises(AssertionError, match="not within 3 turns"):
        next(taken)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("def test():\n    assert time.monotonic() - began < 1.0\n", [2]),
        ("def test():\n    assert 0.5 < began - monotonic()\n", [2]),
        ("def test():\n    took = time.monotonic() - began\n    assert took < 1.0\n", [3]),
        ("def test():\n    took.append(time.monotonic() - began)\n    assert max(took) < 1.0\n", [3]),
        ("def test():\n    took += time.monotonic() - began\n    print(took)\n", []),
        ("def test():\n    assert time.monotonic() < end\n", []),
        ("@pytest.mark.realtime\ndef test():\n    assert time.monotonic() - began < 1.0\n", []),
    ],
)
def test_what_counts_as_a_question_how_long_it_took(text: str, expected: list[int]) -> None:
    assert lines(elapsed(text)) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("def test():\n    session.get(key, timeout=4.0)\n", [2]),
        ("def test():\n    session.get(key, timeout=60.0)\n", []),
        ("SHORT_S = 0.5\ndef test():\n    session.get(key, timeout=SHORT_S)\n", [3]),
        ("async def test():\n    async with asyncio.timeout(0.2):\n        await heard()\n", [2]),
        ("async def test():\n    await asyncio.wait_for(heard(), 0.2)\n", [2]),
        ("def test():\n    ended.wait(0.1)\n", [2]),
        ("async def test():\n    for _ in range(100):\n        await asyncio.sleep(0)\n", [2]),
        ("@pytest.mark.realtime\ndef test():\n    ended.wait(0.1)\n", []),
    ],
)
def test_what_counts_as_a_pause(text: str, expected: list[int]) -> None:
    assert lines(pauses(text)) == expected


def test_each_short_limit_has_a_reason() -> None:
    files = {str(file.relative_to(TESTS)): file.read_text("utf-8") for file in TESTS.rglob("*.py")}
    word = re.compile(r"\btimeout=|\.timeout\(|\.wait\([^)]|wait_for\(|\.join\([\d.]|sleep\(0")
    suspects = {file: text for file, text in files.items() if word.search(text)}
    assert {f"{file} {name}" for file, text in suspects.items() for _, name in pauses(text)} == set(PAUSES)


def test_no_test_sleeps_for_luck() -> None:
    files = {file: file.read_text("utf-8") for file in TESTS.rglob("test_*.py")}
    assert sum("sleep(" in text for text in files.values()) > 20, "the tests were found"
    found = {str(file.relative_to(TESTS)): where for file, text in files.items() if (where := lines(sleeps(text)))}
    assert found == {}


def test_no_test_outside_the_marks_asks_how_long_something_took() -> None:
    files = {file: file.read_text("utf-8") for file in TESTS.rglob("test_*.py")}
    found = {str(file.relative_to(TESTS)): where for file, text in files.items() if (where := lines(elapsed(text)))}
    assert found == {}


def test_every_bench_that_sleeps_has_a_reason() -> None:
    """A bench sets the pace of what it emulates, on the time of the test that uses it."""
    benches = TESTS / "benches"
    files = {str(file.relative_to(benches)): file.read_text("utf-8") for file in benches.rglob("*.py")}
    assert {f"{file} {name}" for file, text in files.items() for _, name in sleeps(text)} == set(BENCHES)


def test_each_test_in_real_time_states_its_tolerance() -> None:
    found = []
    for file in TESTS.rglob("test_*.py"):
        if "pytest.mark.realtime" not in (text := file.read_text("utf-8")) or file == Path(__file__):
            continue
        tree = ast.parse(text)
        whole = any("realtime" in ast.unparse(node.value) for node in tree.body if isinstance(node, ast.Assign))
        for node in tree.body:
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or not node.name.startswith("test_"):
                continue
            if whole or any("realtime" in ast.unparse(mark) for mark in node.decorator_list):
                said = (ast.get_docstring(node) or "") + (ast.get_docstring(tree) or "") * whole
                found.append((node.name, "Tolerance" in said))
    assert len(found) > 10, "the tests were found"
    assert [name for name, stated in found if not stated] == []
