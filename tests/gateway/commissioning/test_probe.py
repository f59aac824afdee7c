"""`talc-gateway probe` shows what every device and the NC answer, whatever their drivers raise."""

import struct
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivers.agent.control import AgentControl
from drivers.base import Refused
from drivers.nc import NcSnapshot
from gateway.cli.main import main
from gateway.nc import build as nc_build
from tests.benches.service_file import TEXT
from tests.benches.stepped_clock import SteppedClock

CONFIG = (
    TEXT
    + """
[nc]
kind = "linuxcnc"
key_file = "talc.key"
[probing]
poses_deg = [[0, 0], [0, 90], [0, 180], [0, 270], [90, 0], [-90, 0]]
"""
)


def probe(folder: Path, *options: str) -> Result:
    file = folder / "gateway.toml"
    file.write_text(CONFIG, encoding="utf-8")
    return CliRunner().invoke(main, ["probe", str(file), *options], env={"COLUMNS": "200"})


async def connected(_: AgentControl) -> None:
    """The agent is there."""


def spoil(monkeypatch: pytest.MonkeyPatch, *operations: str) -> None:
    async def raises(*_: object) -> None:
        raise struct.error("unpack requires 4 bytes")

    for operation in operations:
        monkeypatch.setattr(AgentControl, operation, raises)


@pytest.mark.parametrize("operation", ["connect", "snapshot"])
def test_an_unexpected_error_of_the_nc_is_a_row_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, operation: str
) -> None:
    monkeypatch.setattr(AgentControl, "connect", connected)
    spoil(monkeypatch, operation, "close")
    done = probe(tmp_path)
    assert done.exit_code == 3, done.output
    assert "bed_front" in done.output, "the devices are shown as well"
    assert f"unexpected error in {operation}: unpack requires 4 bytes" in done.output


@pytest.mark.parametrize(
    ("state", "shown"),
    [
        ({"cannot_probe": "[RS274NGC] ON_ABORT_COMMAND is missing"}, ["[RS274NGC] ON_ABORT_COMMAND is missing"]),
        ({"cannot_probe": ""}, []),
        ({"tool": 7, "probe_in_spindle": True}, ["7", "yes"]),
        ({"probe_in_spindle": False}, ["no"]),
    ],
)
def test_what_the_nc_reports_has_a_row_and_what_it_does_not_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, state: dict[str, Any], shown: list[str]
) -> None:
    """What keeps it from probing, the tool, and whether the probe is in the spindle."""
    monkeypatch.setattr(AgentControl, "connect", connected)

    def values(**more: Any) -> list[str]:
        async def snapshot(_: AgentControl) -> NcSnapshot:
            return NcSnapshot(SteppedClock().utc(), 0.0, dict.fromkeys("XYZAC", 0.0), **more)

        monkeypatch.setattr(AgentControl, "snapshot", snapshot)
        rows = [line.split("│") for line in probe(tmp_path).output.splitlines()]
        return sorted(row[4].strip() for row in rows if len(row) > 4)

    without = values()
    assert values(**state) == sorted(without + shown)


def test_what_rounding_leaves_of_a_position_is_shown_as_0(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    axes = {"X": 5.684e-14, "Y": -5.684e-14, "Z": -0.0, "A": 0.0014, "C": -12.5}

    async def snapshot(_: AgentControl) -> NcSnapshot:
        return NcSnapshot(SteppedClock().utc(), 0.0, axes)

    monkeypatch.setattr(AgentControl, "connect", connected)
    monkeypatch.setattr(AgentControl, "snapshot", snapshot)
    rows = [[cell.strip() for cell in line.split("│")] for line in probe(tmp_path).output.splitlines()]
    shown = {row[3]: row[4] for row in rows if len(row) > 4 and row[3].startswith("position")}
    assert [shown[f"position {axis}"] for axis in "XYZAC"] == ["0.000", "0.000", "0.000", "0.001", "-12.500"]


class Grants(AgentControl):
    """A control on which writing can be tried."""

    missing = ""

    async def try_writing(self) -> None:
        if self.missing:
            raise Refused(f"the user has not the right {self.missing}", device="nc")


@pytest.mark.parametrize("missing", ["", "SeaWrite"])
def test_writing_is_tried_only_if_asked_for_and_what_is_missing_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    async def snapshot(_: AgentControl) -> NcSnapshot:
        return NcSnapshot(SteppedClock().utc(), 0.0, dict.fromkeys("XYZAC", 0.0))

    monkeypatch.setattr(AgentControl, "connect", connected)
    monkeypatch.setattr(AgentControl, "snapshot", snapshot)
    assert "│ writing" not in probe(tmp_path).output
    assert "not tried: this control" in probe(tmp_path, "--try-writing").output
    monkeypatch.setattr(nc_build, "AgentControl", Grants)
    monkeypatch.setattr(Grants, "missing", missing)
    shown = probe(tmp_path, "--try-writing").output
    assert ("the user has not the right SeaWrite" if missing else "everything that is needed") in shown
