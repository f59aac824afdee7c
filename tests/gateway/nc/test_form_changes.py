"""A control that takes offsets in another form after a reconnect, while a write in the earlier one may still arrive."""

import asyncio
from dataclasses import dataclass, field

import pytest

from drivers.base import NoAnswer
from drivers.nc import LinearOffsets, NineErrors
from gateway.model.compensation import Write
from gateway.nc.link import NcLink
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from tests.benches.nc_link_bench import ScriptedControl, config, decision
from tests.benches.stepped_clock import SteppedClock

REACH_MM = (300.0, 400.0)


def only_z(um: float) -> LinearOffsets:
    return LinearOffsets((0.0, 0.0, um), ((0.0, 0.0, 0.0),) * 3, (0.0, 0.0, 0.0))


@dataclass
class SlopesOfZ:
    """Takes slopes of Z over X."""

    control: "TwoForms"
    in_force: LinearOffsets = field(default_factory=lambda: only_z(0.0))
    pairs: frozenset[tuple[int, int]] = frozenset({(2, 0)})
    reference_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reach_mm: tuple[float, float, float] = (100.0, 100.0, 100.0)

    async def write_linear(self, offsets: LinearOffsets) -> None:
        self.control.lose()
        self.in_force = offsets

    async def read_linear(self) -> LinearOffsets:
        return self.in_force


@dataclass
class TwoForms(ScriptedControl):
    """Takes the nine errors, or slopes when `error_reach_mm` is None."""

    error_reach_mm: tuple[float, float] | None = None
    errors: tuple[float, ...] = (0.0,) * 9
    slopes: SlopesOfZ = field(init=False)

    def __post_init__(self) -> None:
        self.slopes = SlopesOfZ(self)

    def lose(self) -> None:
        if self.loses:
            self.loses = False
            raise NoAnswer("nothing within 2 s", device="nc")

    async def write_errors(self, errors: NineErrors) -> None:
        self.lose()
        self.errors = errors.errors

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        del radius_mm
        return self.errors

    @property
    def ez0a(self) -> float:
        """EZ0A in force, in whichever form."""
        return self.errors[1] if self.error_reach_mm else self.slopes.in_force.k0_um[2]

    def spoil(self) -> None:
        """Write as another program does."""
        self.errors = (0.0, 30.0) + (0.0,) * 7
        self.slopes.in_force = only_z(30.0)


@pytest.fixture(params=[(REACH_MM, None), (None, REACH_MM)], ids=["to slopes", "to nine errors"])
def bench(request: pytest.FixtureRequest) -> tuple[TwoForms, NcLink, list[str]]:
    """A link on its way to 25 µm, whose next write will be lost, and whose control takes the other form after the
    reconnection."""
    before, after = request.param
    control, notices = TwoForms(SteppedClock(), error_reach_mm=before), list[str]()
    settings = LinkSettings.of(config("compensate", when_stale="hold"), Identity())

    def notify(text: str) -> None:
        notices.append(text)
        if "nothing within 2 s" in text:
            control.error_reach_mm = after

    listeners = Listeners(written=list[Write]().append, notify=lambda notice: notify(notice.text))
    link = NcLink(control, control.clock, settings, Earlier(first_number=41), listeners)
    link.follow(decision(25.0))
    return control, link, notices


async def test_the_ramp_goes_on_in_the_other_form(bench: tuple[TwoForms, NcLink, list[str]]) -> None:
    control, link, notices = bench
    running = asyncio.create_task(link.run())
    await control.clock.run_until(10.0)
    control.loses = True
    await control.clock.run_until(16.0)
    assert [text for text in notices if "nothing within 2 s" in text]
    assert not running.done()
    assert control.ez0a == 0.0, "what is not yet known to be lost may still arrive"
    await control.clock.run_until(58.0)
    assert control.ez0a == pytest.approx(25.0)
    assert link.armed
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def test_another_program_is_distinguished_from_the_lost_write(bench: tuple[TwoForms, NcLink, list[str]]) -> None:
    control, link, notices = bench
    running = asyncio.create_task(link.run())
    await control.clock.run_until(10.0)
    control.loses = True
    await control.clock.run_until(40.0)
    control.spoil()
    await control.clock.run_until(45.0)
    assert not running.done()
    assert not link.armed
    assert control.ez0a == 30.0
    assert [text for text in notices if "disarmed" in text]
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
