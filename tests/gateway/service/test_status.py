"""`status`: whether the gateway runs, decides in time and reads every channel, without disturbing it."""

import json
import math
import re
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.base import Quality
from gateway.cli.main import main
from gateway.config.applied import ConfigurationApplied
from gateway.config.file import load, parse
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.commands import Command, CommandName, CommandOutcome
from gateway.model.events import (
    CommandGiven,
    DecisionMade,
    EventReported,
    FrameMade,
    MeasurementEnded,
    ProbingRequested,
    ReadingsTaken,
)
from gateway.model.notice import Notice
from gateway.model.sample import Sample
from gateway.model.text import Text, plain
from gateway.model.wording import problem_event
from gateway.service.status import file_system_of, is_locked, status_of
from gateway.storage.store import Store
from talc.frame import Event, EventKind, Frame
from tests.benches.command import here
from tests.benches.service_file import TEXT
from tests.benches.stepped_clock import SteppedClock
from tests.benches.telemetry_examples import REFUSED
from tests.benches.telemetry_peer import decision

STEP_S = 300


def configured(folder: Path) -> GatewayConfig:
    (folder / "gateway.toml").write_text(TEXT, encoding="utf-8")
    return load(folder / "gateway.toml")


def sample(value: float, quality: Quality, at: datetime) -> Sample:
    return Sample("bed_front", value, "degC", quality, at, 0.0, sequence=1 + int(at.timestamp()) % 1000)


def test_a_gateway_that_runs_decides_and_reads_is_well_and_later_is_not(tmp_path: Path) -> None:
    config, clock = configured(tmp_path), SteppedClock()
    now = clock.utc()
    k = int(now.timestamp()) // STEP_S
    with Store(config.storage.path, "boot-1", clock) as store:
        store.begin(config.canonical(), config.fingerprint(), "", None)
        store.record(FrameMade(Frame(k, np.array([20.5]), np.array([True]))))
        store.record(DecisionMade(decision(k)))
        store.record(ReadingsTaken([sample(20.5, Quality.GOOD, now)]))
        store.record(EventReported(Event(EventKind.PROBLEM, "device rtd1: silent"), k))
        store.flush()
        well = status_of(config, now)
        assert (well.well, well.running, well.phase, well.missing) == (True, True, "calibration", ())
        assert well.readings["bed_front"] == (20.5, "degC", "good")
        assert well.problems[-1][1] == "device rtd1: silent"
        assert well.unarmed[0] == "nothing will be learnt and nothing corrected: there is no [nc]"
        assert well.paused is None
        assert (well.cycle, well.applied) == (None, True)
        store.record(ProbingRequested(5))
        store.flush()
        assert status_of(config, now).cycle == now
        store.record(MeasurementEnded(replace(REFUSED, number=5)))
        store.flush()
        assert status_of(config, now).cycle is None
        short = parse(TEXT + "[grid]\nstep_s = 10.0\n", tmp_path / "gateway.toml")
        soon = now + timedelta(seconds=config.storage.commit_s)
        assert status_of(short, soon).missing == (), "later readings wait for the disk"
        changed = parse(TEXT + "[sensor_check]\nenabled = false\n", tmp_path / "gateway.toml")
        assert not status_of(changed, now).applied
        store.record(
            CommandGiven(CommandOutcome(Command(CommandName.PAUSE, "anna"), now, accepted=True, text=plain("")))
        )
        store.flush()
        assert status_of(config, now).paused == "paused by anna since 2026-03-02 06:00 UTC"
        assert not status_of(config, now + timedelta(seconds=3 * STEP_S)).well, "it has stopped deciding"
        store.record(ReadingsTaken([sample(math.nan, Quality.SENSOR_FAULT, now + timedelta(seconds=1))]))
        store.flush()
        broken = status_of(config, now + timedelta(seconds=2))
        assert (broken.well, broken.missing) == (False, ("bed_front",))
    ended = status_of(config, now)
    assert (ended.running, ended.well) == (False, False)
    answer = here("status", str(tmp_path / "gateway.toml"))
    assert re.search(r"^mill: IS NOT RUNNING, last decision \d+ days ago$", answer.out, re.MULTILINE), answer.out


@pytest.mark.parametrize("quality", Quality)
@pytest.mark.parametrize("counts", [Quality.GOOD, Quality.STALE])
def test_a_channel_counts_as_good_by_the_rule_of_all_readings(
    quality: Quality, counts: Quality, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if that rule changes."""
    config, clock = configured(tmp_path), SteppedClock()
    with Store(config.storage.path, "boot-1", clock) as store:
        store.begin(config.canonical(), config.fingerprint(), "", None)
        store.record(ReadingsTaken([sample(20.5, quality, clock.utc())]))
        store.flush()
    monkeypatch.setattr(Quality, "usable", property(lambda one: one is counts))
    assert status_of(config, clock.utc()).missing == (() if quality is counts else ("bed_front",))


def test_a_control_that_is_not_connected_is_not_well_until_it_is_again(tmp_path: Path) -> None:
    config, clock = configured(tmp_path), SteppedClock()
    now = clock.utc()
    k = int(now.timestamp()) // STEP_S
    silent = Text(NoticeCode.NC_NOT_CONNECTED, error="device nc: silent")

    def problem(subject: str, text: Text, *, ended: bool = False) -> None:
        store.record(EventReported(problem_event(Notice(subject, text, ended)), k))
        store.flush()

    with Store(config.storage.path, "boot-1", clock) as store:
        store.begin(config.canonical(), config.fingerprint(), "", None)
        store.record(DecisionMade(decision(k)))
        store.record(ReadingsTaken([sample(20.5, Quality.GOOD, now)]))
        problem("NC", silent)
        for turn in range(20):
            problem("device rtd1", plain(f"bus rtu1, device rtd1: silent {turn}"))
            problem("device rtd1", Text(NoticeCode.ANSWERS_AGAIN, subject="device rtd1"), ended=True)
        lost = status_of(config, now)
        assert (lost.well, lost.control) == (False, ("NC: not connected: device nc: silent",))
        assert [text for _, text in lost.problems] == [lost.control[0], "device rtd1: answers again"]
        problem("NC", Text(NoticeCode.NC_CONNECTED_AGAIN), ended=True)
        again = status_of(config, now)
        assert (again.well, again.control) == (True, ())
        problem("NC", silent)
        clock.spend(1.0)
        store.record(ConfigurationApplied(config))  # without a control, or with another
        store.flush()
        assert status_of(config, now).control == ()


def test_a_new_run_is_not_well_by_what_the_one_before_it_has_read(tmp_path: Path) -> None:
    config, clock = configured(tmp_path), SteppedClock()
    now = clock.utc()
    k = int(now.timestamp()) // STEP_S
    for boot, reads in (("boot-1", True), ("boot-2", False)):
        with Store(config.storage.path, boot, clock) as store:
            store.begin(config.canonical(), config.fingerprint(), "", None)
            if reads:
                store.record(FrameMade(Frame(k, np.array([20.5]), np.array([True]))))
                store.record(DecisionMade(decision(k)))
                store.record(ReadingsTaken([sample(20.5, Quality.GOOD, now)]))
            store.flush()
            found = status_of(config, now)
            assert (found.well, found.missing) == (reads, () if reads else ("bed_front",))


def test_a_file_of_the_same_number_on_another_disk_is_another_file() -> None:
    locks = "1: POSIX  ADVISORY  WRITE 7 00:1a:3 0 EOF\n2: FLOCK  ADVISORY  WRITE 12 fe:00:3 0 EOF\n"
    mounts = "21 1 254:0 / / rw - ext4 /dev/vda rw\n29 21 0:26 / /run rw - tmpfs tmpfs rw\n"
    root, run = (file_system_of(f"pos:\t0\nflags:\t0100000\nmnt_id:\t{mount}\nino:\t3\n", mounts) for mount in (21, 29))
    assert is_locked(locks, root, 3)
    assert not is_locked(locks, root, 2)
    assert not is_locked(locks, run, 3)
    assert is_locked(locks, file_system_of("mnt_id:\t99\n", mounts), 3), "not known where: as if it were this one"


def test_the_command_reads_and_its_exit_code_says_it(tmp_path: Path) -> None:
    configured(tmp_path)
    file = str(tmp_path / "gateway.toml")
    answer = CliRunner().invoke(main, ["status", file], catch_exceptions=False)
    assert answer.exit_code == 3
    assert "mill: IS NOT RUNNING, no decision yet\n" in answer.output
    assert "channels: none of 1 is read\n" in answer.output
    lines = answer.output.splitlines()
    assert lines[lines.index("compensation monitor, probing not armed") + 1] == (
        "nothing will be learnt and nothing corrected: there is no [nc]"
    )
    found = json.loads(CliRunner().invoke(main, ["status", file, "--json"], catch_exceptions=False).output)
    assert (found["machine"], found["running"], found["well"]) == ("mill", False, False)
    assert found["unarmed"] == ["nothing will be learnt and nothing corrected: there is no [nc]"]
    assert not (tmp_path / "gateway.sqlite").exists(), "nothing is made"
