"""A new configuration while the gateway runs."""

from pathlib import Path

import pytest

from drivers.base import Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.acquisition.line import Line
from gateway.acquisition.reload import BusChanges, ReloadError, apply, bus_changes, prepare
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from tests.benches.logger_files import logger_dbc, logger_profile
from tests.benches.stepped_clock import SteppedClock

FILE = Path(__file__).parents[1] / "config" / "cases" / "valid" / "gateway.toml"
TEXT = FILE.read_text(encoding="utf-8").replace("192.168.0.10", "127.0.0.1")


def config(*edits: tuple[str, str], more: str = "") -> GatewayConfig:
    text = TEXT
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return parse(more + text, FILE)


@pytest.mark.parametrize(
    ("edits", "more"),
    [
        ([("unit = 1", "unit = 2")], ""),
        ([("/dev/serial/by-id/usb-adapter", "/dev/serial/by-id/other")], ""),
        ([("bed_rear = 1", "bed_rear = 5")], ""),
        ([], "[limits.bed_rear]\nmax = 60\n"),
    ],
)
def test_only_the_bus_that_changed_is_exchanged(edits: list[tuple[str, str]], more: str) -> None:
    assert bus_changes(config(), config(*edits, more=more)) == BusChanges(("rtu1",), ("rtu1",), ("tcp1",))


def test_nothing_changed_nothing_done() -> None:
    assert bus_changes(config(), config(more="# a remark\n")) == BusChanges((), (), ("rtu1", "tcp1"))


def test_a_renamed_bus_goes_and_comes() -> None:
    assert bus_changes(config(), config(("tcp1", "tcp2"))) == BusChanges(("tcp1",), ("tcp2",), ("rtu1",))


@pytest.mark.parametrize(
    ("edits", "more", "named"),
    [
        ([], "[talc.control]\ncalibration_steps = 100\n", r"\[talc\]"),
        ([], '[grid]\nstep_s = 600\n[storage]\npath = "other.sqlite"\n', r"\[grid\], \[storage\]"),
        ([("bed_rear = 1", "bed_left = 1")], "", "gone: bed_rear; new: bed_left"),
        ([("bed_front = 0\nbed_rear = 1", "bed_rear = 1\nbed_front = 0")], "", "their order"),
    ],
)
def test_what_needs_a_restart_is_refused_by_name(edits: list[tuple[str, str]], more: str, named: str) -> None:
    with pytest.raises(ReloadError, match=named):
        bus_changes(config(), config(*edits, more=more))


class RunningAcquisition:
    """An acquisition of the configuration's real drivers, none of which will ever open."""

    def __init__(self, of: GatewayConfig) -> None:
        self.clock = SteppedClock()
        self.readings: list[Reading] = []
        self.acquisition = Acquisition(lines_of(of, self.clock), self.clock, self.readings.extend, lambda _: None)


PROFILES = Path(__file__).parents[3] / "drivers" / "profiles"


def with_profile(folder: Path, profile: str = "mine.toml") -> GatewayConfig:
    """The configuration of a file in the folder, with the profile beside it."""
    return parse(TEXT.replace("icpdas_m7015", profile), folder / "gateway.toml")


async def test_a_profile_may_be_renamed_together_with_the_configuration(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_bytes((PROFILES / "icpdas_m7015.toml").read_bytes())
    old = with_profile(tmp_path)
    running = RunningAcquisition(old)
    async with running.acquisition as acquisition:
        mine.rename(tmp_path / "yours.toml")
        new = with_profile(tmp_path, "yours.toml")
        change = await apply(acquisition, prepare(old, new, running.clock))
        assert set(acquisition.runners) == {"rtu1", "tcp1"}
    assert change == BusChanges(("rtu1",), ("rtu1",), ("tcp1",))


def test_the_bus_of_an_edited_profile_is_exchanged(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    text = (PROFILES / "icpdas_m7015.toml").read_text(encoding="utf-8")
    mine.write_text(text, encoding="utf-8")
    old, again = with_profile(tmp_path), with_profile(tmp_path)
    assert bus_changes(old, again) == BusChanges((), (), ("rtu1", "tcp1"))
    assert old.fingerprint() == again.fingerprint()
    mine.write_text(text.replace("title = ", "title = 'x' # "), encoding="utf-8")
    new = with_profile(tmp_path)
    assert bus_changes(old, new) == BusChanges(("rtu1",), ("rtu1",), ("tcp1",))
    assert old.fingerprint() != new.fingerprint()


def test_the_bus_of_an_edited_dbc_file_is_exchanged(tmp_path: Path) -> None:
    text = (
        '[machine]\nname = "mill"\n[[bus]]\nname = "can1"\nkind = "can"\nchannel = "can0"\n[[device]]\n'
        'name = "logger"\nbus = "can1"\nprofile = "logger.toml"\n[device.channels]\nbed = 0\n'
    )
    logger_profile(tmp_path)
    old = parse(text, tmp_path / "gateway.toml")
    (tmp_path / "logger.dbc").write_text(logger_dbc().replace("(0.1,0)", "(0.01,0)"))
    new = parse(text, tmp_path / "gateway.toml")
    assert bus_changes(old, new) == BusChanges(("can1",), ("can1",), ())
    assert old.fingerprint() != new.fingerprint()


async def test_applied_to_a_running_acquisition() -> None:
    old, new = config(), config(("unit = 1", "unit = 2\n"), ('by-id/usb-adapter"', 'by-id/x"\nperiod_s = 2.0'))
    running = RunningAcquisition(old)
    async with running.acquisition as acquisition:
        before = acquisition.runners
        change = await apply(acquisition, prepare(old, new, running.clock))
        after = acquisition.runners
    assert change.kept == ("tcp1",)
    assert after["tcp1"] is before["tcp1"]
    assert after["rtu1"] is not before["rtu1"]
    assert after["rtu1"].line.period_s == 2.0


class Breaking(Acquisition):
    """Fails once in the middle of an exchange, after the old bus was stopped."""

    broken = False

    async def exchange(self, stop: object, start: object) -> None:
        assert isinstance(stop, tuple | list)
        assert isinstance(start, list)
        if not self.broken:
            self.broken = True
            await super().exchange(stop, [])
            raise OSError("out of memory")
        await super().exchange(stop, start)


async def test_a_failed_exchange_is_undone_without_the_old_files(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_bytes((PROFILES / "icpdas_m7015.toml").read_bytes())
    old, new = with_profile(tmp_path), with_profile(tmp_path, "icpdas_m7015")
    running = RunningAcquisition(old)
    lines: list[Line] = list(lines_of(old, running.clock))
    mine.unlink()
    async with Breaking(lines, running.clock, running.readings.extend, lambda _: None) as acquisition:
        kept = acquisition.runners["tcp1"]
        with pytest.raises(OSError, match="out of memory"):
            await apply(acquisition, prepare(old, new, running.clock))
        assert set(acquisition.runners) == {"rtu1", "tcp1"}
        assert acquisition.runners["tcp1"] is kept
        assert acquisition.runners["rtu1"].line is lines[0]
