"""`talc-gateway nc dry-run` on an emulated control in real time, and who asks for it before."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from gateway.commissioning.doctor.health import health_findings
from gateway.config.file import load
from simulators.nc import CycleSettings, EmulatedControl
from simulators.nc.alone import OwnTime, lone_control
from simulators.nc.cycle import CycleAnswer, CycleState
from simulators.nc.nck import R_VERSION
from tests.benches.command import beside, here
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.started import started

CYCLE = CycleSettings(duration_s=1.2, approach_s=0.1)
TEXT = (
    MACHINE
    + """
[nc]
kind = "sinumerik"
url = "URL"
security = "none"
[storage]
path = "gateway.sqlite"
[probing]
armed = true
sphere_radius_mm = RADIUS
sphere_height_mm = 80.0
[compensation]
mode = "compensate"
"""
    + adam6015("bed = 0, column = 1")
)


def text(url: str, radius_mm: float) -> str:
    return TEXT.replace("URL", url).replace("RADIUS", str(radius_mm))


ASKS = "no dry run was done"


@asynccontextmanager
async def emulated() -> AsyncIterator[tuple[EmulatedControl, str]]:
    control = lone_control(OwnTime(), CYCLE, 5.0, 0)
    async with started(control) as url:
        yield control, url


def test_it_is_asked_for_until_it_has_gone_well_with_this_geometry(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with beside(emulated()) as (control, url):
        file.write_text(text(url, 120.0), encoding="utf-8")
        assert ASKS in here("check", str(file)).out
        assert ASKS in here("status", str(file)).out
        assert any(ASKS in found.what for found in health_findings(load(file), tmp_path, synchronised=True))

        file.write_text(text(url, 170.0), encoding="utf-8")  # not where the control's sphere is
        elsewhere = here("nc", "dry-run", str(file), "--height-mm", "60")
        assert elsewhere.code == 3, elsewhere.together
        assert "beside the sphere" in elsewhere.together
        assert ASKS in here("check", str(file)).out

        file.write_text(text(url, 120.0), encoding="utf-8")
        well = here("nc", "dry-run", str(file), "--height-mm", "60")
        assert well.code == 0, well.together
        assert len((tmp_path / "gateway.dry-run.txt").read_text("utf-8").splitlines()) == 1 + 2 + 6 + 5
        assert len(control.nck.cycle.raised_mm) == 2
        for command in ("check", "status"):
            assert ASKS not in here(command, str(file)).out
        assert not any(ASKS in found.what for found in health_findings(load(file), tmp_path, synchronised=True))

        control.nck.cycle.answer = CycleAnswer(0, CycleState.IDLE)  # as if that command had been killed before
        again = here("nc", "dry-run", str(file), "--height-mm", "60")
        assert again.code == 0, again.together

        control.nck.version, control.nck.r[R_VERSION] = 0, 1.0
        older = here("nc", "dry-run", str(file))
        assert older.code == 3
        assert "not offered" in older.together
        assert len(control.nck.cycle.ended) == 3
    file.write_text(text(url, 120.5), encoding="utf-8")
    assert ASKS in here("check", str(file)).out


@pytest.mark.parametrize("nc", ["", '[nc]\nkind = "mtconnect"\nurl = "http://127.0.0.1:5000"\n'])
def test_without_a_control_that_probes_nothing_is_tried(nc: str, tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(f"{MACHINE}\n{nc}" + adam6015("bed = 0, column = 1"), encoding="utf-8")
    done = here("nc", "dry-run", str(file))
    assert done.code == 2
    assert not (tmp_path / "gateway.sqlite").exists()
