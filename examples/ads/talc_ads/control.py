"""Reads a TwinCAT PLC over ADS with the library pyads, whose calls block and therefore have their own thread."""

import asyncio
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import pyads

from drivers.base import BadAnswer, Clock, ConnectError, NoAnswer, WrongDevice
from drivers.nc import NcSnapshot
from drivers.only_read import ONLY_READ, OnlyRead
from talc_ads.section import AXES, AdsSection

RUN = 5
"""ADS state of a PLC whose program runs."""
ROUTER_PORT = 48898
TIMED_OUT, NO_SYMBOL = 1861, 1808
T = TypeVar("T")


class AdsControl(OnlyRead):
    """One machine. Constructed without the network; never retries."""

    def __init__(self, section: AdsSection, clock: Clock, states: Sequence[str]) -> None:
        self._section, self._clock, self._states = section, clock, states
        self._symbols = {f"positions.{axis}": section.positions[axis] for axis in AXES}
        self._symbols |= {f"states.{name}": section.states[name].symbol for name in states}
        if section.ready:
            self._symbols["ready"] = section.ready
        self._plc: pyads.Connection | None = None
        self._thread: ThreadPoolExecutor | None = None

    async def connect(self) -> None:
        """Connect, and check that the PLC has every variable. Raises WrongDevice, naming the field of a missing one."""
        await self.close()
        section = self._section
        try:  # the library would wait for minutes
            async with asyncio.timeout(section.timeout_s):
                _, writer = await asyncio.open_connection(section.host, ROUTER_PORT)
                writer.close()
        except (OSError, TimeoutError) as error:
            raise ConnectError(f"{section.host}: {error or 'no connection'}", device="nc") from error
        plc = self._plc = pyads.Connection(section.net_id, section.ams_port, section.host)
        self._thread = ThreadPoolExecutor(1, "ads")
        try:
            await self._call(plc.open)
            await self._call(lambda: plc.set_timeout(round(section.timeout_s * 1000)))
            for where, symbol in self._symbols.items():
                await self._call(lambda it=symbol: plc.get_symbol(it), f"{where} = {symbol!r}")  # type: ignore[misc]
            await self.snapshot()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Close the connection; a call that the thread still waits for ends by its own timeout."""
        plc, thread, self._plc, self._thread = self._plc, self._thread, None, None
        if plc is not None and thread is not None:
            thread.submit(plc.close)
            thread.shutdown(wait=False)

    async def snapshot(self) -> NcSnapshot:
        """Read the machine's state. Raises BadAnswer while the PLC's program does not run: its values stand still."""
        plc = self._plc
        if plc is None:
            raise ConnectError("not connected", device="nc", hint="connect first")
        state, _ = await self._call(plc.read_state)
        if state != RUN:
            raise BadAnswer(f"ADS state {state} of the PLC, not {RUN} (RUN): its values may stand still", device="nc")
        # Without the cache: another PLC program has its variables elsewhere.
        names = list(dict.fromkeys(self._symbols.values()))
        told = await self._call(lambda: plc.read_list_by_name(names, cache_symbol_info=False))
        values = {where: _number(symbol, told.get(symbol)) for where, symbol in self._symbols.items()}
        origins = dict(zip("XYZ", self._section.origin_mm, strict=True))
        return NcSnapshot(
            self._clock.utc(),
            self._clock.monotonic(),
            {axis: values[f"positions.{axis}"] - origins.get(axis, 0.0) for axis in AXES},
            {name: values[f"states.{name}"] * self._section.states[name].factor for name in self._states},
            ready=bool(values["ready"]) if self._section.ready else None,
            cannot_probe=ONLY_READ,
        )

    async def _call(self, work: Callable[[], T], what: str = "") -> T:
        if self._thread is None:
            raise ConnectError("not connected", device="nc", hint="connect first")
        try:
            # Twice: the library's own timeout comes first.
            async with asyncio.timeout(2.0 * self._section.timeout_s):
                return await asyncio.get_running_loop().run_in_executor(self._thread, work)
        except TimeoutError as error:
            raise self._silent() from error
        except pyads.ADSError as error:
            if error.err_code == TIMED_OUT:
                raise self._silent() from error
            if error.err_code == NO_SYMBOL:
                raise WrongDevice(f"{what or 'a variable'}: the PLC has no such variable", device="nc") from error
            raise ConnectError(f"{self._section.address}: {error}", device="nc") from error
        except (ValueError, TypeError, LookupError) as error:  # what the library cannot decode
            raise BadAnswer(f"{what}: {error}", device="nc") from error

    def _silent(self) -> NoAnswer:
        return NoAnswer(f"{self._section.address}: no answer within {self._section.timeout_s:g} s", device="nc")


def _number(symbol: str, value: Any) -> float:
    """A value as a number; a BOOL is 0 or 1. Raises BadAnswer if it is not finite: the library reports errors as
    text."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise BadAnswer(f"{symbol} = {str(value)[:60]!r}: expected a number", device="nc")
    return float(value)
