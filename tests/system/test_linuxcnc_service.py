"""The whole service with the real LinuxCNC, which stands idle in MANUAL as an operator leaves it.

Needs Debian's linuxcnc-uspace.
"""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from drivers.nc import OperatingMode
from gateway.config.extended import validate
from gateway.control.restart.earlier import EarlierRun
from gateway.model.codes import NoticeCode
from gateway.model.probing import End
from gateway.model.standing import Standing
from gateway.model.text import NOTHING
from gateway.runtime.clocks import RealClock
from gateway.service.service import Service
from simulators.linuxcnc.machine import HURRY, MANUAL
from talc.control import Controller
from talc.frame import Why
from tests.benches.kept_events import KeptEvents
from tests.benches.linuxcnc_bench import ANSWER_S, running, until

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(60)]


async def test_an_idle_machine_is_probed_once_allowed_and_a_loose_sphere_is_rejected(tmp_path: Path) -> None:
    machine = {**HURRY, "FEED": 60, "FIND_FEED": 2000}
    async with running(tmp_path, machine, sphere=True, tools="T99 P99 Z40 D6 ;probe\n") as bench:
        await bench.nc.close()  # the service is the one client
        config = validate(
            {
                "machine": {"name": "linuxcnc"},
                "grid": {"step_s": 2.0},
                "nc": {
                    "kind": "linuxcnc",
                    "key_file": str(bench.settings.key_file),
                    "port": bench.settings.port,
                    "period_s": 0.1,
                    "timeout_s": ANSWER_S,
                },
                "probing": {
                    **{"armed": True, "lead_s": 0.0, "poll_s": 0.1},
                    **{"timeout_s": 240.0, "reference_cycles": 1},
                },
                "storage": {"path": str(tmp_path / "gateway.sqlite")},
            }
        )
        told, stop = KeptEvents(), asyncio.Event()
        controller, paths = Controller(config.input_names, config.talc), frozenset({bench.nc.path_mark})
        service = Service(config, RealClock(), told, EarlierRun(controller, proven=True, paths=paths))
        at_work = asyncio.create_task(service.run(stop))

        async def said(*standings: Standing) -> bool:
            assert not at_work.done()
            return [o.standing for o in told.outlooks][: len(standings)] == list(standings)

        async def rejected() -> bool:
            assert not at_work.done()
            return any(outcome.end is End.REJECTED for outcome in told.outcomes)

        async def measured() -> bool:
            assert not at_work.done()
            return any(frame.measurement is not None for frame in told.frames)

        try:
            await until(lambda: said(Standing.BLOCKED))
            blocked = told.outlooks[0].reason
            assert (blocked.code, blocked.values["code"]) == (NoticeCode.NC_CANNOT_PROBE, "may_start")
            assert service.link is not None
            assert service.link.present is not None
            assert service.link.present.mode is OperatingMode.JOG
            await bench.operator.ask("loosen", 30.0)
            standing = (await bench.operator.ask("state"))["position"]
            await bench.operator.ask("hal", "setp", "talc.may-start", "1")
            await until(lambda: said(Standing.BLOCKED, Standing.DUE, Standing.ASKED))
            await until(rejected)
            await bench.operator.ask("loosen", 0.0)
            await until(measured)
        finally:
            stop.set()
            await at_work
        # A computer that is too busy to answer refuses a cycle, and the service requests it again.
        loose, fixed = [outcome for outcome in told.outcomes if outcome.end is not End.REFUSED][:2]
        assert (loose.why, loose.end, loose.measurement) == (Why.CALIBRATION, End.REJECTED, None)
        assert loose.reason.code == NoticeCode.TOUCHES_APART
        assert loose.reason.values["spread_um"] == pytest.approx(30.0, abs=1.5)
        assert (fixed.why, fixed.end, fixed.reason) == (Why.RETRY, End.MEASURED, NOTHING)
        assert fixed.centres_mm is not None
        assert np.abs(np.linalg.norm(fixed.centres_mm, axis=1) - np.hypot(120.0, 80.0)).max() < 0.01
        assert standing == pytest.approx([0.0] * 5, abs=1e-6), "not allowed, it stands"
        # The agent waits for the end of the program, which comes after its result.
        await until(lambda: bench.operator.sees(mode=MANUAL))
