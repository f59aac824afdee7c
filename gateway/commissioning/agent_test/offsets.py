"""Clauses of claim, heartbeat and offsets. Owner numbers are random: a real gateway's claim is never taken."""

import asyncio
import json
import secrets
from collections.abc import AsyncIterator, Awaitable
from contextlib import asynccontextmanager, suppress

from drivers.agent.greeting import Capability
from drivers.nc import LARGEST_NUMBER
from gateway.commissioning.agent_test.clause import Clauses, Moves, Trial
from gateway.commissioning.agent_test.connection import (
    AgentUnderTest,
    BareConnection,
    Broken,
    Told,
    excerpt,
    logged_in,
    three_numbers,
)
from gateway.commissioning.agent_test.login import OFFSET_CAPABILITIES

OFFSET = Clauses()
OWNER = 1 + secrets.randbelow(LARGEST_NUMBER)
_OTHER = 1 + secrets.randbelow(LARGEST_NUMBER)
_THIRD = 1 + secrets.randbelow(LARGEST_NUMBER)
SAME_UM = 0.05
POLL_S = 0.02
_LONG_S = 60.0
_SHORT_S = 1.0
_FAST_UM_PER_S = 20.0
SHIFT = frozenset({Capability.SHIFT})
SPHERE_MM = 120.0


async def refused(work: Awaitable[object], what: str) -> None:
    """Raises Broken if it is not."""
    try:
        answer = await work
    except Told:
        return
    raise Broken(f"{what}: {excerpt(answer)}")


async def in_force(agent: BareConnection) -> tuple[float, float, float]:
    """What `read` says."""
    return three_numbers(await agent.ask("read"), "read")


async def comes(agent: BareConnection, wanted: tuple[float, ...], within_s: float, *, alive: bool = False) -> None:
    """Wait until this is in force; alive: with heartbeats. Raises Broken."""
    loop = asyncio.get_running_loop()
    until = loop.time() + within_s
    while not same(found := await in_force(agent), wanted):
        if loop.time() > until:
            raise Broken(f"{um_text(found)} µm in force after {within_s:g} s, not {um_text(wanted)}")
        if alive:
            await agent.ask("heartbeat", owner=OWNER)
        await asyncio.sleep(POLL_S)


@asynccontextmanager
async def claimed(
    target: AgentUnderTest, silence_s: float = _LONG_S, ramp_um_per_s: float = _FAST_UM_PER_S
) -> AsyncIterator[BareConnection]:
    """A connection whose claim is watched; nothing is in force. At the end it is released, and what was written is
    gone."""
    async with logged_in(target) as agent:
        if not same(found := await in_force(agent), (0.0, 0.0, 0.0)):
            raise Broken(f"{um_text(found)} µm in force before anything was written: wait until it is zero")
        await agent.ask("claim", owner=OWNER, silence_s=silence_s, ramp_um_per_s=ramp_um_per_s)
        await _watched(agent)
        try:
            yield agent
        finally:
            with suppress(Broken, Told):
                await agent.ask("claim", owner=OWNER, silence_s=_LONG_S, ramp_um_per_s=_FAST_UM_PER_S)
            with suppress(Broken, Told):
                await agent.ask("release", owner=OWNER)
                await comes(agent, (0.0, 0.0, 0.0), target.timeout_s)


async def _watched(agent: BareConnection) -> None:
    loop = asyncio.get_running_loop()
    until = loop.time() + agent.target.timeout_s
    while (heard := await agent.ask("heartbeat", owner=OWNER)) is not True:
        if heard is not False or loop.time() > until:
            raise Broken(f"heartbeat = {excerpt(heard)} after the claim, not true within {agent.target.timeout_s:g} s")
        await asyncio.sleep(POLL_S)


def zeros(trial: Trial) -> dict[str, object]:
    """A request that writes nothing, in the form that this agent takes."""
    if Capability.SHIFT in trial.told.can:
        return {"do": "write", "um": [0.0] * 3}
    if Capability.ERRORS in trial.told.can:
        return {"do": "write_errors", "errors": [0.0] * 9, "radius_mm": SPHERE_MM, "bound_um": [0.0] * 3}
    return {"do": "write_slopes", "um": [0.0] * 3, "um_per_mm": [[0.0] * 3] * 3}


def um_text(values: tuple[float, ...]) -> str:
    """In a message."""
    return ", ".join(f"{v:.3f}" for v in values)


def same(found: tuple[float, ...], wanted: tuple[float, ...]) -> bool:
    """Within SAME_UM."""
    return all(abs(a - b) <= SAME_UM for a, b in zip(found, wanted, strict=True))


@OFFSET.add(OFFSET_CAPABILITIES)
async def refuses_offsets_without_a_claim(trial: Trial) -> None:
    """Offsets of a gateway that has not claimed the control are refused."""
    async with logged_in(trial.target) as agent:
        await refused(agent.ask_text(json.dumps(zeros(trial) | {"owner": _OTHER})), "written")
        await refused(agent.ask_text(json.dumps(zeros(trial))), "written without an owner")
        await refused(agent.ask("heartbeat", owner=_OTHER), "a heartbeat without a claim")


@OFFSET.add(OFFSET_CAPABILITIES)
async def watches_after_a_claim(trial: Trial) -> None:
    """After a claim, heartbeats are answered with true, and offsets of this gateway are accepted."""
    async with claimed(trial.target) as agent:
        await agent.ask_text(json.dumps(zeros(trial) | {"owner": OWNER}))


@OFFSET.add(OFFSET_CAPABILITIES)
async def refuses_a_second_gateway(trial: Trial) -> None:
    """While the owner is alive, claim, heartbeat and offsets of another are refused, even with a wrong predecessor."""
    async with claimed(trial.target) as agent:
        terms = {"silence_s": _LONG_S, "ramp_um_per_s": 1.0}
        await refused(agent.ask("claim", owner=_OTHER, **terms), "a second claim")
        await refused(agent.ask("claim", owner=_OTHER, predecessor=_THIRD, **terms), "with a wrong predecessor")
        await refused(agent.ask("heartbeat", owner=_OTHER), "the other's heartbeat")
        await refused(agent.ask_text(json.dumps(zeros(trial) | {"owner": _OTHER})), "the other's offsets")
        if await agent.ask("heartbeat", owner=OWNER) is not True:
            raise Broken("the owner lost its claim")


@OFFSET.add(OFFSET_CAPABILITIES)
async def hands_over_to_the_next_run(trial: Trial) -> None:
    """A claim with the owner's number as its predecessor is accepted, and ends the owner's."""
    async with claimed(trial.target) as agent:
        await agent.ask("claim", owner=_OTHER, predecessor=OWNER, silence_s=_LONG_S, ramp_um_per_s=1.0)
        await refused(agent.ask("heartbeat", owner=OWNER), "the former owner's heartbeat")
        await agent.ask("claim", owner=OWNER, predecessor=_OTHER, silence_s=_LONG_S, ramp_um_per_s=1.0)


@OFFSET.add(OFFSET_CAPABILITIES)
async def ignores_the_release_of_another(trial: Trial) -> None:
    """`release` by another owner is not an error and changes nothing."""
    async with claimed(trial.target) as agent:
        await agent.ask("release", owner=_OTHER)
        if await agent.ask("heartbeat", owner=OWNER) is not True:
            raise Broken("the owner's claim ended")


@OFFSET.add(OFFSET_CAPABILITIES)
async def ends_the_claim_at_its_release(trial: Trial) -> None:
    """After its release the control is free, and offsets are refused."""
    async with claimed(trial.target) as agent:
        await agent.ask("release", owner=OWNER)
        await refused(agent.ask_text(json.dumps(zeros(trial) | {"owner": OWNER})), "written after the release")
        await agent.ask("claim", owner=_OTHER, silence_s=_LONG_S, ramp_um_per_s=1.0)
        await agent.ask("release", owner=_OTHER)


@OFFSET.add(OFFSET_CAPABILITIES)
async def notices_silence(trial: Trial) -> None:
    """After silence_s without a heartbeat, offsets are refused; the next heartbeat is answered with false, then
    true."""
    async with claimed(trial.target, _SHORT_S) as agent:
        await asyncio.sleep(1.5 * _SHORT_S)
        await refused(agent.ask_text(json.dumps(zeros(trial) | {"owner": OWNER})), "written after silence")
        if (heard := await agent.ask("heartbeat", owner=OWNER)) is not False:
            raise Broken(f"heartbeat = {excerpt(heard)} after {1.5 * _SHORT_S:g} s of silence")
        await _watched(agent)


@OFFSET.add(OFFSET_CAPABILITIES)
async def frees_the_control_after_silence(trial: Trial) -> None:
    """After silence_s another gateway may claim the control."""
    async with claimed(trial.target, _SHORT_S) as agent:
        await asyncio.sleep(1.5 * _SHORT_S)
        await agent.ask("claim", owner=_OTHER, silence_s=_LONG_S, ramp_um_per_s=1.0)
        await agent.ask("release", owner=_OTHER)


@OFFSET.add(OFFSET_CAPABILITIES)
async def refuses_what_is_no_number(trial: Trial) -> None:
    """Owners and times that are not finite numbers in their range, and too few or too many offsets, are refused."""
    async with claimed(trial.target) as agent:
        for bad in ("0", "-1", "2147483648", "true", '"7"', "null", "1.5", "1e400"):
            await refused(agent.ask_text(f'{{"do": "heartbeat", "owner": {bad}}}'), f"owner = {bad}")
        for bad in ("0", "-1", "NaN", "Infinity", "1e400", '"1"', "null", "9" * 400):
            text = f'{{"do": "claim", "owner": {OWNER}, "silence_s": {bad}, "ramp_um_per_s": 1}}'
            await refused(agent.ask_text(text), f"silence_s = {bad}")
        for bad in ("-1", "NaN", "Infinity", '"1"', "null"):
            text = f'{{"do": "claim", "owner": {OWNER}, "silence_s": {_LONG_S}, "ramp_um_per_s": {bad}}}'
            await refused(agent.ask_text(text), f"ramp_um_per_s = {bad}")
        it, name, right = _offsets(trial)
        for values in (right[1:], [*right, 0.0], 0.0, None, "0", [*right[1:], None], [*right[1:], "0"]):
            await refused(agent.ask_text(json.dumps(it | {name: values})), f"{name} = {excerpt(values)}")
        if not same(found := await in_force(agent), (0.0, 0.0, 0.0)):
            raise Broken(f"{um_text(found)} µm in force afterwards")


def _offsets(trial: Trial) -> tuple[dict[str, object], str, list[float]]:
    """A request by the owner, the key of its offsets, and valid offsets."""
    it = zeros(trial) | {"owner": OWNER}
    return (it, "errors", [0.0] * 9) if "errors" in it else (it, "um", [0.0] * 3)


@OFFSET.add(OFFSET_CAPABILITIES)
async def refuses_offsets_in_a_later_connection(trial: Trial) -> None:
    """A claim belongs to the owner, not to the connection: another owner is refused while it is alive."""
    async with logged_in(trial.target) as agent:
        await agent.ask("claim", owner=OWNER, silence_s=_LONG_S, ramp_um_per_s=1.0)
    async with logged_in(trial.target) as agent:
        await refused(agent.ask("claim", owner=_OTHER, silence_s=_LONG_S, ramp_um_per_s=1.0), "a second claim")
        await agent.ask("claim", owner=OWNER, silence_s=_LONG_S, ramp_um_per_s=1.0)
        await agent.ask("release", owner=OWNER)


# What follows moves the tool, by 5 µm at most; an agent that accepts what it must refuse may move it to its bound.


@OFFSET.add(OFFSET_CAPABILITIES, Moves.OFFSETS)
async def refuses_offsets_that_are_no_numbers(trial: Trial) -> None:
    """Offsets that are not finite numbers (NaN, Infinity, 1e400, true, 400 digits) are refused and change nothing."""
    async with claimed(trial.target) as agent:
        it, name, right = _offsets(trial)
        for bad in ("NaN", "Infinity", "-Infinity", "1e400", "true", "[]", "9" * 400):
            text = json.dumps(it | {name: [*right[1:], "BAD"]}).replace('"BAD"', bad)
            await refused(agent.ask_text(text), f"{name} with {excerpt(bad.encode())}")
        if not same(found := await in_force(agent), (0.0, 0.0, 0.0)):
            raise Broken(f"{um_text(found)} µm in force afterwards")


@OFFSET.add(SHIFT, Moves.OFFSETS)
async def offsets_come_into_force(trial: Trial) -> None:
    """`write` takes effect within the timeout: `read` shows offsets on the straight way to it, and never beyond."""
    async with claimed(trial.target) as agent:
        wanted = (2.0, -1.0, 0.5)
        await agent.ask("write", owner=OWNER, um=list(wanted))
        loop = asyncio.get_running_loop()
        until = loop.time() + trial.target.timeout_s
        while not same(found := await in_force(agent), wanted):
            if loop.time() > until:
                raise Broken(f"{um_text(found)} µm in force, not {um_text(wanted)}")
            for now, end in zip(found, wanted, strict=True):
                if not min(0.0, end) - SAME_UM <= now <= max(0.0, end) + SAME_UM:
                    raise Broken(f"{um_text(found)} µm in force on the way from zero to {um_text(wanted)}")
            await asyncio.sleep(POLL_S)


@OFFSET.add(SHIFT, Moves.OFFSETS)
async def refuses_offsets_beyond_its_bound(trial: Trial) -> None:
    """An offset beyond bound_um of the greeting, on any axis and to either side, is refused and changes nothing."""
    most = float(str(trial.greeting["bound_um"])) * 1.01
    async with claimed(trial.target) as agent:
        for axis in range(3):
            for value in (most, -most):
                um = [value if i == axis else 0.0 for i in range(3)]
                try:
                    await agent.ask("write", owner=OWNER, um=um)
                except Told:
                    continue
                await agent.ask("write", owner=OWNER, um=[0.0] * 3)
                raise Broken(f"um = {um} was accepted, and taken back at once")


async def _written(agent: BareConnection, wanted: tuple[float, float, float]) -> None:
    """In force, and a heartbeat has just been sent: a control whose slew is small takes longer than silence_s."""
    await agent.ask("heartbeat", owner=OWNER)
    await agent.ask("write", owner=OWNER, um=list(wanted))
    await comes(agent, wanted, agent.target.timeout_s, alive=True)
    await agent.ask("heartbeat", owner=OWNER)


@OFFSET.add(SHIFT, Moves.OFFSETS)
async def silence_takes_offsets_to_zero(trial: Trial) -> None:
    """After silence_s without a heartbeat, and not much earlier, the offsets in force go to zero at the claimed
    rate."""
    loop = asyncio.get_running_loop()
    async with claimed(trial.target, _SHORT_S) as agent:
        await _written(agent, (2.0, 0.0, -1.0))
        last = loop.time()
        await asyncio.sleep(0.3 * _SHORT_S)
        found = await in_force(agent)
        if loop.time() - last < 0.6 * _SHORT_S and not same(found, (2.0, 0.0, -1.0)):
            raise Broken(f"{um_text(found)} µm in force {loop.time() - last:.1f} s after a heartbeat")
        await comes(agent, (0.0, 0.0, 0.0), _SHORT_S + 2.0 / _FAST_UM_PER_S + trial.target.timeout_s)


@OFFSET.add(SHIFT, Moves.OFFSETS)
async def a_cut_connection_takes_offsets_to_zero(trial: Trial) -> None:
    """The same when the connection is gone."""
    async with claimed(trial.target, _SHORT_S) as agent:
        await _written(agent, (2.0, 0.0, -1.0))
        await agent.close()
        await asyncio.sleep(_SHORT_S + 2.0 / _FAST_UM_PER_S)
        async with logged_in(trial.target) as another:
            await comes(another, (0.0, 0.0, 0.0), trial.target.timeout_s)


@OFFSET.add(SHIFT, Moves.OFFSETS)
async def release_takes_offsets_to_zero(trial: Trial) -> None:
    """`release` has at once the effect of silence."""
    async with claimed(trial.target) as agent:
        await _written(agent, (2.0, 0.0, -1.0))
        await agent.ask("release", owner=OWNER)
        await comes(agent, (0.0, 0.0, 0.0), 2.0 / _FAST_UM_PER_S + trial.target.timeout_s)


@OFFSET.add(SHIFT, Moves.OFFSETS)
async def a_claim_brings_nothing_back(trial: Trial) -> None:
    """Offsets that silence or a release has taken to zero stay at zero when the control is claimed again."""
    async with claimed(trial.target, _SHORT_S) as agent:
        for ends in ("silence", "a release"):
            await _written(agent, (2.0, 0.0, -1.0))
            if ends == "a release":
                await agent.ask("release", owner=OWNER)
            await comes(agent, (0.0, 0.0, 0.0), _SHORT_S + 2.0 / _FAST_UM_PER_S + trial.target.timeout_s)
            await agent.ask("claim", owner=OWNER, silence_s=_LONG_S, ramp_um_per_s=_FAST_UM_PER_S)
            for _ in range(5):
                await _watched(agent)
                await asyncio.sleep(0.1)
                if not same(found := await in_force(agent), (0.0, 0.0, 0.0)):
                    raise Broken(f"{um_text(found)} µm in force after {ends} and a claim")


@OFFSET.add(SHIFT, Moves.OFFSETS)
async def a_rate_of_zero_holds(trial: Trial) -> None:
    """With ramp_um_per_s = 0, silence leaves the offsets in force."""
    async with claimed(trial.target, _SHORT_S, 0.0) as agent:
        await _written(agent, (2.0, 0.0, -1.0))
        await asyncio.sleep(2.0 * _SHORT_S)
        if not same(found := await in_force(agent), (2.0, 0.0, -1.0)):
            raise Broken(f"{um_text(found)} µm in force after {2.0 * _SHORT_S:g} s")


@OFFSET.add(SHIFT, Moves.OFFSETS)
async def a_heartbeat_ends_the_ramp(trial: Trial) -> None:
    """A heartbeat during the ramp to zero stops it where it is; the offsets do not go back by themselves."""
    async with claimed(trial.target, _SHORT_S, 0.5) as agent:
        await _written(agent, (4.0, 0.0, 0.0))
        loop = asyncio.get_running_loop()
        until = loop.time() + _SHORT_S + 1.0 + trial.target.timeout_s
        while (await in_force(agent))[0] > 3.8:
            if loop.time() > until:
                raise Broken("no ramp after silence")
            await asyncio.sleep(POLL_S)
        await agent.ask("heartbeat", owner=OWNER)
        stood = (await in_force(agent))[0]
        for _ in range(5):
            await asyncio.sleep(0.1)
            await agent.ask("heartbeat", owner=OWNER)
            if (now := (await in_force(agent))[0]) > stood + SAME_UM:
                raise Broken(f"X went back from {stood:.3f} to {now:.3f} µm")
