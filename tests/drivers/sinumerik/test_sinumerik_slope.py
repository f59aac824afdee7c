"""K0, tanβ, P0 and sag tables over the real wire: the emulated control adds what was requested, everywhere."""

import itertools
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

import numpy as np
import pytest

from drivers.base import Refused, SetupError, WrongDevice
from drivers.nc import FollowsPosition, LinearOffsets, NotSendable, Triple, WatchdogTerms
from drivers.problems import settings_of
from drivers.sinumerik.settings import PAIRS, OffsetRoute, Paths, SinumerikSettings
from drivers.sinumerik.slope import SinumerikWithSlopes
from simulators.nc.nck import CEC_TABLES
from tests.benches.emulated_bench import OpcUaBench, sinumerik_bench
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

T = TypeVar("T")
TRAVEL = ((-300.0, 300.0), (-200.0, 200.0), (0.0, 400.0))
NAMES = {pair: name for name, pair in PAIRS.items()}
TABLES = {NAMES[pair]: number for number, pair in enumerate(CEC_TABLES)}
ZERO: Triple = (0.0, 0.0, 0.0)
OFFSETS = LinearOffsets((10.0, -20.0, 5.0), ((0.05, -0.01, 0.02), (0.03, -0.04, 0.01), (0.0, 0.02, 0.06)), ZERO)
OWN_AXES = LinearOffsets((10.0, -20.0, 5.0), ((0.05, 0.0, 0.0), (0.0, -0.04, 0.0), (0.0, 0.0, 0.06)), ZERO)


@asynccontextmanager
async def with_slopes(**changes: object) -> AsyncIterator[tuple[OpcUaBench, SinumerikWithSlopes]]:
    async with sinumerik_bench() as bench:
        fields: dict[str, object] = {"route": "k0_slope", "travel_mm": TRAVEL, "tables": TABLES}
        compensation = OffsetRoute(**(fields | changes))
        nc = SinumerikWithSlopes(
            SinumerikSettings(security="none", url=bench.url, compensation=compensation), bench.clock
        )
        await nc.connect()
        try:
            yield bench, nc
        finally:
            await nc.close()


def added(bench: OpcUaBench) -> list[Triple]:
    """What the control adds in every corner of the travel."""
    return [bench.control.nck.shift_um(corner) for corner in itertools.product(*TRAVEL)]


async def test_every_pair_of_axes_shifts_as_asked_in_every_corner() -> None:
    async with with_slopes() as (bench, nc):
        assert isinstance(nc, FollowsPosition)
        await nc.write_linear(OFFSETS)
        expected = [OFFSETS.at(corner) for corner in itertools.product(*TRAVEL)]
        np.testing.assert_allclose(added(bench), expected, atol=1e-9)
        read = await nc.read_linear()
        np.testing.assert_allclose(read.k0_um, OFFSETS.k0_um, atol=1e-9)
        np.testing.assert_allclose(read.slope_um_per_mm, OFFSETS.slope_um_per_mm, atol=1e-12)
        position = bench.control.state().positions
        here = (position["X"], position["Y"], position["Z"])
        assert await nc.read_compensation() == pytest.approx(OFFSETS.at(here))


async def test_positions_count_from_where_a_and_c_meet_wherever_machine_zero_is() -> None:
    origin, zero = (10.0, -20.0, 30.0), (0.0, 0.0, 0.0)
    async with sinumerik_bench() as bench:
        compensation = OffsetRoute(route="k0_slope", travel_mm=TRAVEL, tables=TABLES)
        settings = SinumerikSettings(security="none", url=bench.url, compensation=compensation, origin_mm=origin)
        nc = SinumerikWithSlopes(settings, bench.clock)
        await nc.connect()
        machine = await bench.nc.snapshot()
        from_there = await nc.snapshot()
        assert from_there.positions == pytest.approx(
            machine.positions | {a: machine.positions[a] - o for a, o in zip("XYZ", origin, strict=True)}
        )
        # P0 stays machine zero on the control; the gateway counts it, too, from where A and C meet.
        assert nc.reference_mm == (-10.0, 20.0, -30.0)
        asked = LinearOffsets(OFFSETS.k0_um, OFFSETS.slope_um_per_mm, nc.reference_mm)
        await nc.write_linear(asked)
        assert bench.control.nck.reference_mm == list(zero)
        expected = [asked.at((x - 10.0, y + 20.0, z - 30.0)) for x, y, z in itertools.product(*TRAVEL)]
        np.testing.assert_allclose(added(bench), expected, atol=1e-9)
        here = from_there.positions
        assert await nc.read_compensation() == pytest.approx(asked.at((here["X"], here["Y"], here["Z"])))
        await nc.request_probing(1)
        bench.clock.move_to(200.0)
        centres = (await nc.probing_status(1)).centres_mm
        assert centres is not None
        assert centres[0] == pytest.approx((120.0 - 10.0, 20.0, 80.0 - 30.0), abs=0.1)
        await nc.close()


async def test_without_tables_each_axis_follows_its_own_position_only() -> None:
    async with with_slopes(tables={}) as (bench, nc):
        assert nc.pairs == {(0, 0), (1, 1), (2, 2)}
        await nc.write_linear(OWN_AXES)
        expected = [OWN_AXES.at(corner) for corner in itertools.product(*TRAVEL)]
        np.testing.assert_allclose(added(bench), expected, atol=1e-9)
        with pytest.raises(
            ValueError, match="X has a slope over an axis without a table for that pair; nothing was sent"
        ):
            await nc.write_linear(OFFSETS)
        np.testing.assert_allclose(added(bench), expected, atol=1e-9)


async def test_a_plain_shift_takes_the_slopes_away() -> None:
    async with with_slopes() as (bench, nc):
        await nc.write_linear(OFFSETS)
        await nc.write_compensation((1.0, 2.0, 3.0))
        np.testing.assert_allclose(added(bench), [(1.0, 2.0, 3.0)] * 8, atol=1e-9)


async def test_signs_of_tables_may_differ_from_those_of_the_axes() -> None:
    async with with_slopes(table_signs=(1, -1, -1)) as (bench, nc):
        await nc.write_linear(LinearOffsets(ZERO, ((0.0, 0.05, 0.0), ZERO, ZERO), ZERO))
        assert bench.control.nck.shift_um((0.0, 100.0, 0.0)) == pytest.approx((-5.0, 0.0, 0.0))
        assert (await nc.read_linear()).slope_um_per_mm[0][1] == pytest.approx(0.05)


async def test_a_claim_sets_a_reference_while_no_slope_is_in_force_and_is_refused_otherwise() -> None:
    reference, watch = (100.0, 0.0, 200.0), WatchdogTerms(silence_s=5.0, ramp_um_per_s=2.0)
    async with with_slopes(reference_mm=reference, tables={}) as (bench, nc):
        nck = bench.control.nck
        asked = LinearOffsets((1.0, 2.0, 3.0), OWN_AXES.slope_um_per_mm, reference)
        await nc.read_linear()
        assert nck.reference_mm == [0.0, 0.0, 0.0]  # to read sets nothing: monitoring does no more than that
        with refusing(Refused, "nc_p0 axis=X nc_p0_hint"):
            await nc.write_linear(asked)
        await nc.claim(7, watch)
        assert nck.reference_mm == list(reference)
        await nc.write_linear(asked)
        assert nck.shift_um((300.0, -200.0, 0.0)) == pytest.approx(asked.at((300.0, -200.0, 0.0)))
        nck.reference_mm[2] = 50.0
        before = nck.shift_um((0.0, 0.0, 10.0))
        # What is read is stated relative to our reference, whichever the control has.
        assert (await nc.read_linear()).at((0.0, 0.0, 10.0)) == pytest.approx(before)
        refused = r"P0 of Z \(SD43920\) is 50 with a slope in force, expected 200 .*SD43910"
        with pytest.raises(Refused, match=refused):
            await nc.write_linear(asked)
        with pytest.raises(Refused, match=refused):
            await nc.claim(7, watch)
        assert nck.shift_um((0.0, 0.0, 10.0)) == before


async def test_a_write_is_the_only_request_of_a_write() -> None:
    """Any request before it takes time in which the control's watchdog may take the offsets, after the last look."""
    async with with_slopes() as (bench, nc):
        await nc.claim(7, WatchdogTerms(silence_s=5.0, ramp_um_per_s=2.0))
        asked: list[str] = []
        state, wake = bench.control.state, bench.control.wake

        def noted(what: str, then: Callable[[], T]) -> T:
            asked.append(what)
            return then()

        bench.control.state = lambda: noted("read", state)  # type: ignore[method-assign]
        bench.control.wake = lambda: noted("write", wake)  # type: ignore[method-assign]
        await nc.write_linear(OFFSETS)
        assert asked == ["write"]


BAD = [
    (LinearOffsets((math.nan, 0.0, 0.0), (ZERO, ZERO, ZERO), ZERO), "offsets of X: expected finite"),
    (LinearOffsets(ZERO, ((math.inf, 0.0, 0.0), ZERO, ZERO), ZERO), "offsets of X: expected finite"),
    (LinearOffsets((0.0, 501.0, 0.0), (ZERO, ZERO, ZERO), ZERO), "offsets of Y reach 501.0 µm .* largest_um = 500"),
    (LinearOffsets((0.0, 0.0, 300.0), (ZERO, ZERO, (0.0, 0.0, 0.6)), ZERO), "offsets of Z reach 540.0 µm"),
    # At one corner they cancel, at another they add up.
    (LinearOffsets(ZERO, ((1.0, -1.5, 0.0), ZERO, ZERO), ZERO), "offsets of X reach 600.0 µm .* largest_um = 500"),
    (LinearOffsets(ZERO, (ZERO, ZERO, ZERO), (1.0, 0.0, 0.0)), "reference_mm"),
]


@pytest.mark.parametrize(("offsets", "message"), BAD)
async def test_invalid_offsets_are_refused_before_anything_is_sent(offsets: LinearOffsets, message: str) -> None:
    async with with_slopes() as (bench, nc):
        await nc.write_linear(OFFSETS)
        before = added(bench)
        with pytest.raises(NotSendable, match=f"{message}.*nothing was sent"):
            await nc.write_linear(offsets)
        assert added(bench) == before


async def test_after_silence_nothing_is_left_anywhere_and_nothing_moves_faster_than_agreed() -> None:
    async with with_slopes() as (bench, nc):
        await nc.claim(7, WatchdogTerms(silence_s=5.0, ramp_um_per_s=2.0))
        await nc.write_linear(OFFSETS)
        before = np.array(added(bench))
        largest = np.abs(before).max()
        for now in np.arange(5.0, 5.0 + 4 * largest):
            bench.clock.move_to(float(now))
            bench.control.now()
            after = np.array(added(bench))
            assert np.abs(after - before).max() <= 2.0 + 1e-9
            before = after
        assert np.abs(before).max() == 0.0


async def test_a_table_that_does_not_exist_is_named_when_connecting() -> None:
    paths = Paths(weight="/NC/_N_NC_SEA_ACX/$SN_CEC_WEIGHT[{n}]")
    compensation = OffsetRoute(route="k0_slope", travel_mm=TRAVEL, tables={"XY": 3})
    async with sinumerik_bench() as bench:
        settings = SinumerikSettings(security="none", url=bench.url, compensation=compensation, nodes=paths)
        with refusing(WrongDevice, "opcua_absent opcua_compare_path"):
            await SinumerikWithSlopes(settings, bench.clock).connect()


@pytest.mark.parametrize(
    ("fields", "field", "code"),
    [
        ({"route": "k0_slope"}, ("travel_mm",), "sinumerik_travel_missing"),
        ({"route": "k0", "travel_mm": TRAVEL}, ("travel_mm",), "sinumerik_no_travel"),
        ({"route": "r", "tables": {"XY": 0}}, ("tables",), "sinumerik_no_tables"),
        (
            {"route": "k0_slope", "travel_mm": (TRAVEL[0], (5.0, 5.0), TRAVEL[2])},
            ("travel_mm", 1),
            "sinumerik_travel_order",
        ),
        ({"route": "k0_slope", "travel_mm": TRAVEL, "tables": {"XX": 0}}, ("tables", "XX"), "sinumerik_pair"),
        ({"route": "k0_slope", "travel_mm": TRAVEL, "tables": {"XY": -1}}, ("tables", "XY"), "at_least"),
        ({"route": "k0_slope", "travel_mm": TRAVEL, "tables": {"XY": 0, "YX": 0}}, ("tables",), "sinumerik_tables"),
        (
            {"route": "k0_slope", "travel_mm": TRAVEL, "table_signs": (1, 1, 2)},
            ("table_signs", 2),
            "sinumerik_sign",
        ),
        (
            {"route": "k0_slope", "travel_mm": TRAVEL, "reference_mm": (0.0, math.nan, 0.0)},
            ("reference_mm", 1),
            "a_finite_number",
        ),
    ],
)
def test_invalid_settings_are_named(fields: dict[str, object], field: tuple[str | int, ...], code: str) -> None:
    with pytest.raises(SetupError) as raised:
        settings_of(OffsetRoute, fields)
    assert raised.value.field == field
    assert raised.value.what.says(code)
