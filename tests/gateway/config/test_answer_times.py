"""How long one answer may take has one bound, whatever is asked."""

from typing import get_args

import pytest
from pydantic import BaseModel, ValidationError

from drivers.build import BUS_KINDS
from drivers.bus_settings import BusSettings
from gateway.config import AgentNc, LinuxCncNc, MtConnectNc, OtherBus, SinumerikNc
from gateway.outlets import OutletSettings
from gateway.outlets.settings import AnyOutlet

OUTLETS = get_args(get_args(AnyOutlet)[0])
ASKED = (*BUS_KINDS.values(), AgentNc, LinuxCncNc, MtConnectNc, OtherBus, SinumerikNc, OutletSettings, *OUTLETS)


def of_timeout(section: type[BaseModel], timeout_s: float) -> list[str]:
    """Everything said of it; the other fields are missing."""
    try:
        section.model_validate({"timeout_s": timeout_s})
    except ValidationError as error:
        return [one["msg"] for one in error.errors() if one["loc"] == ("timeout_s",)]
    return []


@pytest.mark.parametrize("section", ASKED, ids=lambda section: section.__name__)
def test_nobody_is_waited_for_longer_than_a_minute(section: type[BaseModel]) -> None:
    assert of_timeout(section, 60.1) == ["Input should be less than or equal to 60"]
    assert of_timeout(section, 0.0) == ["Input should be greater than 0"]
    assert of_timeout(section, 60.0) == []


@pytest.mark.parametrize("settings", BUS_KINDS.values(), ids=BUS_KINDS)
def test_the_settings_of_every_bus_are_bus_settings(settings: type[BaseModel]) -> None:
    assert issubclass(settings, BusSettings)
