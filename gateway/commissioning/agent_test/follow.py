"""Clauses of what a control computes itself where its tool is: from nine errors, or from slopes. They move the tool."""

import asyncio
from collections.abc import Awaitable, Callable

import numpy as np

from drivers.agent.greeting import Capability
from gateway.commissioning.agent_test.clause import Clauses, Moves, Trial
from gateway.commissioning.agent_test.connection import BareConnection, Broken, excerpt
from gateway.commissioning.agent_test.offsets import (
    OWNER,
    POLL_S,
    SAME_UM,
    SPHERE_MM,
    claimed,
    comes,
    in_force,
    same,
    um_text,
)
from talc import kinematics

FOLLOW = Clauses()
_ERRORS = frozenset({Capability.ERRORS})
_SLOPES = frozenset({Capability.SLOPES})
_WARM = (1.0, -0.8, 0.6, 0.5, -0.4, 0.7, 3.0, -4.0, 5.0)
"""Nine errors, µm and µm/m, that differ."""


async def _errors(agent: BareConnection, bound_um: float) -> None:
    await agent.ask("write_errors", owner=OWNER, errors=list(_WARM), radius_mm=SPHERE_MM, bound_um=[bound_um] * 3)
    await _settles(agent, lambda: agent.ask("errors", radius_mm=SPHERE_MM), _WARM, "errors")


async def _settles(
    agent: BareConnection, read: Callable[[], Awaitable[object]], wanted: tuple[float, ...], what: str
) -> None:
    loop = asyncio.get_running_loop()
    until = loop.time() + agent.target.timeout_s
    while True:
        found = await read()
        if not isinstance(found, list) or len(found) != len(wanted):
            raise Broken(f"{what} = {excerpt(found)}, not {len(wanted)} numbers")
        if same(tuple(found), wanted):
            return
        if loop.time() > until:
            raise Broken(f"{what} = {um_text(tuple(found))}, not {um_text(wanted)}")
        await asyncio.sleep(POLL_S)


@FOLLOW.add(_ERRORS, Moves.OFFSETS)
async def errors_come_into_force(trial: Trial) -> None:
    """`write_errors` comes into force; at twice the radius ER0T is twice as large, and the others are the same."""
    async with claimed(trial.target) as agent:
        await _errors(agent, 5.0)
        far = tuple(2.0 * v if i == 5 else v for i, v in enumerate(_WARM))
        await _settles(agent, lambda: agent.ask("errors", radius_mm=2.0 * SPHERE_MM), far, "errors at twice the radius")


@FOLLOW.add(_ERRORS, Moves.OFFSETS)
async def errors_become_the_shift_at_the_tool(trial: Trial) -> None:
    """With nine errors in force `read` is the shift of docs/agent.md at the tip's position."""
    async with claimed(trial.target) as agent:
        await _errors(agent, 5.0)
        at = (await agent.ask("status"))["positions"]
        positions = np.array([at["X"], at["Y"], at["Z"], np.radians(at["A"]), np.radians(at["C"])])
        shift = kinematics.tcp_offsets(np.array(_WARM), positions, SPHERE_MM * 1e-3)
        await comes(agent, tuple(float(v) for v in np.clip(shift, -5.0, 5.0)), trial.target.timeout_s)


@FOLLOW.add(_ERRORS, Moves.OFFSETS)
async def a_bound_limits_the_shift_and_not_the_errors(trial: Trial) -> None:
    """With a bound_um of 0.2 no axis is shifted farther, and `errors` is what was written."""
    async with claimed(trial.target) as agent:
        await _errors(agent, 0.2)
        await asyncio.sleep(0.1)
        if max(map(abs, found := await in_force(agent))) > 0.2 + SAME_UM:
            raise Broken(f"{um_text(found)} µm in force")


@FOLLOW.add(_SLOPES, Moves.OFFSETS)
async def slopes_come_into_force(trial: Trial) -> None:
    """`write_slopes` comes into force, and `read` is um + um_per_mm · (tip - reference_mm)."""
    travel = trial.told.travel
    if travel is None:
        raise Broken("no travel in the greeting")
    slopes = [[0.0] * 3 for _ in range(3)]
    for shifted, over in travel.pairs:
        slopes[shifted][over] = 1.0 / travel.reach_mm[over]
    um = [0.5, -0.5, 1.0]
    async with claimed(trial.target) as agent:
        await agent.ask("write_slopes", owner=OWNER, um=um, um_per_mm=slopes)

        async def flat() -> object:
            told = await agent.ask("slopes")
            if not isinstance(told, dict) or not isinstance(told.get("um_per_mm"), list):
                raise Broken(f"slopes = {excerpt(told)}")
            rows = [v * r for row in told["um_per_mm"] for v, r in zip(row, travel.reach_mm, strict=True)]
            return [*told.get("um", []), *rows]

        wanted = [*um, *(v * r for row in slopes for v, r in zip(row, travel.reach_mm, strict=True))]
        await _settles(agent, flat, tuple(wanted), "slopes (at the ends of the travel)")
        at = (await agent.ask("status"))["positions"]
        away = np.array([at["X"], at["Y"], at["Z"]]) - travel.reference_mm
        await comes(agent, tuple(float(v) for v in np.array(um) + np.array(slopes) @ away), trial.target.timeout_s)
