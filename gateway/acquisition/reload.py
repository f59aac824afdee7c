"""Reload: applies a new configuration to a running gateway by its differences, or not at all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.tap import Tap
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.acquisition.line import Line
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.clocks import ServiceClock

_NEEDS_RESTART = (
    "machine",
    "grid",
    "storage",
    "telemetry",
    "metrics",
    "states",
    "planned_loads",
    "nc",
    "probing",
    "compensation",
    "talc",
    "sensor_check",
)
"""Sections from which the controller, the store, the session and the NC link were made."""


class ReloadError(Exception):
    """The new configuration cannot be applied while the gateway runs; the old one stays in use. The text says why."""


@dataclass(frozen=True, slots=True)
class BusChanges:
    """What happens to the buses, by name."""

    stopped: tuple[str, ...]
    started: tuple[str, ...]
    """Also in `stopped` if the bus existed before."""
    kept: tuple[str, ...]


def bus_changes(old: GatewayConfig, new: GatewayConfig) -> BusChanges:
    """Which buses must be stopped and started. A bus is kept if it, its devices, profiles and limits are unchanged.

    Raises ReloadError when something changed that only a restart can apply.
    """
    changed = [f"[{name}]" for name in _NEEDS_RESTART if getattr(old, name) != getattr(new, name)]
    if old.prior != new.prior and "[talc]" not in changed:
        changed.append("the file of [talc] prior")
    if changed:
        raise ReloadError(Text(NoticeCode.RELOAD_NEEDS_RESTART, sections=tuple(changed)))
    if old.input_names != new.input_names:
        gone, come = set(old.input_names) - set(new.input_names), set(new.input_names) - set(old.input_names)
        raise ReloadError(Text(NoticeCode.RELOAD_OTHER_INPUTS, changes=_changes(sorted(gone), sorted(come))))
    before, after = _parts(old), _parts(new)
    return BusChanges(
        stopped=tuple(name for name in before if before[name] != after.get(name)),
        started=tuple(name for name in after if after[name] != before.get(name)),
        kept=tuple(name for name in after if after[name] == before.get(name)),
    )


def _changes(gone: Sequence[str], new: Sequence[str]) -> Text:
    if gone and new:
        return Text(NoticeCode.GONE_AND_NEW, gone=gone, new=new)
    if gone:
        return Text(NoticeCode.GONE, gone=gone)
    return Text(NoticeCode.NEW, new=new) if new else Text(NoticeCode.THEIR_ORDER)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedReload:
    """Everything that a reload needs; nothing has been changed yet."""

    old: GatewayConfig
    new: GatewayConfig
    change: BusChanges
    lines: tuple[Line, ...]
    """The buses that are started, with their devices."""


def prepare(
    old: GatewayConfig, new: GatewayConfig, clock: ServiceClock, tap: Callable[[str], Tap] | None = None
) -> PreparedReload:
    """Build each driver that brings an acquisition from `old` to `new`, both already checked by `load`.

    For a thread: the library of a bus that is the first of its kind is imported here, which takes longer than a period.
    tap: returns the tap of the bus with that name, or None

    Raises ReloadError or SetupError.
    """
    change = bus_changes(old, new)
    return PreparedReload(old, new, change, lines_of(new, clock, tap, only=change.started))


async def apply(acquisition: Acquisition, prepared: PreparedReload) -> BusChanges:
    """Exchange the buses of a running acquisition.

    If that fails, the former buses run again, as the lines that ran before, because their files may have changed.

    Raises the error of an exchange that was undone.
    """
    change, lines = prepared.change, list(prepared.lines)
    former = {name: runner.line for name, runner in acquisition.runners.items()}
    try:
        await acquisition.exchange(change.stopped, lines)
    except Exception:
        running = [name for name in change.started if name in acquisition.runners]
        missing = [former[name] for name in change.stopped if name in running or name not in acquisition.runners]
        await acquisition.exchange(running, missing)
        raise
    acquisition.board.configure({channel.name: channel.period_s for channel in prepared.new.channels})
    return change


def _parts(config: GatewayConfig) -> dict[str, object]:
    """Everything from which a bus's runner is made."""
    limits = config.limits
    return {
        bus.name: (
            bus,
            [
                (d, config.profiles.get(d.profile), list(d.channels), {c: limits[c] for c in d.channels if c in limits})
                for d in config.devices_of(bus.name)
            ],
        )
        for bus in config.buses
    }
