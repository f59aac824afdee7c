"""Clauses of the values that an agent reports, and of the clients that only read them."""

from drivers.agent.greeting import Capability
from gateway.commissioning.agent_test.clause import Clauses, Trial
from gateway.commissioning.agent_test.connection import Broken, Told, connected, excerpt, logged_in

VALUES = Clauses()
_VALUES = frozenset({Capability.VALUES})
_NO_NAMES = ("no such value, talc-gateway asks", "and no such one")


@VALUES.add(_VALUES)
async def serves_clients_that_only_read(trial: Trial) -> None:
    """A client that states that it only reads is served beside the one that writes, and `status` and `claim` are
    refused to it."""
    async with logged_in(trial.target) as writer:
        async with connected(trial.target) as reader:
            await reader.login(reads=True)
            await reader.ask("values", names=list(_NO_NAMES))
            for do, arguments in (
                ("status", {}),
                ("claim", {"owner": 811203114, "silence_s": 1.0, "ramp_um_per_s": 0}),
            ):
                try:
                    answer = await reader.ask(do, **arguments)
                except Told:
                    continue
                raise Broken(f"{do}: {excerpt(answer)}")
        await writer.ask("status")


@VALUES.add(_VALUES)
async def names_the_values_that_it_does_not_have(trial: Trial) -> None:
    """`values` answers null for each name that the control does not have, and refuses a request without names."""
    async with connected(trial.target) as reader:
        await reader.login(reads=True)
        told = await reader.ask("values", names=list(_NO_NAMES))
        if not isinstance(told, dict) or told.get("values") != [None] * len(_NO_NAMES):
            raise Broken(excerpt(told))
        if not isinstance(told.get("stale"), str):
            raise Broken(f"stale = {excerpt(told.get('stale'))}")
        for names in ([], None, [1], "motor"):
            try:
                answer = await reader.ask("values", names=names)
            except Told:
                continue
            raise Broken(f"{excerpt(answer)} to names = {excerpt(names)}")
