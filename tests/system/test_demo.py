"""The whole loop in a short run: emulated machine, drivers, TALC, NC, Zenoh; then the files that it left."""

import csv
import json
import os
import shlex
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
import urllib.request
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import zenoh

from gateway.control.replay.stored import replay
from gateway.reporting.figures import summary
from gateway.service.report_data import collect
from gateway.storage.history import History
from gateway.telemetry.codec import decode
from gateway.telemetry.messages import ForecastMessage, FrameMessage
from talc.frame import EventKind, FloatArray, Phase
from tests.benches.command import here
from tests.benches.free_port import free_port
from tests.benches.zenoh_sessions import listening

pytestmark = pytest.mark.slow

HOURS = 9.0
LIMIT_S = 300.0
"""For one answer, or for the next row of the database; a whole demo takes as long as the computer needs."""
GATEWAY = (sys.executable, "-m", "gateway")


def demo_arguments(folder: Path, port: int, hours: float = HOURS, *more: str) -> list[str]:
    return ["demo", "--hours", str(hours), "--folder", str(folder), "--zenoh-port", str(port), *more]


def demo_command(folder: Path, port: int, hours: float = HOURS, *more: str) -> list[str]:
    return [*GATEWAY, *demo_arguments(folder, port, hours, *more)]


def finished(process: "subprocess.Popen[str]", folder: Path) -> str:
    """What it printed until it ended. Raises subprocess.TimeoutExpired when it stores nothing new within the limit."""
    stored = -1
    while True:
        try:
            return process.communicate(timeout=LIMIT_S)[0]
        except subprocess.TimeoutExpired:
            before, stored = stored, stored_rows(folder / "gateway.sqlite")
            if stored == before:
                raise


def stored_rows(database: Path) -> int:
    """How many frames there are so far; none before the database is made."""
    try:
        with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
            return int(connection.execute("SELECT count(*) FROM frame").fetchone()[0])
    except sqlite3.OperationalError:
        return 0


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True)
class DemoRun:
    """One demo, run once for all tests of this module."""

    folder: Path
    output: str
    published_frames: list[int]
    published_kinds: set[str]
    planned: set[str]
    """Loads of which the forecasts said something."""


def machine_pids(folder: Path) -> list[int]:
    """Emulated machines that run for this folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if b"simulators.bench" in words and str(folder).encode() in words:
                found.append(int(entry.name))
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> DemoRun:
    folder, port, our_port = tmp_path_factory.mktemp("demo"), free_port(), free_port()
    frames: list[int] = []
    kinds: set[str] = set()
    planned: set[str] = set()
    lock = threading.Lock()

    def take(sample: zenoh.Sample) -> None:
        suffix = str(sample.key_expr).removeprefix("talc/bench/")
        with lock:
            kinds.add(suffix.split("/")[0])
            message = decode(suffix, sample.payload.to_bytes())
            if isinstance(message, FrameMessage):
                frames.append(message.k)
            if isinstance(message, ForecastMessage):
                planned.update(message.planned)

    # An ordinary subscriber that is there before the gateway, so that it can see the first frame.
    with listening(our_port) as session:
        subscriber = session.declare_subscriber("talc/bench/**", take)
        command = demo_command(folder, port, HOURS, "--connect", f"tcp/127.0.0.1:{our_port}")
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
        )
        try:
            output = finished(process, folder)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        subscriber.undeclare()
    assert process.returncode == 0, output
    return DemoRun(folder, output, frames, kinds, planned)


def connect(port: int, process: subprocess.Popen[str]) -> zenoh.Session:
    """Join as soon as the gateway listens."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("connect/timeout_ms", "2000")
    config.insert_json5("scouting/multicast/enabled", "false")
    deadline = time.monotonic() + LIMIT_S
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError:
            if time.monotonic() > deadline or process.poll() is not None:
                raise
            time.sleep(0.05)


def test_compensation_begins_with_the_first_measurement(run: DemoRun) -> None:
    with History(run.folder / "gateway.sqlite") as history:
        steps = list(history.steps())
    first = next(i for i, s in enumerate(steps) if s.frame.measurement is not None)
    assert first <= 6, "half an hour"
    assert {s.decision.phase for s in steps[:first]} == {Phase.CALIBRATION}
    assert {s.decision.phase for s in steps[first:]} == {Phase.COMPENSATION}
    assert not any(s.adopted for s in steps)


def test_the_three_largest_errors_are_more_than_halved_after_six_hours(run: DemoRun) -> None:
    data = collect(run.folder / "gateway.sqlite", run.folder / "truth.csv")
    assert data.truth is not None
    use = data.truth.time_s >= 6 * 3600
    at = np.searchsorted(data.time_s, data.truth.time_s[use], side="right") - 1
    before, after = data.truth.errors[use], data.truth.errors[use] - data.corrected[at]
    for e in np.argsort(-np.sqrt(np.mean(before[:, :6] ** 2, axis=0)))[:3]:
        assert rms(after[:, e]) < 0.5 * rms(before[:, e]), e


def test_no_error_is_made_worse_and_those_that_nothing_is_known_of_stay_untouched(run: DemoRun) -> None:
    data = collect(run.folder / "gateway.sqlite", run.folder / "truth.csv")
    assert data.trusted is not None
    for e, row in enumerate(summary(data).rows):
        assert row.compensated_e_rms <= max(1.05 * row.e_rms, 2.0), row
        assert not np.any(data.corrected[~data.trusted[:, e] & np.isfinite(data.corrected[:, e]), e])


@pytest.mark.parametrize(("begin_h", "end_h"), [(2.0, 6.0), (6.0, HOURS)])
def test_the_control_really_shifts_the_tool_from_the_first_hours_on(run: DemoRun, begin_h: float, end_h: float) -> None:
    with (run.folder / "truth.csv").open(encoding="ascii") as file:
        rows = [[float(v) for v in row] for row in list(csv.reader(file))[1:]]
    values = np.array(rows)
    hours = (values[:, 0] - values[0, 0]) / 3600
    use = (hours >= begin_h) & (hours < end_h) & (values[:, 16] == 0)
    without, with_ = values[use, 10:13], values[use, 13:16]
    assert rms(with_) < 0.5 * rms(without)


def test_probing_requests_made_the_round_trip(run: DemoRun) -> None:
    with History(run.folder / "gateway.sqlite") as history:
        cycles = history.measurements()
    numbers = [m.number for m in cycles]
    assert len(set(numbers)) == len(numbers)
    good = [m for m in cycles if m.errors is not None]
    assert HOURS / 4 <= len(good) <= HOURS * 3, "each 4 h at the least, each 20 min at the most"
    assert all(m.centres_mm is not None and m.centres_mm.shape == (6, 3) for m in good)
    # What was probed agrees with how the machine's own errors changed since the reference, which a busy computer may
    # have had probed late, apart from probing noise.
    with (run.folder / "truth.csv").open(encoding="ascii") as file:
        truth = np.array([[float(v) for v in row[:7]] for row in list(csv.reader(file))[1:]])
    probed = np.array([m.errors[:6] for m in good if m.errors is not None])
    at = np.searchsorted(truth[:, 0], [m.ended.timestamp() for m in good], side="right") - 1
    change = truth[at, 1:] - truth[at[0], 1:]
    assert (np.abs(np.median(probed - change, axis=0)) < 3.0).all()


def test_a_subscriber_saw_every_frame(run: DemoRun) -> None:
    with History(run.folder / "gateway.sqlite") as history:
        stored = [s.frame.k for s in history.steps()]
    assert run.published_frames == stored
    wanted = {"reading", "frame", "decision", "measurement", "reasons", "event", "compensation", "status"}
    assert wanted <= run.published_kinds
    assert run.planned == {"warm-up"}


def test_replay_is_identical(run: DemoRun) -> None:
    with History(run.folder / "gateway.sqlite") as history:
        result = replay(history)
    assert result.identical, result.first
    assert result.steps == len(run.published_frames)


def test_its_last_line_says_where_to_look_and_its_days_are_played_again_and_answer_what_if(run: DemoRun) -> None:
    words = shlex.split(run.output.splitlines()[-1])
    (report,) = (Path(urlsplit(word).path) for word in words if word.startswith("file:"))
    assert report.read_text(encoding="utf-8").startswith("<!doctype html>")
    at = words.index("talc-gateway") + 1
    command = [*GATEWAY, *words[at : words.index(str(run.folder)) + 1], "--zenoh-port", str(free_port())]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().split()[-1]
            with urllib.request.urlopen(f"{address}stream/bench", timeout=LIMIT_S) as stream:
                seen = (json.loads(line[6:]) for line in stream if line.startswith(b'data: {"machine"'))
                judged = next(each for each in seen if each["axes"] and each["branches"])
            assert (judged["alive"], judged["simulated"], len(judged["channels"])) == (True, True, 30)
            with urllib.request.urlopen(f"{address}scenario/bench?minutes=20", timeout=LIMIT_S) as answer:
                found = json.load(answer)
            assert found["said"][0]["say"] == "scenario.unknown", "nine hours are no two days"
        finally:
            process.kill()


def test_every_channel_was_good_and_every_frame_complete(run: DemoRun) -> None:
    with History(run.folder / "gateway.sqlite") as history:
        steps, events = list(history.steps()), history.events()
        health = history.channel_health()
    assert len(health) == 30
    # A busy computer may answer too late once; nothing else may go wrong, and no frame may lack a value.
    assert all(set(qualities) <= {"good", "comm_fault"} for qualities in health.values()), health
    assert all(qualities.get("comm_fault", 0) <= qualities["good"] / 200 for qualities in health.values()), health
    assert all(s.frame.valid.all() for s in steps[1:])
    problems = [e.text for _, _, e in events if e.kind is EventKind.PROBLEM and " within " not in e.text]
    assert [text for text in problems if "did not receive the heartbeat" not in text] == []
    assert len(problems) <= 1, problems


def test_a_picture_of_the_run_is_made(run: DemoRun) -> None:
    picture = (run.folder / "report.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert 10_000 < len(picture) < 500_000


def test_nothing_stays_behind(run: DemoRun) -> None:
    assert machine_pids(run.folder) == []
    assert not list(run.folder.glob("*.lock"))


def test_a_system_of_models_calibrates_adopts_them_and_is_replayed(tmp_path: Path) -> None:
    command = demo_command(tmp_path, free_port(), 5.0, "--method", "models", "--calibration-hours", "4")
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            output = finished(process, tmp_path)
        finally:
            process.kill()
    assert process.returncode == 0, output
    assert "calibration -> compensation" in output
    with History(tmp_path / "gateway.sqlite") as history:
        steps, result = list(history.steps()), replay(history)
    adopted = [m for s in steps for models in s.adopted for m in models.models]
    assert len(adopted) >= 9
    assert all(m is not None and abs(m.poles()).max(initial=0.0) < 0.999 for m in adopted)
    assert result.identical, result.first
    assert result.trainings >= 1


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--calibration-hours", "4"), "the learner has none"),
        (("--preset", "zimmermann-2022"), "the calibration of 24 h leaves no time in --hours 9"),
        (("--preset", "blaser-2019", "--method", "learner"), "is a system of models"),
    ],
)
def test_what_contradicts_itself_is_refused(tmp_path: Path, more: tuple[str, ...], said: str) -> None:
    done = here(*demo_arguments(tmp_path, free_port(), HOURS, *more))
    assert (done.code, said in done.err) == (2, True), done.err


def measurements(database: Path) -> int:
    with History(database) as history:
        return len(history.measurements())


def test_ctrl_c_ends_everything_and_the_store_can_go_on(tmp_path: Path) -> None:
    port = free_port()
    process = subprocess.Popen(
        demo_command(tmp_path, port, hours=200.0), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    )  # fmt: skip
    connect(port, process).close()
    assert len(machine_pids(tmp_path)) == 1
    database = tmp_path / "gateway.sqlite"
    deadline = time.monotonic() + LIMIT_S
    while measurements(database) < 2:
        assert process.poll() is None, "the demo ended by itself"
        assert time.monotonic() < deadline, f"fewer than two measurements within {LIMIT_S:g} s"
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, output
    assert machine_pids(tmp_path) == []
    with socket.socket() as s:
        s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        s.bind(("127.0.0.1", port))  # free again
    with History(database) as history:
        assert replay(history).identical
