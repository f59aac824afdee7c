"""Each column of a stored step, compared with what the emulated control itself did and where its axes were."""

import json
import math
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import datetime
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest

from gateway.model.events import CompensationStepped
from gateway.storage.store import Store
from simulators.nc import MeanLoads
from talc import kinematics
from talc.frame import Decision, FloatArray
from talc.names import THERMAL_ERRORS
from tests.benches.nc_link_bench import decision
from tests.benches.stepped_clock import EPOCH
from tests.benches.wire_bench import BOUND_UM, WireBench, wire_bench

pytestmark = pytest.mark.simulated_time

MOVING = MeanLoads(x=600.0, y=450.0, z=300.0, a=0.5, c=2.0, spindle=6000.0)
COLUMNS = "time, mode, source, k, target, offsets, positions, written, read_back, coefficients"


def rotary(k: int) -> Decision:
    """It grows with k, and what cancels it depends on where the axes are."""
    found = decision(2.0 * k)
    found.corrected[THERMAL_ERRORS.index("EC0C")] = 20.0 * k
    return replace(found, k=k)


def array(blob: bytes) -> FloatArray:
    return np.frombuffer(blob, dtype="<f8")


async def go_on(bench: WireBench, seconds: float) -> float:
    await bench.clock.run_until(bench.clock.monotonic() + seconds)
    return bench.clock.monotonic()


async def test_every_write_is_in_the_store_with_what_it_rests_on(tmp_path: Path) -> None:
    sent: dict[float, dict[int, float]] = {}  # by time and axis, µm
    events: list[tuple[float, str, str, int | None]] = []  # from when on: mode, source and k of a step
    async with wire_bench(tmp_path, loads=MOVING) as bench:
        nck, write_k0 = bench.control.nck, bench.control.nck.write_k0

        def noted(axis: int, value_mm: float, now_s: float) -> None:
            sent.setdefault(now_s, {})[axis] = -1e3 * value_mm
            write_k0(axis, value_mm, now_s)

        nck.write_k0 = noted  # type: ignore[method-assign]
        for mode in ("compensate", "advise"):
            events.append((bench.clock.monotonic(), mode, "no_model", None))
            async with bench.running(bench.link(mode)) as link:
                now = await go_on(bench, 0.5)
                for k in range(1, 4):
                    link.follow(rotary(k))
                    events.append((now, mode, "prediction", k))
                    now = await go_on(bench, 8.0)
                nck.emergency_stop(now)
                events.append((now, mode, "not_ready", 3))
                nck.clear_alarms(await go_on(bench, 3.0))
        with Store(tmp_path / "gateway.sqlite", "boot", bench.clock) as store:
            for write in bench.writes:
                store.record(CompensationStepped(write))
        with closing(sqlite3.connect(tmp_path / "gateway.sqlite")) as database:
            rows = database.execute(f"SELECT {COLUMNS} FROM compensation ORDER BY id").fetchall()
        seen, written_at = [], set[float]()
        for time, mode, source, k, target, offsets, positions, written, read_back, coefficients in rows:
            at = (datetime.fromisoformat(time) - EPOCH).total_seconds()
            assert (mode, source, k) == max((e for e in events if e[0] <= at), key=itemgetter(0))[1:], at
            here = nck.state(at).positions
            assert json.loads(positions) == pytest.approx(here), at
            seen.append(list(here.values()))
            if source == "prediction":
                mm_rad = np.array([here[a] for a in "XYZ"] + [math.radians(here[a]) for a in "AC"])
                wanted = kinematics.tcp_offsets(rotary(k).corrected, mm_rad, 0.12)
                np.testing.assert_allclose(array(target), np.clip(wanted, -np.array(BOUND_UM), BOUND_UM), atol=1e-9)
            assert (written == 1) is (at in sent), at
            if written:
                written_at.add(at)
                on_the_control = [sent[at][axis] for axis in range(3)]
                for blob in (offsets, read_back, coefficients):
                    np.testing.assert_allclose(array(blob), on_the_control, atol=1e-6)
            else:
                assert read_back is None
                np.testing.assert_array_equal(array(coefficients), array(offsets))
    assert written_at == set(sent), "while the axes move no step is like the one before"
    assert np.ptp(seen, axis=0).min() > 10.0, "every axis moves"
    assert [row[7] for row in rows].count(1) > 20
    assert {tuple(row[1:3]) for row in rows if not row[7]} >= {("compensate", "not_ready"), ("advise", "prediction")}
