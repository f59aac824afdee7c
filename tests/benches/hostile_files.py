"""The memory and time of each command on hostile files: `python -m tests.benches.hostile_files --files 10000`.

Every file is drawn from a seed: one of those of `tests.benches.fuzzed_files`, changed in a few places, or one with a
number, a length or a repetition that no file of its kind has. Each command runs in a fork of this process, which has
imported everything, so that its peak is its own; a file that breaks a bound is one line, with the seed to repeat it.
"""

import os
import random
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import pyarrow as pa
from pyarrow import parquet

from drivers.base import SetupError
from gateway.acquisition.wire_log import WireLogError, not_recorded
from gateway.cli.main import main as commands
from gateway.config.problems import ConfigError
from gateway.demo.play import read_wire_recording
from gateway.reporting.recordings.problems import RecordingError
from gateway.runtime.bounded_memory import MemoryBoundError, memory_for
from gateway.service.reloading import judge
from tests.benches.fuzzed_files import ROOT, mutated
from tests.benches.logger_files import logger_dbc, logger_profile_text
from tests.benches.service_file import TEXT

MOST_MB = 300
MOST_S = 10.0
_NUMBERS = ("4294967296", "400000000", "-1", "1e308", "9" * 4000, "0x7fffffffffffffff", "1_0" * 1000, "nan")
_EXPECTED = (ConfigError, MemoryBoundError, RecordingError, SetupError, WireLogError, click.ClickException)
"""What the commands tell in a sentence."""


class Peak(NamedTuple):
    """What one command took."""

    mb: float
    seconds: float
    said: str
    """Empty: it ended as it should."""


def _drawn(text: bytes, draw: random.Random) -> bytes:
    """Changed in a few places, with an absurd number, or much of it again and again."""
    if draw.random() < 0.5:
        text = mutated(text, draw)
    if draw.random() < 0.4:
        words = text.split(b" ")
        words[draw.randrange(len(words))] = draw.choice(_NUMBERS).encode()
        text = b" ".join(words)
    if draw.random() < 0.3:
        at, many = draw.randrange(len(text) + 1), draw.choice((10, 1000, 100_000))
        part = text[at : at + draw.choice((1, 3, 30, 300))]
        text = text[:at] + part * min(many, 2**23 // max(len(part), 1)) + text[at:]
    return text


def _config(draw: random.Random, folder: Path) -> Path:
    file = folder / "gateway.toml"
    examples = sorted((ROOT / "examples").glob("*.toml"))
    file.write_bytes(_drawn(draw.choice([TEXT.encode(), *(one.read_bytes() for one in examples)]), draw))
    return file


_CAN = """[machine]
name = "mill"
[[bus]]
name = "can1"
kind = "can"
interface = "slcan"
channel = "/nowhere"
[[device]]
name = "logger"
bus = "can1"
profile = "logger.toml"
unit = 1
channels = { t0 = 0 }
"""


def _dbc(draw: random.Random, folder: Path) -> Path:
    (folder / "logger.dbc").write_bytes(_drawn(logger_dbc().encode(), draw))
    (folder / "logger.toml").write_text(logger_profile_text("logger"), encoding="utf-8")
    (folder / "gateway.toml").write_text(_CAN, encoding="utf-8")
    return folder / "gateway.toml"


def _profile(draw: random.Random, folder: Path) -> Path:
    supplied = sorted((ROOT / "drivers" / "profiles").glob("*.toml"))
    (folder / "logger.toml").write_bytes(_drawn(draw.choice(supplied).read_bytes(), draw))
    (folder / "gateway.toml").write_text(_CAN, encoding="utf-8")
    return folder / "gateway.toml"


def _table(draw: random.Random, folder: Path) -> Path:
    rows = "\n".join(f"{300 * i},{20 + i / 10:.2f},{i % 7 or ''}" for i in range(80))
    (folder / "machine.csv").write_bytes(_drawn(f"time,bed,EX0C\n{rows}\n".encode(), draw))
    return folder / "machine.csv"


def _parquet(draw: random.Random, folder: Path) -> Path:
    file, many = folder / "machine.parquet", draw.choice((80, 10_000, 1_000_000, 5_000_000))
    column = pa.array(np.zeros(many) if many > 10_000 else np.arange(many, dtype=float))
    names = ["time", "EX0C", *(f"c{i}" for i in range(draw.choice((1, 5, 20))))]
    parquet.write_table(pa.table([column] * len(names), names), file, compression=draw.choice(("zstd", "snappy")))
    if draw.random() < 0.5:
        file.write_bytes(mutated(file.read_bytes(), draw))
    return file


def _wire_log(draw: random.Random, folder: Path) -> Path:
    head = "# talc wire log 1\n" + "".join(f"#: {line}\n" for line in TEXT.splitlines())
    lines = "".join(f"({1.7e9 + i:.6f}) rtu1 {'<>'[i % 2]} 0103{i:04x}\n" for i in range(50))
    (folder / "wires.wire").write_bytes(_drawn((head + lines).encode(), draw))
    return folder / "wires.wire"


def _can_log(draw: random.Random, folder: Path) -> Path:
    lines = "".join(f"({1.7e9 + i:.6f}) can0 12{i % 10}#0102030405060708\n" for i in range(50))
    (folder / "wires.log").write_bytes(_drawn(lines.encode(), draw))
    return folder / "wires.log"


def _command(*words: str) -> Callable[[Path], None]:
    def run(file: Path) -> None:
        commands.main([*words, str(file)], standalone_mode=False)

    return run


def _program(*words: str) -> Callable[[Path], None]:
    """In a process that begins anew: what Arrow has reserved in one that has used it counts as taken before."""

    def run(file: Path) -> None:
        command = [sys.executable, "-m", "gateway", *words, str(file)]
        said = subprocess.run(command, capture_output=True, text=True, check=False).stderr
        if "Traceback" in said:
            raise RuntimeError(said[-1500:])

    return run


def _play(file: Path) -> None:
    with memory_for(file):
        config, _ = read_wire_recording(file, file.parent)
    if config is not None:
        list(not_recorded(config))


FILES: Mapping[str, tuple[Callable[[random.Random, Path], Path], tuple[tuple[str, Callable[[Path], None]], ...]]] = {
    "toml": (_config, (("check", _command("check")), ("reload", judge))),
    "dbc": (_dbc, (("check", _command("check")), ("reload", judge))),
    "profile": (_profile, (("check", _command("check")),)),
    "csv": (_table, (("replay", _command("replay")),)),
    "parquet": (_parquet, (("replay", _program("replay")),)),
    "wire log": (_wire_log, (("play", _play),)),
    "CAN log": (_can_log, (("play", _play),)),
}


def made(make: Callable[[random.Random, Path], Path], number: int, folder: Path) -> Path:
    """The file of a seed, made in a fork: what that takes of memory is not the command's."""
    pid = os.fork()
    if pid == 0:
        (folder / "made").write_text(str(make(random.Random(number), folder)), encoding="utf-8")
        os._exit(0)
    os.waitpid(pid, 0)
    return Path((folder / "made").read_text(encoding="utf-8"))


def peak(command: Callable[[Path], None], file: Path) -> Peak:
    """Runs it in a fork."""
    receiving, sending = os.pipe()
    began_s = time.monotonic()
    pid = os.fork()
    if pid == 0:
        os.close(receiving)
        said = ""
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
        try:
            with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
                command(file)
        except SystemExit:
            pass
        except BaseException as error:  # noqa: BLE001 - what is looked for
            if not isinstance(error, _EXPECTED):
                said = "".join(traceback.format_exception(error))[-1500:]
        os.write(sending, said.encode("utf-8", "replace"))
        os._exit(0)
    os.close(sending)
    with os.fdopen(receiving, "rb") as answer:
        said = answer.read().decode("utf-8", "replace")
    _, status, used = os.wait4(pid, 0)
    if status and not said:
        said = f"ended with status {status} after {time.monotonic() - began_s:.0f} s"
    return Peak(used.ru_maxrss / 1024, used.ru_utime + used.ru_stime, said)


@click.command()
@click.argument("kinds", nargs=-1, type=click.Choice(list(FILES)))
@click.option("--files", "many", default=10_000, show_default=True, help="In all.")
@click.option("--seed", default=0, show_default=True)
def main(kinds: tuple[str, ...], many: int, seed: int) -> None:
    """Ctrl-C ends it with what is known by then.

    Exit code 1: a command took more than 300 MB or 10 s, or raised what it should not.
    """
    wanted = kinds or tuple(FILES)
    worst: dict[tuple[str, str], list[float]] = {}
    wrong = 0
    with suppress(KeyboardInterrupt):
        for number in range(seed, seed + many):
            kind = wanted[number % len(wanted)]
            make, runs = FILES[kind]
            for name, command in runs:
                with tempfile.TemporaryDirectory() as folder:
                    found = peak(command, made(make, number, Path(folder)))
                row = worst.setdefault((kind, name), [0, 0.0, 0.0])
                row[:] = [row[0] + 1, max(row[1], found.mb), max(row[2], found.seconds)]
                if found.said or found.mb > MOST_MB or found.seconds > MOST_S:
                    wrong += 1
                    click.echo(f"{kind}, {name}, --seed {number} --files 1: {found}")
    for (kind, name), (files, mb, seconds) in worst.items():
        click.echo(f"{kind:<10}{name:<8}{files:>7} files, at most {mb:.0f} MB and {seconds:.1f} s")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
