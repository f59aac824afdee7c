"""What `run` says: to systemd through a real socket, and in its log at the start and at the end."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.config.file import load
from gateway.service.run import ramp_s
from gateway.service.service_manager import ServiceManager
from gateway.storage.history import History
from tests.benches.database import applied
from tests.benches.service_file import FILE, TEXT
from tests.benches.waits import wait_until

LIMIT_S = 120.0
QUIET = "[telemetry]\nenabled = false\n"


@pytest.fixture
def manager(tmp_path: Path) -> socket.socket:
    """systemd's end of the socket."""
    receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    receiver.bind(str(tmp_path / "notify"))
    receiver.settimeout(LIMIT_S)
    return receiver


def receive(manager: socket.socket, until: str) -> list[list[str]]:
    """The datagrams as lines, up to the one that begins with `until`."""
    found: list[list[str]] = []
    while not found or found[-1][0] != until:
        found.append(manager.recv(4096).decode().splitlines())
    return found


@pytest.mark.slow
def test_the_service_tells_systemd_what_it_does_and_applies_a_good_file_alone(
    tmp_path: Path, manager: socket.socket
) -> None:
    """At SIGHUP it reads its file again."""
    file, text = tmp_path / "own" / "gateway.toml", TEXT + QUIET
    file.parent.mkdir()
    file.write_text(text, encoding="utf-8")
    first = load(file).fingerprint()
    environment = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "3000000"}
    with manager, (tmp_path / "log").open("w+") as log:

        def reread(old: str, new: str, said: str) -> None:
            file.write_text(text.replace(old, new), encoding="utf-8")
            process.send_signal(signal.SIGHUP)
            wait_until(lambda: said in (tmp_path / "log").read_text(encoding="utf-8"), LIMIT_S)

        process = subprocess.Popen([sys.executable, "-m", "gateway", "run", str(file)], stderr=log, env=environment)
        try:
            began = receive(manager, "READY=1")
            receive(manager, "WATCHDOG=1")
            receive(manager, "WATCHDOG=1")
            reread("adapter", "other", "buses exchanged: rtu1")
            second = load(file).fingerprint()
            receive(manager, "READY=1")
            reread("unit = 1", "units = 1", "unknown key; did you mean 'unit'?")
            reread("bed_front", "bed_rear", "inputs changed (gone: bed_front; new: bed_rear)")
            process.send_signal(signal.SIGTERM)
            ended = receive(manager, "STOPPING=1")[-1]
            assert process.wait(LIMIT_S) == 0
        finally:
            process.kill()
            process.wait()
        log.seek(0)
        said = log.read()
    assert began[-1] == ["READY=1", "STATUS=machine mill"]
    assert ended == ["STOPPING=1", "STATUS=stopping", "EXTEND_TIMEOUT_USEC=60000000"], "no control: no ramp"
    assert f"runs machine mill, configuration {first[:16]}: 1 bus, 1 device, 1 channel, 0 machine states" in said
    assert "bus rtu1: modbus_rtu at /nowhere/adapter, 1 channel every 1 s" in said
    assert "control: none; compensation monitor, probing not armed" in said
    assert f"store: {file.parent}/gateway.sqlite" in said
    assert "nothing will be learnt and nothing corrected: there is no [nc]" in said
    assert "talc-gateway has ended after" in said.splitlines()[-1]
    database = file.parent / "gateway.sqlite"
    assert sorted(p.name for p in file.parent.iterdir()) == ["gateway.sqlite", "gateway.toml"], "closed, no lock left"
    assert [fingerprint for _, fingerprint in applied(database)] == [first, second], "only what took effect"
    with History(database) as history:
        stored = history.config()
    assert stored is not None
    assert stored[1] == second
    assert '"/nowhere/other"' in stored[0]


def test_a_manager_that_is_gone_or_reads_nothing_does_not_stop_the_gateway(tmp_path: Path) -> None:
    absent = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "absent"), "WATCHDOG_USEC": "1"})
    absent.ready("mill")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as full:
        full.bind(str(tmp_path / "full"))
        deaf = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "full")})
        for _ in range(5000):
            deaf.alive()


def test_without_systemd_nothing_is_sent_and_another_process_s_watchdog_is_not_ours() -> None:
    assert ServiceManager({"WATCHDOG_USEC": "1000000"}).watchdog_s is None
    other = {"NOTIFY_SOCKET": "@abstract", "WATCHDOG_USEC": "90000000", "WATCHDOG_PID": "1"}
    assert ServiceManager(other).watchdog_s is None
    assert ServiceManager({**other, "WATCHDOG_PID": str(os.getpid())}).watchdog_s == 90.0


def test_the_time_to_stop_is_that_of_the_configured_ramp() -> None:
    config = load(FILE)
    compensation = config.compensation.model_copy(
        update={"mode": "compensate", "bound_um": (20.0, 80.0, 50.0), "slew_um_per_s": 0.5, "when_stale": "hold"}
    )
    writing = config.model_copy(update={"compensation": compensation})
    assert ramp_s(writing) == 160.0
    advising = compensation.model_copy(update={"mode": "advise"})
    assert ramp_s(config.model_copy(update={"compensation": advising})) == 0.0


DRY = "nothing will be learnt: no dry run was done"


@pytest.mark.parametrize(
    ("nc", "armed", "mode", "said"),
    [
        (True, False, "monitor", ["nothing will be learnt: probing is not armed", "nothing is written to the control"]),
        (True, True, "advise", ["nothing is written to the control: [compensation] mode is 'advise'", DRY]),
        (True, True, "compensate", [DRY]),
        (False, False, "monitor", ["nothing will be learnt and nothing corrected: there is no [nc]"]),
    ],
)
def test_check_says_what_is_not_armed_and_what_follows(
    nc: bool, armed: bool, mode: str, said: list[str], tmp_path: Path
) -> None:
    text = TEXT + '[telemetry]\nlisten = ["tcp/127.0.0.1:7447"]\n'
    if nc:
        (tmp_path / "talc.key").write_text("k" * 64, encoding="utf-8")
        text += '[nc]\nkind = "linuxcnc"\nkey_file = "talc.key"\n'
        text += f"[probing]\narmed = {str(armed).lower()}\n[compensation]\nmode = '{mode}'\n"
    (tmp_path / "gateway.toml").write_text(text, encoding="utf-8")
    answer = CliRunner().invoke(main, ["check", str(tmp_path / "gateway.toml")], catch_exceptions=False)
    assert answer.exit_code == 0
    lines = [line for line in answer.output.splitlines() if line.startswith("no")]
    assert len(lines) == len(said)
    assert all(line.startswith(text) for line, text in zip(lines, said, strict=True))
