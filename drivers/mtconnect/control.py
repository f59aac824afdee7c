"""A control that is read by HTTP from its MTConnect agent (ANSI/MTC1.4, requests `probe` and `current`)."""

import asyncio

from drivers.base import BadAnswer, Clock, ConnectError
from drivers.mtconnect.document import Observed, described, observed
from drivers.mtconnect.exchange import ask_agent
from drivers.mtconnect.items import POSITION_UNITS, SPEED_UNITS, SWITCHED, factors, number
from drivers.mtconnect.settings import MtConnectSettings
from drivers.nc import AXES, LINEAR_AXES, NcSnapshot, OperatingMode, ProgramState
from drivers.only_read import ONLY_READ, OnlyRead
from drivers.text import Text, text_of

_MODES = {
    "AUTOMATIC": OperatingMode.AUTO,
    "SEMI_AUTOMATIC": OperatingMode.AUTO,
    "MANUAL": OperatingMode.JOG,
    "MANUAL_DATA_INPUT": OperatingMode.MDA,
    "EDIT": OperatingMode.UNKNOWN,
}
_PROGRAMS = {
    "ACTIVE": ProgramState.RUNNING,
    "READY": ProgramState.STOPPED,
    "STOPPED": ProgramState.STOPPED,
    "PROGRAM_COMPLETED": ProgramState.STOPPED,
    "WAIT": ProgramState.WAITING,
    "FEED_HOLD": ProgramState.INTERRUPTED,
    "INTERRUPTED": ProgramState.INTERRUPTED,
    "PROGRAM_STOPPED": ProgramState.INTERRUPTED,
    "OPTIONAL_STOP": ProgramState.INTERRUPTED,
}
_DESCRIBED_AGAIN_S = 60.0
"""After this time the agent is asked for its description again: somebody may have changed a unit without a restart."""
_STOPS = ("ARMED", "TRIGGERED")
"""States of an emergency stop."""


class MtConnectControl(OnlyRead):
    """One machine of an MTConnect agent. Constructed without the network; never retries."""

    def __init__(self, settings: MtConnectSettings, clock: Clock) -> None:
        self._settings, self._clock = settings, clock
        self._factors: dict[str, float] = {}
        self._instance = ""
        """Of the agent when it was last asked for its description."""
        self._described_s = 0.0
        """When that was, monotonic."""

    async def connect(self) -> None:
        """The agent must describe every configured data item, with a type and a unit that fit.

        Raises WrongDevice if it does not.
        """
        self._instance = await self._learn()
        await self.snapshot()

    async def _learn(self) -> str:
        """Take the factors from the agent's description; returns its instance. Raises as `connect`."""
        self._factors = {}
        body = await self._get("probe")
        try:
            found = await asyncio.to_thread(described, body)
        except ValueError as error:
            raise BadAnswer(Text("mtc_probe", error=text_of(error)), device="nc") from error
        self._factors = factors(self._settings, found.items)
        self._described_s = self._clock.monotonic()
        return found.instance

    async def close(self) -> None:
        """Each request has its own connection."""
        self._factors = {}

    async def snapshot(self) -> NcSnapshot:
        """Raises BadAnswer while an axis has no position: an agent that has lost its control reports UNAVAILABLE.

        After a restart of the agent, and each minute, its description is read again; raises as `connect`. A word of
        another data item that is not known costs only itself.
        """
        if not self._factors:
            raise ConnectError(Text("not_connected"), device="nc", hint=Text("connect_first"))
        settings, told = self._settings, (await self._observed()).values
        if missing := [axis for axis in AXES if settings.positions[axis] not in told]:
            raise BadAnswer(Text("mtc_no_position", names=", ".join(missing)), device="nc")
        positions = {axis: self._value(axis, settings.positions[axis], told) for axis in AXES}
        for axis, origin in zip(LINEAR_AXES, settings.origin_mm, strict=True):
            positions[axis] -= origin
        states, not_known = {}, {}
        for name, item in settings.states.items():
            if item in told:
                try:
                    states[name] = self._value(name, item, told)
                except BadAnswer:
                    not_known[name] = self._quoted_item(item, told)
        words = ("mode", settings.mode, _MODES), ("program", settings.program, _PROGRAMS)
        for name, item, known in (*words, ("emergency_stop", settings.emergency_stop, _STOPS)):
            if item in told and told[item] not in known:
                not_known[name] = self._quoted_item(item, told)
        return NcSnapshot(
            time=self._clock.utc(),
            monotonic_s=self._clock.monotonic(),
            positions=positions,
            states={name: abs(value) if name in SPEED_UNITS else value for name, value in states.items()},
            not_known=not_known,
            mode=_MODES.get(told.get(settings.mode, ""), OperatingMode.UNKNOWN),
            program=_PROGRAMS.get(told.get(settings.program, ""), ProgramState.UNKNOWN),
            tool=self._tool(told.get(settings.tool, "")),
            ready=False if told.get(settings.emergency_stop) == "TRIGGERED" else None,
            cannot_probe=ONLY_READ,
        )

    async def _observed(self) -> Observed:
        """What the agent observed last, in the units of its description."""
        if self._clock.monotonic() - self._described_s >= _DESCRIBED_AGAIN_S:
            await self._learn()
        found = await self._current()
        if found.instance != self._instance:
            await self._learn()
            restarted, found = found, await self._current()
            if found.instance != restarted.instance:
                what = Text("mtc_instance", one=found.instance or "none", other=restarted.instance or "none")
                raise BadAnswer(what, device="nc", hint=Text("mtc_restarts"))
            self._instance = found.instance
        return found

    async def _current(self) -> Observed:
        try:
            return await asyncio.to_thread(observed, await self._get("current"))
        except ValueError as error:
            raise BadAnswer(Text("mtc_current", error=text_of(error)), device="nc") from error

    def _value(self, name: str, item: str, told: dict[str, str]) -> float:
        text = told[item]
        if text in SWITCHED and name not in POSITION_UNITS and name not in SPEED_UNITS:
            return SWITCHED[text]
        return number(item, text, self._factors[name])

    def _quoted_item(self, item: str, told: dict[str, str]) -> str:
        code = "mtc_item_of" if self._settings.machine else "mtc_item"
        return Text(code, told=repr(told[item][:40]), item=item, machine=self._settings.machine)

    def _tool(self, text: str) -> int | None:
        """MTConnect's tool numbers are text; only whole ones are reported."""
        return int(text) if text.isascii() and text.isdecimal() and len(text) <= 9 else None

    async def _get(self, request: str) -> bytes:
        settings = self._settings
        return await ask_agent(settings.url, settings.machine, request, settings.timeout_s)
