"""`talc-gateway name` at a terminal, with an emulated module whose sensors the test warms."""

import asyncio
import csv
import os
import pty
import re
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from gateway.config.file import load
from gateway.model.text import Language
from simulators.devices import Adam6015, TcpHost

CONFIG = """[machine]
name = "mill"
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = 502
period_s = 0.05
timeout_s = 5.0
[[device]]
name = "adam"  # in the cabinet
bus = "tcp1"
profile = "advantech_adam6015"
[device.channels]  # CONFIRM: a name for each input, such as bed_front_left
adam_in0 = 0
adam_in1 = 1
adam_in2 = 2
"""
LIST = "device,input,name\nadam,0,bed\nadam,1,column\nadam,2,nut\n"


class Warmable:
    """The module's values; says when it has been read so often that they are known."""

    def __init__(self) -> None:
        self.values, self._reads, self._read = [20.0, 21.0, 22.0, *[0.0] * 4], 0, asyncio.Event()

    def __call__(self) -> Sequence[float]:
        self._reads += 1
        self._read.set()
        return list(self.values)

    async def warm(self, number: int) -> None:
        """A hand on this sensor, once the others were read for a while."""
        wanted = self._reads + 20
        while self._reads < wanted:
            self._read.clear()
            await self._read.wait()
        self.values[number] += 3.0


class Terminal:
    """A pseudo-terminal: what was printed, and what is typed."""

    def __init__(self) -> None:
        self._ours, self.theirs = pty.openpty()
        self._printed, self._news = bytearray(), asyncio.Event()
        asyncio.get_running_loop().add_reader(self._ours, self._take)

    def _take(self) -> None:
        self._printed.extend(os.read(self._ours, 65536))
        self._news.set()

    async def shows(self, text: str) -> None:
        """Wait for it; what comes up to it is done with."""
        wanted = text.encode()
        while wanted not in self._printed:
            self._news.clear()
            await self._news.wait()
        del self._printed[: self._printed.index(wanted) + len(wanted)]

    def types(self, text: str) -> None:
        os.write(self._ours, f"{text}\n".encode())

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._ours)
        os.close(self._ours)
        os.close(self.theirs)


def configure(file: Path, port: int) -> None:
    text = file.read_text(encoding="utf-8") if file.exists() else CONFIG
    file.write_text(re.sub(r"(?<=port = ).*", str(port), text), encoding="utf-8")


@asynccontextmanager
async def naming(
    file: Path, source: Warmable, *options: str
) -> AsyncIterator[tuple[Terminal, asyncio.subprocess.Process]]:
    host, terminal = TcpHost({1: Adam6015(source)}), Terminal()
    configure(file, await host.start())
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway", "name", str(file), "--by", "Ada", *options),
        stdin=terminal.theirs, stdout=terminal.theirs, stderr=terminal.theirs,
    )  # fmt: skip
    try:
        async with asyncio.timeout(300.0):
            yield terminal, process
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        terminal.close()
        await host.stop()


def protocol(file: Path) -> list[tuple[str, ...]]:
    with file.with_suffix(".names.csv").open(encoding="utf-8", newline="") as rows:
        return [(row["by"], row["input"], row["before"], row["name"], row["how"]) for row in csv.DictReader(rows)]


async def test_the_sensor_that_is_warmed_gets_the_name_that_is_typed_and_undo_takes_it_back(tmp_path: Path) -> None:
    file, source, said = tmp_path / "gateway.toml", Warmable(), Language("de")
    async with naming(file, source, "--language", "de") as (terminal, process):
        await terminal.shows(said("naming.warm_any", done=0, n=3))
        await source.warm(1)
        await terminal.shows(said("naming.rose", device="adam", number=1, now="adam_in1", rise=3.0, unit="degC"))
        await terminal.shows(said("naming.which"))
        terminal.types("left door")
        await terminal.shows(said("naming.which"))
        terminal.types("column")
        await terminal.shows(said("naming.warm_any", done=1, n=3))
        assert load(file).channels[1].name == "column"
        terminal.types("undo")
        await terminal.shows(said("naming.warm_any", done=0, n=3))
        terminal.types("bed")  # beforehand: both hands are at the machine
        await source.warm(0)
        await terminal.shows(said("naming.given", device="adam", number=0, name="bed"))
        terminal.types("end")
        assert await process.wait() == 3
    async with naming(file, source, "--language", "de") as (terminal, process):
        await terminal.shows(said("naming.warm_any", done=1, n=3))
        terminal.types("undo")
        await terminal.shows(said("naming.warm_any", done=0, n=3))
        await source.warm(0)
        await terminal.shows(said("naming.which"))
        terminal.types("bed")
        await terminal.shows(said("naming.warm_any", done=1, n=3))
        terminal.types("end")
        assert await process.wait() == 3
    text = file.read_text(encoding="utf-8")
    assert text == CONFIG.replace("502", str(load(file).buses[0].model_dump()["port"])).replace("adam_in0", "bed")
    assert protocol(file) == [
        ("Ada", "1", "adam_in1", "column", "warmed"),
        ("Ada", "1", "adam_in1", "column", "undone"),
        ("Ada", "0", "adam_in0", "bed", "warmed"),
        ("Ada", "0", "adam_in0", "bed", "undone"),
        ("Ada", "0", "adam_in0", "bed", "warmed"),
    ]


async def test_a_wiring_list_is_confirmed_by_hand_and_asks_where_another_sensor_moves(tmp_path: Path) -> None:
    file, source, wiring = tmp_path / "gateway.toml", Warmable(), tmp_path / "wiring.csv"
    said = Language("en")
    wiring.write_text(LIST, encoding="utf-8")
    async with naming(file, source, "--list", str(wiring), "--language", "en") as (terminal, process):
        await terminal.shows(said("naming.warm_at", done=0, n=3, name="bed", device="adam", number=0))
        await source.warm(0)
        await terminal.shows(said("naming.warm_at", done=1, n=3, name="column", device="adam", number=1))
        await source.warm(2)
        await terminal.shows(said("naming.which_listed", name="nut"))
        terminal.types("")
        await terminal.shows(said("naming.warm_at", done=2, n=3, name="column", device="adam", number=1))
        terminal.types("end")
        await terminal.shows(said("naming.rest", n=1, word="y"))
        terminal.types("y")
        assert await process.wait() == 0
    assert list(load(file).devices[0].channels.items()) == [("bed", 0), ("column", 1), ("nut", 2)]
    assert "CONFIRM" not in file.read_text(encoding="utf-8"), "every input has its name"
    assert [row[3:] for row in protocol(file)] == [("bed", "warmed"), ("nut", "warmed"), ("column", "listed")]
