"""A reload that a command asks for: checked before it is answered, applied once, and told when it fails after all."""

import asyncio
from pathlib import Path

import pytest

from gateway.acquisition import BusChanges, ReloadError
from gateway.cli.reloading import Reloading
from gateway.config import GatewayConfig, load
from gateway.events import ConfigurationApplied
from gateway.past import Past
from gateway.service import Service
from talc.control import Controller
from talc.frame import EventKind
from tests.benches.kept_events import KeptEvents
from tests.benches.service_file import TEXT
from tests.benches.stepped_clock import SteppedClock

OTHER = TEXT.replace("/nowhere/adapter", "/nowhere/other")


class Unwilling(Service):
    """What it is told to apply fails only then."""

    async def reload(self, config: GatewayConfig) -> BusChanges:
        raise ReloadError("the port is in use")


def service_of(path: Path, kept: KeptEvents, clock: SteppedClock, kind: type[Service] = Service) -> Service:
    path.write_text(TEXT, encoding="utf-8")
    config = load(path)
    return kind(config, clock, kept, Past(Controller(config.input_names, config.talc)))


async def test_a_good_file_is_applied_and_one_that_needs_a_restart_or_is_wrong_is_refused_with_the_reason(
    tmp_path: Path,
) -> None:
    path, clock, kept, stop = tmp_path / "gateway.toml", SteppedClock(), KeptEvents(), asyncio.Event()
    service, reloading = service_of(path, kept, clock), Reloading(path)
    tasks = [asyncio.create_task(service.run(stop)), asyncio.create_task(reloading.run(service))]
    try:
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
    finally:
        stop.set()
        tasks[1].cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def test_what_fails_after_the_answer_is_an_event(tmp_path: Path) -> None:
    path, kept = tmp_path / "gateway.toml", KeptEvents()
    service, reloading = service_of(path, kept, SteppedClock(), Unwilling), Reloading(path)
    task = asyncio.create_task(reloading.run(service))
    try:
        await reloading.ask(service)
        while not kept.texts(EventKind.OPERATOR):
            await asyncio.sleep(0)
        reloading.hang_up()
        await asyncio.sleep(0)
        await asyncio.sleep(0)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert kept.texts(EventKind.OPERATOR) == [
        "not reloaded; the previous configuration stays in use: the port is in use"
    ], "a signal is nobody's command: its failure is in the log alone"
