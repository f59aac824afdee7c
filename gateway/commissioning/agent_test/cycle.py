"""Clauses of the probing cycle. Most of them run or request a cycle."""

import asyncio
import secrets
from collections.abc import Container
from contextlib import suppress

from drivers.agent.greeting import Capability
from drivers.nc import LARGEST_NUMBER, REQUEST_VALID_FOR_S, ProbingState
from gateway.commissioning.agent_test.clause import Clauses, Moves, Trial
from gateway.commissioning.agent_test.connection import (
    BareConnection,
    Broken,
    Told,
    excerpt,
    is_finite_number,
    logged_in,
    three_numbers,
)
from gateway.commissioning.agent_test.offsets import OWNER, SHIFT, claimed, comes, in_force, refused, same, um_text

CYCLE = Clauses()
_PROBE = frozenset({Capability.PROBE})
_WAITING = {ProbingState.REQUESTED, ProbingState.ACCEPTED, ProbingState.RUNNING}
_ENDED = {ProbingState.DONE, ProbingState.REFUSED, ProbingState.FAILED}
_POLL_S = 0.05
_VALID_S = REQUEST_VALID_FOR_S
_HEIGHT_MM = 30.0
_NEAR_MM = 1.0
_HELD_UM = (3.0, -2.0, 1.0)
_LATER_UM = (-3.0, 2.0, -1.0)


def _drawn() -> int:
    """A random number, which has hardly ever been used for a request."""
    return 1 + secrets.randbelow(LARGEST_NUMBER - 1)


async def _status(agent: BareConnection, number: int) -> tuple[ProbingState, dict[str, object]]:
    told = await agent.ask("probing", number=number)
    if not isinstance(told, dict) or told.get("state") not in list(ProbingState):
        raise Broken(f"probing = {excerpt(told)}")
    return ProbingState(told["state"]), told


async def _reaches(
    agent: BareConnection, number: int, states: Container[ProbingState], within_s: float
) -> dict[str, object]:
    loop = asyncio.get_running_loop()
    until = loop.time() + within_s
    while (found := await _status(agent, number))[0] not in states:
        if loop.time() > until:
            raise Broken(f"the state {found[0].value} after {within_s:g} s")
        await asyncio.sleep(_POLL_S)
    return found[1]


@CYCLE.add(_PROBE)
async def an_unknown_number_is_idle(trial: Trial) -> None:
    """`probing` of a number that was never requested is idle; withdrawing it is not an error and changes nothing."""
    async with logged_in(trial.target) as agent:
        number = _drawn()
        for _ in range(2):
            state, _told = await _status(agent, number)
            if state is not ProbingState.IDLE:
                raise Broken(f"the state {state.value}")
            await agent.ask("withdraw", number=number)


@CYCLE.add(_PROBE, Moves.CYCLE)
async def a_request_is_not_displaced(trial: Trial) -> None:
    """While a request waits or runs, another is refused, and its number is idle; a withdrawn request ends and says
    so."""
    async with logged_in(trial.target) as agent:
        number = _drawn()
        await agent.ask("probe", number=number, valid_for_s=_VALID_S)
        try:
            state, _ = await _status(agent, number)
            if state not in _WAITING:
                raise Broken(f"the state {state.value} after the request")
            await refused(agent.ask("probe", number=number + 1, valid_for_s=_VALID_S), "a second request")
            if (state := (await _status(agent, number + 1))[0]) is not ProbingState.IDLE:
                raise Broken(f"the state {state.value} of the second request")
        finally:
            await agent.ask("withdraw", number=number)
        told = await _reaches(agent, number, _ENDED, trial.cycle_limit_s)
        if told["state"] not in (ProbingState.REFUSED, ProbingState.FAILED) or told.get("reason") != "withdrawn":
            raise Broken(f"{excerpt(told)} after it was withdrawn")


@CYCLE.add(_PROBE, Moves.CYCLE)
async def refuses_requests_that_are_no_numbers(trial: Trial) -> None:
    """A request number or a time of validity outside its range, or not a number, is refused; 0 s means no limit."""
    async with logged_in(trial.target) as agent:
        for bad in ("0", "-1", "2147483648", "true", '"7"', "null", "1.5"):
            text = f'{{"do": "probe", "number": {bad}, "valid_for_s": 1}}'
            await refused(agent.ask_text(text), f"number = {bad}")
        for bad in ("-1", "NaN", "Infinity", '"1"', "null"):
            text = f'{{"do": "probe", "number": {_drawn()}, "valid_for_s": {bad}}}'
            await refused(agent.ask_text(text), f"valid_for_s = {bad}")


@CYCLE.add(_PROBE, Moves.CYCLE)
async def a_cycle_ends_with_its_result(trial: Trial) -> None:
    """A cycle runs, `status` shows this, and its result has a centre for each pose, spread and in_force."""
    poses = trial.told.poses
    count = poses if isinstance(poses, int) else len(poses or ())
    async with logged_in(trial.target) as agent:
        number = _drawn()
        await agent.ask("probe", number=number, valid_for_s=trial.cycle_limit_s)
        started = {ProbingState.ACCEPTED, ProbingState.RUNNING, *_ENDED}
        told = await _reaches(agent, number, started, trial.cycle_limit_s)
        status = await agent.ask("status")
        after, _ = await _status(agent, number)
        if after in (ProbingState.ACCEPTED, ProbingState.RUNNING) and status.get("probing") is not True:
            raise Broken(f"probing = {excerpt(status.get('probing'))} in `status` during the cycle")
        told = await _reaches(agent, number, _ENDED, trial.cycle_limit_s)
        if told["state"] != ProbingState.DONE:
            raise Broken(excerpt(told))
        centres = told.get("centres")
        if not isinstance(centres, list) or len(centres) != count:
            raise Broken(f"centres = {excerpt(centres)}, not {count}")
        for centre in centres:
            three_numbers(centre, "centre")
        if not is_finite_number(told.get("spread")):
            raise Broken(f"spread = {excerpt(told.get('spread'))}")
        three_numbers(told.get("in_force"), "in_force")
        await refused(agent.ask("probe", number=number, valid_for_s=_VALID_S), "the last number again")
        if (await _status(agent, number))[1] != told:
            raise Broken("another result when it was asked for again")


@CYCLE.add(_PROBE, Moves.CYCLE, also=frozenset({Capability.DRY_RUN}))
async def a_dry_run_stays_above(trial: Trial) -> None:
    """With `dry_run_mm` the cycle ends with a position for each pose that lies that much higher than the centre which
    the next cycle, a usual one, finds there; impossible heights are refused."""
    async with logged_in(trial.target) as agent:
        for bad in ("-1", "1001", "NaN", "true", '"50"', "null"):
            text = f'{{"do": "probe", "number": {_drawn()}, "valid_for_s": {_VALID_S}, "dry_run_mm": {bad}}}'
            await refused(agent.ask_text(text), f"dry_run_mm = {bad}")
        found = []
        for height in ({"dry_run_mm": _HEIGHT_MM}, {}):
            number = _drawn()
            await agent.ask("probe", number=number, valid_for_s=trial.cycle_limit_s, **height)
            told = await _reaches(agent, number, _ENDED, trial.cycle_limit_s)
            centres = told.get("centres")
            if told["state"] != ProbingState.DONE or not isinstance(centres, list):
                raise Broken(excerpt(told))
            found.append([three_numbers(centre, "centre") for centre in centres])
        for pose, (over, touched) in enumerate(zip(*found, strict=True), start=1):
            if over[2] < touched[2] + _HEIGHT_MM - _NEAR_MM:
                raise Broken(f"Z = {over[2]:g} in the dry run at pose {pose}, {touched[2]:g} in the cycle")


@CYCLE.add(_PROBE, Moves.CYCLE, Moves.OFFSETS, also=SHIFT)
async def nothing_moves_while_probing(trial: Trial) -> None:
    """While a cycle is accepted or running, what is in force does not change, whatever is written; `in_force` reports
    it."""
    async with claimed(trial.target) as agent:
        await agent.ask("write", owner=OWNER, um=list(_HELD_UM))
        await comes(agent, _HELD_UM, trial.target.timeout_s)
        number = _drawn()
        await agent.ask("probe", number=number, valid_for_s=trial.cycle_limit_s)
        loop = asyncio.get_running_loop()
        until, written = loop.time() + trial.cycle_limit_s, False
        while True:
            found = await in_force(agent)
            state, told = await _status(agent, number)  # after `read`: in progress now, it was so before
            if state in _ENDED:
                break
            if not same(found, _HELD_UM):
                raise Broken(f"{um_text(found)} µm in force in the state {state.value}, not {um_text(_HELD_UM)}")
            if state is not ProbingState.REQUESTED and not written:
                written = True
                with suppress(Told):  # to refuse it is right, too
                    await agent.ask("write", owner=OWNER, um=list(_LATER_UM))
            if loop.time() > until:
                raise Broken(f"the state {state.value} after {trial.cycle_limit_s:g} s")
            await agent.ask("heartbeat", owner=OWNER)
            await asyncio.sleep(_POLL_S)
        if state is not ProbingState.DONE or not written:
            raise Broken(f"{excerpt(told)}{'' if written else ', without a time in which it ran'}")
        if not same(stood := three_numbers(told.get("in_force"), "in_force"), _HELD_UM):
            raise Broken(f"in_force = {um_text(stood)} µm, not {um_text(_HELD_UM)}")
