"""A running service applies another configuration, or continues unchanged."""

import pytest

from gateway.acquisition.reload import ReloadError
from gateway.config.applied import ConfigurationApplied
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from tests.benches.kept_events import KeptEvents
from tests.benches.reloaded_service import service_of
from tests.benches.service_file import FILE, TEXT
from tests.benches.stepped_clock import SteppedClock
from tests.benches.tasks import served


def config(text: str = TEXT) -> GatewayConfig:
    return parse(text, FILE)


async def test_a_reload_takes_effect_and_the_fingerprint_is_what_runs() -> None:
    old, new = config(), config(TEXT.replace("/nowhere/adapter", "/nowhere/other"))
    clock, kept = SteppedClock(), KeptEvents()

    def applied() -> list[GatewayConfig]:
        return [event.config for event in kept.of(ConfigurationApplied)]

    service = service_of(old, kept, clock)
    with pytest.raises(ReloadError, match="not running"):
        await service.reload(await service.prepare(new))
    async with served(service):
        await clock.run_until(3.0)
        assert "/nowhere/adapter" in kept.readings[-1].detail
        with pytest.raises(ReloadError, match="inputs changed"):
            await service.prepare(config(TEXT.replace("bed_front", "bed_rear")))
        assert service.fingerprint == old.fingerprint()
        assert applied() == [old]
        change = await service.reload(await service.prepare(new))
        await clock.run_until(6.0)
        assert change.started == ("rtu1",)
        assert service.fingerprint == new.fingerprint()
        assert applied() == [old, new]
        assert "/nowhere/other" in kept.readings[-1].detail
        numbers = [reading.sequence for reading in kept.readings]
        assert numbers == sorted(set(numbers))


async def test_what_was_prepared_before_another_reload_is_prepared_again() -> None:
    """Else a bus that the other one has exchanged would run on as it was."""
    old, second, third = config(), config(TEXT.replace("/nowhere/adapter", "/nowhere/2")), config(TEXT + "# third\n")
    clock, kept = SteppedClock(), KeptEvents()
    service = service_of(old, kept, clock)
    async with served(service):
        await clock.run_until(3.0)
        prepared = await service.prepare(third)
        assert prepared.change.started == ()
        await service.reload(await service.prepare(second))
        assert (await service.reload(prepared)).started == ("rtu1",)
        await clock.run_until(6.0)
        assert "/nowhere/adapter" in kept.readings[-1].detail
