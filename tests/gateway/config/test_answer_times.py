"""How long one answer may take has one bound for devices and one for servers."""

from typing import get_args

import pytest
from pydantic import BaseModel, ValidationError

from drivers.build import BUS_KINDS
from gateway.config.controls import AgentNc, LinuxCncNc, MtConnectNc, SinumerikNc
from gateway.config.extensions import OtherBus
from gateway.listeners.outlets.outlet import OutletSettings
from gateway.listeners.outlets.settings import AnyOutlet

OUTLETS = get_args(get_args(AnyOutlet)[0])
SERVERS = {"opcua", "mqtt", "agent"}
DEVICES = [settings for kind, settings in BUS_KINDS.items() if kind not in SERVERS]
ASKED = (
    *(BUS_KINDS[kind] for kind in sorted(SERVERS)),
    *(AgentNc, LinuxCncNc, MtConnectNc, OtherBus, SinumerikNc, OutletSettings),
    *OUTLETS,
)


def of_timeout(section: type[BaseModel], timeout_s: float) -> list[str]:
    """Everything said of it; the other fields are missing."""
    try:
        section.model_validate({"timeout_s": timeout_s})
    except ValidationError as error:
        return [one["msg"] for one in error.errors() if one["loc"] == ("timeout_s",)]
    return []


@pytest.mark.parametrize(("section", "longest"), [*((one, 60) for one in DEVICES), *((one, 3600) for one in ASKED)])
def test_a_device_has_at_most_a_minute_and_a_server_an_hour(section: type[BaseModel], longest: int) -> None:
    assert of_timeout(section, longest + 0.1) == [f"Input should be less than or equal to {longest}"]
    assert of_timeout(section, 0.0) == ["Input should be greater than 0"]
    assert of_timeout(section, float(longest)) == []
