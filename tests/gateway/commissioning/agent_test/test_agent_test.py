"""`talc-gateway agent-test`: right agents pass every clause, a wrong one fails the clause about its fault."""

import asyncio
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.commissioning.agent_test.clause import ClauseOutcome, ClauseResult, Moves
from gateway.commissioning.agent_test.clauses import CLAUSES, run_clauses
from gateway.commissioning.agent_test.connection import AgentUnderTest, Unreachable
from talc import kinematics
from tests.benches.reference_agent import FILE, KEY, REFERENCE, served_agent, spoilt_reference

# Machines for the reference agent that take the nine errors or slopes; each can be wrong in one way.


TIP_MM, A_DEG, RADIUS_MM = (100.0, 50.0, 30.0), 20.0, 120.0


def errors_machine(wrong: str = "") -> Any:
    """Takes the nine errors at its radius. wrong: `sign`, `radius` or `bound`."""

    class ErrorsMachine(REFERENCE.Machine):  # type: ignore[misc]
        verbs = (*REFERENCE.Machine.verbs, "errors", "write_errors")

        def __init__(self) -> None:
            super().__init__()
            self.greeting |= {"capabilities": ["shift", "errors"], "reach_mm": [300.0, 400.0]}
            self.um, self.wanted, self.bound = [0.0] * 9, [0.0] * 9, [200.0] * 3

        def status(self, it: object) -> Any:
            told = super().status(it)
            told["positions"]["A"] = A_DEG
            return told

        def read(self, _: object) -> list[float]:
            errors = np.array(self.um)
            if wrong == "sign":
                errors[7] = -errors[7]
            at = np.array([*TIP_MM, math.radians(A_DEG), 0.0])
            shift = kinematics.tcp_offsets(errors, at, RADIUS_MM * 1e-3)
            return [
                float(v) for v in (shift if wrong == "bound" else np.clip(shift, -np.array(self.bound), self.bound))
            ]

        def write(self, it: dict[str, Any]) -> None:
            super().write(it)
            x, y, z = self.wanted
            self.wanted, self.bound = [y, z, x] + [0.0] * 6, [200.0] * 3

        def errors(self, it: dict[str, Any]) -> list[float]:
            share = 1.0 if wrong == "radius" else it["radius_mm"] / RADIUS_MM
            return [v * share if i == 5 else v for i, v in enumerate(self.um)]

        def write_errors(self, it: dict[str, Any]) -> None:
            super().write(it | {"um": it["bound_um"]})
            wanted = [REFERENCE.number({"v": v}, "v", -1e3, 1e3) for v in it["errors"]]
            if len(wanted) != 9:
                raise REFERENCE.Refusal("errors: expected nine")
            wanted[5] *= RADIUS_MM / it["radius_mm"]
            self.wanted, self.bound = wanted, it["bound_um"]

    return ErrorsMachine()


def slopes_machine(wrong: str = "") -> Any:
    """Takes the slopes of X by X and Y by X. wrong: `axis`."""
    reference, reach = np.array([10.0, 0.0, 0.0]), np.array([300.0, 200.0, 100.0])

    class SlopesMachine(REFERENCE.Machine):  # type: ignore[misc]
        verbs = (*REFERENCE.Machine.verbs, "slopes", "write_slopes")

        def __init__(self) -> None:
            super().__init__()
            travel = {"pairs": ["XX", "YX"], "reference_mm": list(reference), "reach_mm": list(reach)}
            self.greeting |= {"capabilities": ["slopes"], "travel": travel}
            self.um, self.wanted = [0.0] * 12, [0.0] * 12

        def read(self, _: object) -> list[float]:
            k0, slopes = np.array(self.um[:3]), np.array(self.um[3:]).reshape(3, 3)
            if wrong == "axis":
                slopes = slopes.T
            return [float(v) for v in k0 + slopes @ (np.array(TIP_MM) - reference)]

        def slopes(self, _: object) -> dict[str, Any]:
            return {"um": self.um[:3], "um_per_mm": [self.um[3:6], self.um[6:9], self.um[9:]]}

        def write_slopes(self, it: dict[str, Any]) -> None:
            super().write(it)
            self.wanted = [*self.wanted, *(float(v) for row in it["um_per_mm"] for v in row)]

    return SlopesMachine()


EVERYTHING = (Moves.OFFSETS, Moves.CYCLE)


async def tried(machine: Any, *only: str, module: Any = REFERENCE) -> list[ClauseOutcome]:
    """The outcomes of these clauses, or of all."""
    async with served_agent(machine, module) as served:
        target = AgentUnderTest("127.0.0.1", served.port, KEY)
        return [outcome async for outcome in run_clauses(target, EVERYTHING, only, cycle_limit_s=30.0)]


@pytest.mark.simulated_time
async def test_the_reference_agent_passes_every_clause_that_it_offers() -> None:
    outcomes = await tried(REFERENCE.Machine())
    assert [o for o in outcomes if o.result is ClauseResult.FAILED] == []
    assert {o.clause.name for o in outcomes if o.result is ClauseResult.NOT_OFFERED} == {
        "errors-come-into-force",
        "errors-become-the-shift-at-the-tool",
        "a-bound-limits-the-shift-and-not-the-errors",
        "slopes-come-into-force",
        "serves-clients-that-only-read",
        "names-the-values-that-it-does-not-have",
    }
    assert len(outcomes) == len(CLAUSES) == 47


@pytest.mark.slow
@pytest.mark.simulated_time
@pytest.mark.parametrize("make", [errors_machine, slopes_machine])
async def test_agents_that_take_errors_or_slopes_pass_every_clause_that_they_offer(make: Any) -> None:
    outcomes = await tried(make())
    assert [o for o in outcomes if o.result is ClauseResult.FAILED] == []
    assert len([o for o in outcomes if o.result is ClauseResult.PASSED]) > 25


@pytest.mark.simulated_time
async def test_nothing_that_moves_is_asked_unless_it_is_allowed() -> None:
    asked = []

    class Listening(REFERENCE.Machine):  # type: ignore[misc]
        def write(self, it: dict[str, Any]) -> None:
            um = it.get("um")
            asked.append(um)
            super().write(it)

        def probe(self, it: object) -> None:
            asked.append("cycle")
            super().probe(it)

    machine = Listening()
    async with served_agent(machine) as served:
        outcomes = [o async for o in run_clauses(AgentUnderTest("127.0.0.1", served.port, KEY))]
    moving = [o for o in outcomes if o.clause.moves and o.result is not ClauseResult.NOT_OFFERED]
    assert {o.result for o in moving} == {ClauseResult.NOT_RUN}
    assert "cycle" not in asked
    assert asked
    assert all(not v for um in asked if isinstance(um, list) for v in um if isinstance(v, float) and v == v)
    assert machine.um == [0.0] * 3


WRONG: list[tuple[str, str, str]] = [
    ("greets-with-a-challenge", "secrets.token_hex(32)", '"0" * 64'),
    ("greets-with-a-challenge", "secrets.token_hex(32)", "secrets.token_hex(4)"),
    ("refuses-another-key", "if not hmac.compare_digest(", "if session and not hmac.compare_digest("),
    ("refuses-commands-before-the-login", "if not hmac.compare_digest(", "if session and not hmac.compare_digest("),
    ("refuses-a-login-that-was-heard-before", "secrets.token_hex(32)", '"0" * 64'),
    ("ends-at-a-wrong-signature", 'n, text), mac)', 'n, text)[1:], mac[1:])'),
    ("ends-at-an-unsigned-line", "if not hmac.compare_digest(", "if len(mac) == 64 and not hmac.compare_digest("),
    ("ends-at-a-repeated-line", '"client", n, text', '"client", min(n, 1), text'),
    ("ends-at-an-endless-line", "3.0, 4096", "3.0, 10**6"),
    ("signs-its-errors-and-stays", "except (Refusal, ValueError, TypeError, RecursionError) as", "except Refusal as"),
    ("signs-its-errors-and-stays", 'return {"error": str(error)}', 'return {"answer": None}'),
    ("takes-lines-in-pieces-and-several-at-once", 'reader.readuntil(b"\\n")', "reader.read(4096)"),
    ("serves-one-client", "if time.monotonic() - self.heard_s < QUIET_S:", "if False:"),
    ("replaces-a-silent-client", "if time.monotonic() - self.heard_s < QUIET_S:", "if True:"),
    ("lets-the-key-in-past-strangers", "challenge, session, n = ", "self.most = getattr(self, 'most', 20) - 1\n"
     "        if self.most < 0:\n            return writer.close()\n        challenge, session, n = "),
    ("ends-connections-that-do-not-log-in", "None if session else LOGIN_S", "None"),
    ("greeting-is-complete", '"version": 3', '"version": 2'),
    ("greeting-is-complete", '"poses": POSES, ', ""),
    ("greeting-is-complete", '"bound_um": BOUND_UM', '"bound_um": None'),
    ("status-is-complete", '"C": 0.0}', '"C": float("nan")}'),
    ("status-is-complete", '"X": 100.0', '"X": 1e300'),
    ("status-is-complete", '"probe": False', '"probe": 0'),
    ("status-is-complete", '"estop": False, ', ""),
    ("status-is-complete", '"mode": "auto"', '"mode": "automatic"'),
    ("refuses-offsets-without-a-claim", ' or not self.watching() or it.get("owner") != self.owner', ""),
    ("watches-after-a-claim", "return was", "return None"),
    ("watches-after-a-claim", "return was", "return False"),
    ("refuses-a-second-gateway", "if self.watching() and self.owner not in", "if False and self.owner not in"),
    ("refuses-a-second-gateway", '(owner, it.get("predecessor"))', '(owner, "predecessor" in it and self.owner)'),
    ("refuses-a-second-gateway", ' or it.get("owner") != self.owner', ""),
    ("hands-over-to-the-next-run", '(owner, it.get("predecessor"))', "(owner,)"),
    ("ignores-the-release-of-another", 'number(it, "owner") == self.owner else', "True else"),
    ("ends-the-claim-at-its-release", "self.owner = 0 if", "self.owner = self.owner if"),
    ("notices-silence", "time.monotonic() - self.beat_s < self.silence", "True"),
    ("frees-the-control-after-silence", "if self.watching() and self.owner not", "if self.owner and self.owner not"),
    ("refuses-what-is-no-number", " or not low <= value <= high", ""),
    ("refuses-what-is-no-number", "len(um) != 3 or", ""),
    ("refuses-offsets-that-are-no-numbers", "not low <= value <= high", "value < low or value > high"),
    ("refuses-offsets-that-are-no-numbers", '"um", -BOUND_UM, BOUND_UM', '"um", -math.inf, math.inf'),
    ("refuses-offsets-in-a-later-connection", "            writer.close()", "            writer.close()\n"
     "            self.machine.owner = 0"),
    ("offsets-come-into-force", "return self.um\n", "return [-v for v in self.um]\n"),
    ("offsets-come-into-force", "self.wanted = um", "self.um = [2 * v for v in um]\n        self.wanted = um"),
    ("offsets-come-into-force", "self.wanted = um", "pass"),
    ("refuses-offsets-beyond-its-bound", '"um", -BOUND_UM, BOUND_UM', '"um", -1e9, BOUND_UM'),
    ("silence-takes-offsets-to-zero", "min(self.ramp, rate)", "0.0"),
    ("silence-takes-offsets-to-zero", "self.beat_s < self.silence", "self.beat_s < self.silence / 5"),
    ("a-cut-connection-takes-offsets-to-zero", "            writer.close()", "            writer.close()\n"
     "            self.machine.beat_s = math.inf"),
    ("release-takes-offsets-to-zero", "self.owner = 0 if", "self.ramp = 0.0\n        self.owner = 0 if"),
    ("a-claim-brings-nothing-back", "self.wanted = list(self.um)", "pass"),
    ("a-claim-brings-nothing-back", "self.beat()  # by", "self.beat_s = time.monotonic()  # by"),
    ("a-rate-of-zero-holds", "min(self.ramp, rate)", "rate"),
    ("a-heartbeat-ends-the-ramp", "self.wanted = list(self.um)", "pass"),
    ("an-unknown-number-is-idle", '{"state": "idle"', '{"state": "done"'),
    ("a-request-is-not-displaced", "if self.state in NEXT or asked == self.number", "if asked == self.number"),
    ("a-request-is-not-displaced", '"withdrawn"', '"stopped"'),
    ("refuses-requests-that-are-no-numbers", "type(value) not in ((int,) if low == 1 else (int, float)) or", ""),
    ("nothing-moves-while-probing", 'if self.state not in ("accepted", "running"):  # n', "if True:  # n"),
    ("nothing-moves-while-probing", '"in_force": self.held', '"in_force": self.wanted'),
    ("nothing-moves-while-probing", "self.held = self.read({})", "self.held = self.um = [0.0] * 3"),
    ("a-cycle-ends-with-its-result", '"probing": self.state in ("accepted", "running")', '"probing": False'),
    ("a-cycle-ends-with-its-result", '"spread": 0.0, ', ""),
    ("a-cycle-ends-with-its-result", '"centres": centres', '"centres": centres[1:]'),
    ("a-cycle-ends-with-its-result", " or asked == self.number", ""),
    ("a-cycle-ends-with-its-result", '"done" if self.touched == len(POSES) else NEXT[self.state]', "NEXT[self.state]"),
    ("a-dry-run-stays-above", "z + self.raised_mm", "z"),
    ("a-dry-run-stays-above", '"", 0, raised_mm', '"", 0, max(self.raised_mm, raised_mm)'),
    ("a-dry-run-stays-above", '"dry_run_mm", 0, 1000', '"dry_run_mm", -1e9, 1e9'),
]  # fmt: skip
QUICK = {"ends-at-a-repeated-line", "refuses-a-second-gateway", "status-is-complete"}


def wrong_agents() -> list[Any]:
    """The quick ones of them in every run."""
    return [
        pytest.param(*row, id=f"{row[0]} {number}", marks=[] if row[0] in QUICK else pytest.mark.slow)
        for number, row in enumerate(WRONG)
    ]


@pytest.mark.simulated_time
@pytest.mark.parametrize(("clause", "old", "new"), wrong_agents())
async def test_a_wrong_agent_is_caught_by_the_clause_that_names_it(clause: str, old: str, new: str) -> None:
    module = spoilt_reference((old, new))
    (outcome,) = await tried(module.Machine(), clause, module=module)
    assert outcome.clause.name == clause
    assert outcome.result is ClauseResult.FAILED
    assert outcome.came
    assert outcome.clause.expected


@pytest.mark.simulated_time
async def test_numbers_longer_than_any_float_fail_their_clause_and_not_the_test() -> None:
    class Endless(REFERENCE.Machine):  # type: ignore[misc]
        def read(self, _: object) -> list[int]:
            return [10**400, 0, 0]

        def status(self, it: object) -> Any:
            return super().status(it) | {"states": {"coolant": 10**400}}

    for clause in ("status-is-complete", "watches-after-a-claim"):
        (outcome,) = await tried(Endless(), clause)
        assert outcome.result is ClauseResult.FAILED, outcome


@pytest.mark.simulated_time
async def test_a_right_agent_may_slew_more_slowly_than_it_is_silent() -> None:
    module = spoilt_reference(
        ("SLEW_UM_PER_S, TICK_S, POSE_S = 200.0, 20.0", "SLEW_UM_PER_S, TICK_S, POSE_S = 200.0, 1.5")
    )
    (outcome,) = await tried(module.Machine(), "silence-takes-offsets-to-zero", module=module)
    assert outcome.result is ClauseResult.PASSED, outcome.came


@pytest.mark.slow
@pytest.mark.simulated_time
@pytest.mark.parametrize(
    ("clause", "machine"),
    [
        ("errors-become-the-shift-at-the-tool", lambda: errors_machine("sign")),
        ("errors-come-into-force", lambda: errors_machine("radius")),
        ("a-bound-limits-the-shift-and-not-the-errors", lambda: errors_machine("bound")),
        ("slopes-come-into-force", lambda: slopes_machine("axis")),
    ],
)
async def test_a_wrong_shift_of_errors_or_slopes_is_caught(clause: str, machine: Any) -> None:
    (outcome,) = await tried(machine(), clause)
    assert outcome.result is ClauseResult.FAILED, outcome


def test_every_clause_is_tried_by_a_wrong_agent() -> None:
    tables = {clause for clause, _, _ in WRONG} | {
        "errors-become-the-shift-at-the-tool",
        "errors-come-into-force",
        "a-bound-limits-the-shift-and-not-the-errors",
        "slopes-come-into-force",
    }
    tables |= {"serves-clients-that-only-read", "names-the-values-that-it-does-not-have"}  # test_agent_test_values
    assert tables == {clause.name for clause in CLAUSES}


@pytest.mark.simulated_time
async def test_without_an_agent_or_with_another_key_nothing_is_tried() -> None:
    async with served_agent(REFERENCE.Machine()) as served:
        with pytest.raises(Unreachable, match="the proof does not fit"):
            await anext(run_clauses(AgentUnderTest("127.0.0.1", served.port, b"x" * 32)))
    with pytest.raises(Unreachable, match=f"127.0.0.1:{served.port}"):
        await anext(run_clauses(AgentUnderTest("127.0.0.1", served.port, KEY)))


async def commanded(port: int, folder: Path, *options: str) -> tuple[int, str]:
    """Exit code and output of the command, run in a separate process."""
    (folder / "key").write_bytes(KEY)
    command = ("-m", "gateway", "agent-test", "127.0.0.1", "--port", str(port), "--key-file", str(folder / "key"))
    process = await asyncio.create_subprocess_exec(
        sys.executable, *command, "--timeout", "60", *options, stdout=asyncio.subprocess.PIPE
    )
    said, _ = await process.communicate()
    assert process.returncode is not None
    return process.returncode, said.decode()


@pytest.mark.slow
async def test_the_command_prints_each_clause_and_its_code_says_whether_all_hold(tmp_path: Path) -> None:
    names = ("status-is-complete", "offsets-come-into-force", "slopes-come-into-force")
    only = [word for name in names for word in ("--only", name)]
    async with served_agent(REFERENCE.Machine()) as served:
        code, said = await commanded(served.port, tmp_path, *only)
    lines = [line.split(maxsplit=1) for line in said.splitlines()]
    assert lines[:-1] == [[names[0], "passed"], [names[1], "not run"], [names[2], "not offered"]]
    assert said.endswith("1 passed, 1 not offered, 1 not run\n")
    assert code == 0
    spoilt = spoilt_reference(('"mode": "auto"', '"mode": "automatic"'))
    async with served_agent(spoilt.Machine(), spoilt) as served:
        code, said = await commanded(served.port, tmp_path, *only)
    assert code == 1
    assert "expected: `status` contains" in said
    assert 'came: mode = "automatic"' in said


def test_a_clause_that_does_not_exist_is_named_with_the_nearest(tmp_path: Path) -> None:
    (tmp_path / "key").write_bytes(KEY)
    arguments = ["agent-test", "127.0.0.1", "--key-file", str(tmp_path / "key"), "--only", "notices-silense"]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 2
    assert "did you mean 'notices-silence'?" in done.output


@pytest.mark.parametrize("command", [("agent-test", "--key-file", "key"), ("scan", "tcp"), ("inspect", "registers")])
def test_a_name_that_no_host_can_have_is_refused(
    command: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "key").write_bytes(KEY)
    span = ("0-3",) if command[0] == "inspect" else ()
    done = CliRunner().invoke(main, [*command, "192.168.0..30", *span])
    assert done.exit_code == 2
    assert "'192.168.0..30': expected the name or address of a host" in done.output


def test_the_reference_agent_needs_the_standard_library_alone() -> None:
    lines = FILE.read_text(encoding="utf-8").splitlines()
    imported = {line.split()[1].split(".")[0] for line in lines if line.startswith(("import ", "from "))}
    assert imported <= sys.stdlib_module_names
