"""Files that people give a gateway, with whatever may stand in them: one example of each kind, by a seed."""

import hashlib
import json
import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from drivers.base import DriverError, SystemClock
from drivers.build import make_device
from drivers.profiles import load_profile
from gateway.acquisition.wire_log import WireLogError, WireLogWriter, is_wire_log, read_wire_log
from gateway.config.file import load
from gateway.config.prior import parse_prior
from gateway.config.problems import ConfigError
from gateway.config.telemetry import Telemetry
from gateway.config.telemetry_rules import credential_problems
from gateway.listeners.outlets.settings import load_outlets
from gateway.listeners.umati.settings import load_serving
from gateway.listeners.web.settings import load_settings
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import read_recording
from gateway.reporting.recordings.problems import RecordingError
from gateway.storage.learnt import Learnt, learnt_text, parse_learnt
from gateway.storage.snapshot import Snapshot, SnapshotError, decode_snapshot
from talc.control import Controller
from talc.frame import Frame, Frames, Measurement
from talc.learner import make_prior
from talc.settings import TalcSettings
from tests.benches.buses import make_bus
from tests.benches.logger_files import INPUTS, logger_dbc, logger_profile_text
from tests.benches.service_file import FILE
from tests.benches.snapshot_bytes import stored_bytes

ROOT = Path(__file__).parents[2]
_TOKENS = (
    b"", b"0", b"-1", b"1e400", b"nan", b"inf", b"99999999999999999999", b"null", b"true", b'"', b"'", b"[]", b"{}",
    b"\n", b"\r", b"\0", b"\xff\xfe", b"\xc3", b",", b";", b"\t", b"=", b"[[bus]]", b"[" * 2000, b"a" * 5000,
    b"9" * 5000, b"1970-01-01",
    b"2106-02-07T06:28:15Z", b"0x7fffffffffffffff", b"-0.0", b"|", b"@", b"64|1@1-", b"(0,0)", b"_",
)  # fmt: skip
Example = Callable[[random.Random, Path], None]
"""Tries one example: whatever it raises is a bug of the program."""


@contextmanager
def refused_by(*kinds: type[Exception]) -> Iterator[None]:
    """Inside, an error of these kinds is expected, and must have a text. Raises AssertionError otherwise."""
    try:
        yield
    except kinds as error:
        if not str(error):
            raise AssertionError(f"{error!r} says nothing") from error


def mutated(data: bytes, draw: random.Random) -> bytes:
    """A few changes of bytes, words, numbers and lines."""
    spoilt = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 5))):
        at = draw.randrange(len(spoilt) + 1)
        match draw.randrange(8):
            case 0 if spoilt:
                spoilt[min(at, len(spoilt) - 1)] ^= 1 << draw.randrange(8)
            case 1:
                spoilt[at:at] = draw.choice(_TOKENS)
            case 2:
                spoilt[at : at + draw.randint(1, 12)] = draw.choice(_TOKENS)
            case 3:
                del spoilt[at : at + draw.randint(1, 60)]
            case 4:
                del spoilt[at:]
            case 5:
                lines = bytes(spoilt).split(b"\n")
                one, other = (draw.randrange(len(lines)) for _ in range(2))
                lines[one], lines[other] = lines[other], lines[one]
                spoilt = bytearray(b"\n".join(lines))
            case 6:
                begin = draw.randrange(len(spoilt) + 1)
                spoilt[at:at] = spoilt[begin : begin + draw.randint(1, 200)]
            case _:
                spoilt[at : at + 4] = draw.randbytes(4)
    return bytes(spoilt)


def _toml(draw: random.Random, folder: Path) -> None:
    file = folder / "gateway.toml"
    file.write_bytes(mutated(draw.choice(_configurations()), draw))
    with refused_by(ConfigError):
        load(file)


@cache
def _configurations() -> list[bytes]:
    examples = (file.read_bytes() for file in sorted((ROOT / "examples").glob("*.toml")))
    return [FILE.read_bytes(), *examples]


def _profile(draw: random.Random, folder: Path) -> None:
    supplied = sorted((ROOT / "drivers" / "profiles").glob("*.toml"))
    file = folder / "own.toml"
    file.write_bytes(mutated(draw.choice(supplied).read_bytes(), draw))
    with refused_by(DriverError):
        load_profile(str(file))


def _dbc(draw: random.Random, folder: Path) -> None:
    (folder / "logger.dbc").write_bytes(mutated(logger_dbc().encode(), draw))
    (folder / "logger.toml").write_text(logger_profile_text("logger"), encoding="utf-8")
    bus = make_bus("can1", "can", {"interface": "slcan", "channel": "/nowhere"})
    channels = {f"t{i}": i for i in range(INPUTS)}
    with refused_by(DriverError):
        make_device("logger", bus, str(folder / "logger.toml"), 1, channels, {}, SystemClock())


def _table(draw: random.Random, folder: Path) -> None:
    file = folder / "machine.csv"
    file.write_bytes(mutated(draw.choice(_recordings(folder.parent)), draw))
    with refused_by(RecordingError):
        read_recording(file, Columns(), 300.0)


@cache
def _recordings(folder: Path) -> list[bytes]:
    times = [f"2026-03-02 {6 + i // 12:02d}:{i % 12 * 5:02d}:00" for i in range(80)]
    rows = [f"{t},{20 + i / 10:.2f},{21 - i / 20:.2f},{i % 7 or ''}" for i, t in enumerate(times)]
    comma = "\n".join(["time,bed,column,EX0C", *rows]).encode()
    semicolon = b"\xef\xbb\xbf" + comma.replace(b",", b";").replace(b".", b",").replace(b"\n", b"\r\n")
    file = folder / "whole.parquet"
    columns = {"time": np.arange(80) * 300.0, "bed": np.linspace(20, 25, 80), "EX0C_um": np.linspace(0, 9, 80)}
    parquet.write_table(pa.table(columns), file)
    return [comma, semicolon, file.read_bytes()]


_CELLS = (
    pa.float64(), pa.float16(), pa.int64(), pa.uint64(), pa.bool_(), pa.string(), pa.binary(), pa.null(), pa.date32(),
    pa.decimal128(25, 3), pa.timestamp("ns", tz="UTC"), pa.timestamp("s"), pa.time64("us"), pa.duration("ms"),
    pa.list_(pa.float64()), pa.struct([("a", pa.float64())]), pa.dictionary(pa.int8(), pa.string()),
    pa.dictionary(pa.int32(), pa.float64()), pa.large_string(), pa.map_(pa.string(), pa.int64()), pa.string_view(),
)  # fmt: skip


def _parquet(draw: random.Random, folder: Path) -> None:
    """Columns of every type that Parquet has."""
    arrays = []
    for kind in (draw.choice(_CELLS) if draw.random() < 0.7 else pa.float64() for _ in range(3)):
        numbers = [None if draw.random() < 0.1 else i for i in range(40)]
        try:
            arrays.append(pa.array(numbers, pa.int64()).cast(kind))
        except pa.ArrowException:
            arrays.append(pa.array([_cell_of(kind, i) for i in range(40)], kind))
    if draw.random() < 0.5:
        arrays[0] = pa.array([1.7e9 + 300.0 * i for i in range(40)])
    file = folder / "machine.parquet"
    names = draw.choice((["time", "bed", "EX0C_um"], ["time", "bed", "bed"], ["time", "", "EX0C"]))
    try:
        parquet.write_table(pa.table(arrays, names), file)
    except pa.ArrowException:
        return
    with refused_by(RecordingError):
        read_recording(file, Columns(), 300.0)


def _cell_of(kind: pa.DataType, i: int) -> object:
    if pa.types.is_list(kind):
        return [float(i)]
    if pa.types.is_map(kind):
        return [("a", i)]
    if pa.types.is_struct(kind):
        return {"a": float(i)}
    if pa.types.is_dictionary(kind):
        return float(i % 5) if pa.types.is_floating(kind.value_type) else str(i % 5)
    if pa.types.is_binary(kind) or pa.types.is_fixed_size_binary(kind):
        return str(i).encode()
    if pa.types.is_temporal(kind):
        return i
    return None if pa.types.is_null(kind) else str(i)


_OUTLETS = b"""[source]
connect = ["tcp/127.0.0.1:7447"]
machines = ["mill"]
[[outlet]]
name = "plant"
kind = "mqtt"
url = "mqtt://127.0.0.1:1883"
kinds = ["reading", "event"]
[[outlet]]
name = "charts"
kind = "influxdb"
url = "http://127.0.0.1:8086"
database = "talc"
gather_for_s = 5.0
most_waiting = 1000
"""
_WEB = b"""hosts = ["panel"]
[proxy]
header = "X-Forwarded-User"
addresses = ["10.0.0.2"]
[machine.mill]
tolerance_um = 8
sphere_radius_mm = 120.0
"""
_UMATI = b"""[machine.mill]
manufacturer = "someone"
serial_number = "7"
product_instance_uri = "urn:x:7"
"""


def _settings(draw: random.Random, folder: Path) -> None:
    """Files of the outlets, of the page, of the OPC UA server, and of the users of a gateway."""
    file = folder / "some.toml"
    read, right = draw.choice(((_outlets_of, _OUTLETS), (load_settings, _WEB), (load_serving, _UMATI)))
    file.write_bytes(mutated(right, draw))
    with refused_by(ConfigError, DriverError):
        read(file)
    users = folder / "users"
    users.write_bytes(mutated(b"alice:wonderland\nbob:builder\n", draw))
    for problem in credential_problems(Telemetry(users_file=users), datetime.now(UTC)):
        assert str(problem)


def _outlets_of(file: Path) -> None:
    load_outlets(file).feeds()


def _wire_log(draw: random.Random, folder: Path) -> None:
    file = folder / "wires.log"
    with WireLogWriter(file, "[machine]\nname = 'mill'\n", datetime(2026, 3, 2, tzinfo=UTC), most_bytes=10**6) as log:
        tap = log.tap("bus1")
        for _ in range(5):
            tap.data(draw.random() < 0.5, draw.randbytes(6))
            tap.frame(draw.random() < 0.5, draw.randrange(0x800), False, draw.randbytes(8))
        tap.note("open")
    file.write_bytes(mutated(file.read_bytes(), draw))
    with refused_by(WireLogError):
        if is_wire_log(file):
            read_wire_log(file)


@cache
def _controller() -> Controller:
    controller, draw = Controller(("bed", "column"), TalcSettings()), np.random.default_rng(1)
    for k in range(40):
        x = 20.0 + draw.normal(0, 1.0, 2)
        measured = Measurement(5.0 * (x[0] - 20.0) + np.arange(9.0), np.full(9, 0.3))
        controller.step(Frame(k, x, np.ones(2, np.bool_), measured))
    return controller


@cache
def _learnt_text() -> str:
    return learnt_text(Learnt("mill", "learner", 300.0, _controller().state(), None))


def signed(whole: Mapping[str, object]) -> str:
    """What was learnt, with the checksum of its present content."""
    rest = {name: value for name, value in whole.items() if name != "sha256"}
    return json.dumps({**rest, "sha256": hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()})


def _learnt(draw: random.Random, _: Path) -> None:
    whole = json.loads(_learnt_text())
    names = list(whole)
    whole[draw.choice(names)] = draw.choice((None, -1, "x", [], {}, whole[draw.choice(names)], {"held": 1}))
    for part in ("controller", "arrays"):
        if isinstance(whole[part], dict) and whole[part] and draw.random() < 0.3:
            inner = list(whole[part])
            whole[part][draw.choice(inner)] = draw.choice((None, -1, "x", [], {}, whole[part][draw.choice(inner)]))
    for text in (mutated(_learnt_text().encode(), draw).decode("utf-8", "replace"), signed(whole)):
        with refused_by(ValueError):
            parse_learnt(text)


@cache
def _prior_text() -> str:
    course = _controller().state().course
    assert course is not None
    return json.dumps(make_prior([(("bed", "column"), course.learner)]).to_dict())


def _prior(draw: random.Random, _: Path) -> None:
    with refused_by(ValueError):
        parse_prior(mutated(_prior_text().encode(), draw).decode("utf-8", "replace"))


@cache
def _snapshot_bytes() -> bytes:
    return stored_bytes(Snapshot("marks", _controller().state(), None, {}, (None,) * 9))


def _snapshot(draw: random.Random, _: Path) -> None:
    with refused_by(SnapshotError):
        decode_snapshot(mutated(_snapshot_bytes(), draw), _frames)


def _frames(first_k: int, last_k: int) -> Frames:
    many = last_k - first_k + 1
    x = np.full((many, 2), 20.0)
    return Frames(np.arange(first_k, last_k + 1), x, np.ones((many, 2), np.bool_), np.full((many, 9), np.nan))


FILES: Mapping[str, Example] = {
    "toml": _toml,
    "profiles": _profile,
    "dbc": _dbc,
    "recordings": _table,
    "parquet": _parquet,
    "settings": _settings,
    "wire_log": _wire_log,
    "learnt": _learnt,
    "prior": _prior,
    "snapshot": _snapshot,
}
