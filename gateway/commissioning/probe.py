"""`talc-gateway probe`: reads every device once and shows the result."""

import asyncio
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isnan

from rich.table import Table

from drivers.base import DriverError, Learns, Quality
from drivers.nc import NumericalControl, TriesWriting
from gateway.acquisition.build import lines_of
from gateway.acquisition.line import Line
from gateway.acquisition.once import read_once
from gateway.acquisition.text import number_text
from gateway.config.model import GatewayConfig
from gateway.nc.boundary import contained_control
from gateway.nc.build import control_of
from gateway.runtime.clocks import RealClock
from gateway.runtime.terminal import terminal


@dataclass(frozen=True, slots=True)
class _ProbedRow:
    bus: str
    device: str
    channel: str
    value: str
    quality: Quality
    latency_ms: float | None
    detail: str = ""


def show(config: GatewayConfig, *, try_writing: bool = False) -> bool:
    """Print a table of all channels; True if every one is good. Nothing is stored or published.

    try_writing: writes back to the control what is there; otherwise nothing is written
    """
    lines = lines_of(config, RealClock())
    rows = asyncio.run(_rows(config, lines, try_writing=try_writing))
    table = Table("bus", "device", "channel", "value", "quality", "latency", title=config.machine.name)
    for row in rows:
        latency = "" if row.latency_ms is None else f"{row.latency_ms:.1f} ms"
        table.add_row(
            row.bus,
            row.device,
            row.channel,
            row.value,
            row.quality.value,
            latency,
            style="" if row.quality.usable else "red",
        )
    console = terminal()
    console.print(table)
    for detail in dict.fromkeys(row.detail for row in rows if row.detail):  # a silent device is one problem, not six
        console.print(f"- {detail}", style="red", highlight=False, soft_wrap=True)
    for line in lines:
        if isinstance(line.bus, Learns):
            for text in (*line.bus.learnt(), *_answers(line.bus.name, line.bus.answers_s())):
                console.print(f"- {text}", highlight=False, soft_wrap=True)
    bad = sum(not row.quality.usable for row in rows)
    console.print(f"{len(rows) - bad} of {len(rows)} good")
    return bad == 0


def _answers(bus: str, answers_s: Mapping[int, float]) -> Iterator[str]:
    if answers_s:
        units = ", ".join(f"{1e3 * s:.1f} ms (unit {unit})" for unit, s in answers_s.items())
        yield f"bus {bus}: an answer takes {units}"


async def _rows(config: GatewayConfig, lines: Sequence[Line], *, try_writing: bool) -> list[_ProbedRow]:
    per_line = await asyncio.gather(*map(_line, lines))
    rows = [row for line in per_line for row in line]
    return rows + await _nc(config, try_writing=try_writing)


async def _line(line: Line) -> list[_ProbedRow]:
    """The devices of one bus, one after the other; buses are read concurrently."""
    rows: list[_ProbedRow] = []
    for answer in await read_once(line, RealClock(), learns=True):
        latency = None if answer.took_s is None else answer.took_s * 1e3
        for r in answer.readings:
            value = "" if isnan(r.value) else f"{number_text(r.value)} {r.unit}"
            detail = f"{r.channel}: {r.detail}" if r.detail and answer.took_s is not None else r.detail
            rows.append(_ProbedRow(line.bus.name, answer.device, r.channel, value, r.quality, latency, detail))
    return rows


async def _nc(config: GatewayConfig, *, try_writing: bool) -> list[_ProbedRow]:
    if config.nc is None:
        return []
    driver = control_of(config.nc, config, RealClock())
    nc = contained_control(driver)
    try:
        await nc.connect()
        began = time.perf_counter()
        snapshot = await nc.snapshot()
        latency = (time.perf_counter() - began) * 1e3
        values = {f"position {axis}": value for axis, value in snapshot.positions.items()}
        values |= {state.name: snapshot.states[state.name] for state in config.states if state.name in snapshot.states}
        texts = {name: f"{value:z.3f}" for name, value in values.items()}  # 5.7e-14 mm is 0: it is what rounding leaves
        texts |= {"mode": snapshot.mode.value, "program": snapshot.program.value}
        if snapshot.tool is not None:
            texts["tool"] = str(snapshot.tool)
        if snapshot.probe_in_spindle is not None:
            texts["probe in spindle"] = "yes" if snapshot.probe_in_spindle else "no"
        if snapshot.cannot_probe and not config.nc.only_read:
            texts["cannot probe"] = snapshot.cannot_probe
        if snapshot.alarms:
            texts["alarms"] = ", ".join(map(str, snapshot.alarms))
        missing = [state.name for state in config.states if state.name not in snapshot.states]
        rows = [_ProbedRow("nc", config.nc.kind, n, text, Quality.GOOD, latency) for n, text in texts.items()]
        gone = Quality.COMM_FAULT
        if try_writing:
            rows.append(await _writing(driver, config.nc.kind))
        details = dict.fromkeys(missing, "the NC does not report this state")
        details |= {name: f"not known to the gateway: {text}" for name, text in snapshot.not_known.items()}
        return rows + [_ProbedRow("nc", config.nc.kind, n, "", gone, latency, text) for n, text in details.items()]
    except DriverError as error:
        return [_ProbedRow("nc", config.nc.kind, "snapshot", "", Quality.COMM_FAULT, None, str(error))]
    finally:
        with suppress(DriverError):  # what was read is shown all the same
            await nc.close()


async def _writing(driver: NumericalControl, kind: str) -> _ProbedRow:
    if not isinstance(driver, TriesWriting):
        return _ProbedRow("nc", kind, "writing", "not tried: this control has no rights to grant", Quality.GOOD, None)
    try:
        await driver.try_writing()
    except DriverError as error:
        return _ProbedRow("nc", kind, "writing", "", Quality.COMM_FAULT, None, str(error))
    return _ProbedRow("nc", kind, "writing", "everything that is needed", Quality.GOOD, None)
