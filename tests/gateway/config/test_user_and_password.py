"""A user and the file of the password, wherever a section has them: both or neither, and the user has a name."""

from collections.abc import Mapping

import pytest
from pydantic import BaseModel, ValidationError

from drivers.mqtt.settings import MqttBusSettings
from drivers.opcua.settings import OpcUaBusSettings
from gateway.config.controls import SinumerikNc
from gateway.config.telemetry import Telemetry
from gateway.listeners.outlets.influxdb import InfluxDbSettings
from gateway.listeners.outlets.mqtt import MqttOutletSettings
from gateway.listeners.outlets.settings import SourceSettings
from tests.benches.command import here

OPC_UA = {"url": "opc.tcp://127.0.0.1", "security": "none"}
SECTIONS: Mapping[type[BaseModel], Mapping[str, object]] = {
    Telemetry: {},
    SourceSettings: {},
    MqttBusSettings: {"url": "mqtt://127.0.0.1"},
    MqttOutletSettings: {"name": "plant", "kind": "mqtt", "url": "mqtt://127.0.0.1"},
    InfluxDbSettings: {"name": "plant", "kind": "influxdb", "url": "http://127.0.0.1", "database": "talc"},
    OpcUaBusSettings: OPC_UA,
    SinumerikNc: {"kind": "sinumerik"} | OPC_UA,
}


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
@pytest.mark.parametrize("login", [{"user": "mill"}, {"password_file": "secret"}])
def test_a_login_that_is_incomplete_is_refused(section: type[BaseModel], login: Mapping[str, object]) -> None:
    with pytest.raises(ValidationError, match="user and password_file go together"):
        section.model_validate({**SECTIONS[section], **login})
    section.model_validate({**SECTIONS[section], "user": "mill", "password_file": "secret"})


@pytest.mark.parametrize("option", ["--user", "--password-file"])
def test_so_it_is_on_the_command_line(option: str) -> None:
    done = here("watch", option, __file__)
    assert (done.code, "--user" in done.err, "--password-file" in done.err) == (2, True, True), done.err
