"""`talc-gateway nc dry-run`: has the control go the probing cycle's path above the sphere, and keeps what it showed."""

import asyncio
import math
import os
import signal
from collections.abc import Callable, Coroutine, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import click

from drivers.base import DriverError, Refused, SetupError
from drivers.nc import MarksPath, ProbingState, RunsDry
from gateway.config.controls import Nc
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.events import EventReported, ProbingRequested
from gateway.model.text import Language, Text, language_wanted
from gateway.model.wording import event_of
from gateway.nc.boundary import contained_control
from gateway.nc.build import control_of
from gateway.nc.probing.cycle import NotBegun, Rejected, number_after
from gateway.nc.probing.dry_run import DryRun, run_dry
from gateway.nc.probing.geometry import Geometry, geometry_of, recorded
from gateway.runtime.clocks import RealClock, ServiceClock
from gateway.storage.history import History
from gateway.storage.store import Store, boot_id
from talc.frame import EventKind
from talc.kinematics import CHAIN

_POLL_S = 0.2


def run(config: GatewayConfig, height_mm: float, output: Path | None) -> None:
    """Do one on the control of a configuration, print it and write the report. Raises DriverError, StoreError."""
    _, geometry = _asked(config)
    clock, said = RealClock(), Language(language_wanted(os.environ))
    click.echo(said("dry_run.asked", control=geometry.control, poses=len(geometry.poses_deg), mm=height_mm))
    began = clock.utc()

    def told(state: ProbingState) -> None:
        click.echo(said.word("dry_run_state", state))

    done = asyncio.run(until_signal(dry_run(config, clock, height_mm, _POLL_S, told)))
    lines = list(report(done, geometry))
    for line in lines:
        click.echo(line)
    path = output or config.storage.path.with_suffix(".dry-run.txt")
    head = f"dry run of {config.machine.name}, {geometry.control}, {began:%Y-%m-%d %H:%M} UTC"
    path.write_text("\n".join((head, *lines)) + "\n", encoding="utf-8")
    click.echo(said("dry_run.written", path=str(path)))
    if done.wrong:
        raise Refused("this dry run does not show that the cycle is free", device="nc", hint="; ".join(done.wrong))
    if not config.probing.armed:
        click.echo(said("dry_run.free"))


async def dry_run(
    config: GatewayConfig, clock: ServiceClock, height_mm: float, poll_s: float, told: Callable[[ProbingState], None]
) -> DryRun:
    """Do one, and record it in the database if it went well. told: gets each state.

    Raises SetupError without a control that probes, StoreError while a gateway runs, DriverError.
    """
    section, geometry = _asked(config)
    with clock.hold():  # libraries are imported
        nc = contained_control(control_of(section, config, clock, dry=True))
    with _opened(config, clock) as store:
        with clock.hold(), History(config.storage.path) as history:
            last = history.last_number()
        try:
            with clock.hold():
                await nc.connect()
                if not (isinstance(nc, RunsDry) and nc.runs_dry):
                    hint = (
                        "on a SINUMERIK call TALC_SAFE_POINT once, which shows its version. If there are none, drive "
                        'its cycle by hand at reduced feed, then write [probing] dry_run = "not offered"'
                    )
                    raise Refused("the control's program has not shown dry runs", device="nc", hint=hint)
                path = nc.path_mark if isinstance(nc, MarksPath) else ""
                if last is not None:
                    await nc.withdraw_probing(last)  # a gateway that was killed may have left it behind
                number = number_after(last, clock.utc())
                store.record(ProbingRequested(number))
                store.flush()  # a number is never used again
            done = await run_dry(
                nc,
                number,
                geometry,
                clock,
                height_mm=height_mm,
                poll_s=poll_s,
                timeout_s=config.probing.timeout_s,
                told=told,
            )
        except (NotBegun, Rejected) as error:
            raise Refused(str(error), device="nc") from error
        finally:
            with suppress(DriverError), clock.hold():
                await nc.close()
        if not done.wrong:
            lowest = min(pose.above_mm for pose in done.poses)
            what = Text(NoticeCode.DRY_RUN_POSES, n=len(done.poses), lowest_mm=lowest)
            store.record(EventReported(event_of(EventKind.OPERATOR, recorded(geometry, what, path)), None))
    return done


@contextmanager
def _opened(config: GatewayConfig, clock: ServiceClock) -> Iterator[Store]:
    """The database. Simulated time stands still while it is opened and closed."""
    with ExitStack() as stack:
        with clock.hold():
            store = stack.enter_context(Store(config.storage.path, boot_id(), clock, origin=clock.origin()))
        try:
            yield store
        finally:
            with clock.hold():
                stack.close()


def report(run: DryRun, geometry: Geometry) -> Iterator[str]:
    """Lines about the path: one for each pose, then the axes."""
    yield f"{len(run.poses)} poses of {geometry.mark} in {run.seconds:.0f} s, {run.samples} samples while running"
    yield "pose      A      C   reached X        Y        Z   beside  above centre  nearest to centre   there"
    for number, pose in enumerate(run.poses, start=1):
        x, y, z = pose.reached_mm
        nearest = "not seen" if math.isnan(pose.nearest_mm) else f"{pose.nearest_mm:.1f} mm"
        yield (
            f"{number:4d} {pose.a_deg:6.1f} {pose.c_deg:6.1f} {x:11.2f} {y:8.2f} {z:8.2f} {pose.aside_mm:5.1f} mm "
            f"{pose.above_mm:10.1f} mm {nearest:>18} {pose.seconds:5.1f} s"
        )
    for axis, (low, high) in run.ranges.items():
        yield f"{axis} from {low:.1f} to {high:.1f} {'mm' if axis in 'XYZ' else '°'}"
    yield from run.wrong


async def until_signal(work: Coroutine[object, object, DryRun]) -> DryRun:
    """SIGTERM, and the end of the terminal or of its connection, end it as Ctrl-C does: the request is withdrawn."""
    task = asyncio.create_task(work)

    def end() -> None:
        if not task.cancelling():  # a second one would end the withdrawal
            task.cancel()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, end)
    try:
        return await task
    except asyncio.CancelledError:
        raise Refused("ended by hand, and withdrawn", device="nc") from None


def _asked(config: GatewayConfig) -> tuple[Nc, Geometry]:
    """Raises SetupError."""
    geometry = geometry_of(config)
    if geometry is None or config.nc is None or config.nc.only_read:
        raise SetupError(Text(NoticeCode.NO_PROBING_CONTROL))
    if not config.machine.corrected:
        raise SetupError(Text(NoticeCode.CHAIN_NOT_CORRECTED, value=config.machine.chain, corrected=CHAIN))
    return config.nc, geometry
