"""A reload that a command asks for: checked before it is answered, applied once, and reported if it fails after all."""

import asyncio
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from gateway.acquisition.reload import BusChanges, PreparedReload, ReloadError
from gateway.config.applied import ConfigurationApplied
from gateway.config.file import load
from gateway.runtime.workers.process import Bounds
from gateway.service.reloading import Reloading
from gateway.service.service import Service
from talc.frame import EventKind
from tests.benches.kept_events import KeptEvents
from tests.benches.reloaded_service import service_of_file
from tests.benches.service_file import TEXT
from tests.benches.stepped_clock import SteppedClock
from tests.benches.tasks import running, served
from tests.benches.waits import until

OTHER = TEXT.replace("/nowhere/adapter", "/nowhere/other")


class Unwilling(Service):
    """Fails only when it applies the configuration."""

    async def reload(self, prepared: PreparedReload) -> BusChanges:
        raise ReloadError("the port is in use")


async def test_a_good_file_is_applied_and_one_that_needs_a_restart_or_is_wrong_is_refused_with_the_reason(
    tmp_path: Path,
) -> None:
    path, clock, kept = tmp_path / "gateway.toml", SteppedClock(), KeptEvents()
    service, reloading = service_of_file(path, kept, clock), Reloading(path)
    async with served(service), running(reloading.run(service)):
        await clock.run_until(3.0)
        for text, why in (
            (
                OTHER + '[compensation]\nmode = "advise"\n',
                r"^\[compensation\] changed: restart the gateway to apply it$",
            ),
            (OTHER.replace("unit = 1", "units = 1"), r"unknown key; did you mean 'unit'\?"),
            ("", "machine"),
        ):
            path.write_text(text, encoding="utf-8")
            with pytest.raises(ReloadError, match=why):
                await reloading.ask(service)
        assert len(kept.of(ConfigurationApplied)) == 1, "that of the start"
        path.write_text(OTHER, encoding="utf-8")
        assert (await reloading.ask(service)).endswith("its buses rtu1 are exchanged, the others go on")
        with pytest.raises(ReloadError, match="another reload is under way"):
            await reloading.ask(service)
        await clock.run_until(6.0)
        assert [event.config for event in kept.of(ConfigurationApplied)][1:] == [load(path)]
        assert (await reloading.ask(service)).endswith("no bus has changed")


async def test_a_command_is_refused_if_a_signal_comes_while_its_file_is_read(tmp_path: Path) -> None:
    """The file may have changed in between; what is applied last must be the file as it is."""
    path, clock, kept = tmp_path / "gateway.toml", SteppedClock(), KeptEvents()
    service, reloading = service_of_file(path, kept, clock), Reloading(path)
    async with served(service), running(reloading.run(service)):
        await clock.run_until(3.0)
        path.write_text(OTHER, encoding="utf-8")
        command = asyncio.create_task(reloading.ask(service))
        await asyncio.sleep(0)
        reloading.hang_up()
        with pytest.raises(ReloadError, match="another reload came meanwhile; give the command again"):
            await command
        await until(lambda: len(kept.of(ConfigurationApplied)) > 1)
        assert [event.config for event in kept.of(ConfigurationApplied)][1:] == [load(path)]


def _children() -> list[int]:
    return [int(pid) for pid in Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split()]


async def test_a_file_that_takes_long_is_refused_and_leaves_nothing_behind(tmp_path: Path) -> None:
    path, clock, kept = tmp_path / "gateway.toml", SteppedClock(), KeptEvents()
    service, reloading = service_of_file(path, kept, clock), Reloading(path, Bounds(processor_s=0.2))
    async with served(service):
        await clock.run_until(3.0)
        before, threads, children = service.fingerprint, threading.active_count(), _children()
        path.write_text(OTHER + "[storage]\n" + "".join(f"k{i} = 1\n" for i in range(20_000)), encoding="utf-8")
        with pytest.raises(ReloadError) as refused:
            await reloading.ask(service)
        (said,) = refused.value.args
        assert (said.code, said.values["why"].code) == ("reload_not_judged", "work_slow")
        assert service.fingerprint == before
        # The thread that waited for the process ends a moment after it has told so.
        await until(lambda: (threading.active_count(), _children()) == (threads, children))
    assert os.listdir(tmp_path) == ["gateway.toml"]  # noqa: PTH208 -- of an asynchronous test


async def test_a_file_that_takes_all_memory_is_refused(tmp_path: Path) -> None:
    path, kept = tmp_path / "gateway.toml", KeptEvents()
    service, reloading = service_of_file(path, kept, SteppedClock()), Reloading(path, Bounds(more_bytes=2**20))
    path.write_text(OTHER + "x = [" + "1," * 100_000 + "]\n", encoding="utf-8")
    with pytest.raises(ReloadError) as refused:
        await reloading.ask(service)
    assert refused.value.args[0].code == "reload_not_judged"


async def test_what_fails_after_the_answer_is_an_event(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path, kept = tmp_path / "gateway.toml", KeptEvents()
    service, reloading = service_of_file(path, kept, SteppedClock(), Unwilling), Reloading(path)
    async with running(reloading.run(service)):
        await reloading.ask(service)
        await until(lambda: kept.texts(EventKind.OPERATOR))
        reloading.hang_up()
        await until(lambda: caplog.text.count("not reloaded") == 2)
    assert kept.texts(EventKind.OPERATOR) == [
        "not reloaded; the previous configuration stays in use: the port is in use"
    ], "a signal is nobody's command: its failure is only in the log"


IMPORTING = """
import asyncio, sys, threading
from importlib.abc import MetaPathFinder
from pathlib import Path

class Importers(MetaPathFinder):
    by_the_loop, by_a_thread = set(), set()
    def find_spec(self, name, path=None, target=None):
        in_loop = threading.current_thread() is threading.main_thread()
        (self.by_the_loop if in_loop else self.by_a_thread).add(name.partition(".")[0])

from gateway.service.reloading import Reloading
from gateway.service.service import Service
from tests.benches.idle_loop import run
from tests.benches.kept_events import KeptEvents
from tests.benches.stepped_clock import SteppedClock
from tests.benches.reloaded_service import OF_A_NEW_KIND, service_of_file
from tests.benches.tasks import running, served

async def main(path, by_signal):
    clock, asked = SteppedClock(), asyncio.Event()

    class Asked(Service):
        async def reload(self, prepared):
            asked.set()
            return await super().reload(prepared)

    service, reloading = service_of_file(path, KeptEvents(), clock, Asked), Reloading(path)
    async with served(service), running(reloading.run(service)):
        await clock.run_until(3.0)
        path.write_text(OF_A_NEW_KIND, encoding="utf-8")
        sys.meta_path.insert(0, Importers())
        before = service.fingerprint
        if by_signal:
            reloading.hang_up()
        else:
            await reloading.ask(service)
        async with asyncio.timeout(300.0):
            await asked.wait()
        await clock.run_until(6.0)
        assert service.fingerprint != before
        sys.meta_path.pop(0)
    libraries = {"can", "canopen"}
    print(libraries & Importers.by_the_loop, libraries & Importers.by_a_thread)

run(main(Path(sys.argv[1]), sys.argv[2] == "signal"))
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", ["signal", "command"])
def test_the_library_of_a_bus_that_is_the_first_of_its_kind_is_not_imported_in_the_event_loop(
    how: str, tmp_path: Path
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORTING, str(tmp_path / "gateway.toml"), how], capture_output=True, text=True
    )
    assert done.stdout in ("set() {'can', 'canopen'}\n", "set() {'canopen', 'can'}\n"), done.stdout + done.stderr
