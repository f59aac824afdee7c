"""Settings that cannot work are told when they are made, without any network."""

from pathlib import Path
from typing import Any

import pytest

from drivers.base import SetupError
from drivers.sinumerik_settings import Compensation, Handshake, Paths, SinumerikSettings, Source

URL = "opc.tcp://127.0.0.1:4840"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"url": "http://mill:4840"}, "url = 'http://mill:4840'"),
        ({"url": "mill"}, "url = 'mill'"),
        ({"timeout_s": 0.0}, "timeout_s = 0.0"),
        ({"security": "Basic128"}, "security = 'Basic128'"),
        ({"user": "gateway"}, "user and password_file"),
        ({"password_file": Path("secret")}, "user and password_file"),
        ({"security": "Basic256Sha256"}, "certificate is missing"),
        ({"security": "Basic256Sha256", "certificate": Path("a.pem")}, "private_key is missing"),
        (
            {"security": "Basic256Sha256", "certificate": Path("a.crt"), "private_key": Path("b.pem")},
            r"certificate = 'a.crt': expected a file ending in \.pem or \.der",
        ),
        ({"axis_numbers": {"X": 1, "Y": 2, "Z": 3}}, "axis_numbers"),
        ({"axis_numbers": {"X": 1, "Y": 1, "Z": 3, "A": 4, "C": 5}}, "axis_numbers"),
        ({"paths": Paths(position="/Channel/MachineAxis/actToolBasePos")}, "paths.position"),
        ({"states": {"coolant": Source("Plc/M1.0")}}, "states.coolant"),
        ({"states": {"coolant": Source("/Plc/M1.0", 0.0)}}, "states.coolant"),
    ],
)
def test_a_field_that_cannot_be_is_named(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(SetupError, match=message):
        SinumerikSettings(**({"url": URL} | fields))


@pytest.mark.parametrize("fields", [{"request": 64}, {"results": 50}, {"poses": 0}, {"request_valid_for_s": -1.0}])
def test_handshake_parameters_that_overlap(fields: dict[str, Any]) -> None:
    with pytest.raises(SetupError):
        Handshake(**fields)


@pytest.mark.parametrize("fields", [{"route": "K0"}, {"signs": (1, 0, 1)}, {"first_r": -1}, {"largest_um": 0.0}])
def test_a_compensation_that_cannot_be(fields: dict[str, Any]) -> None:
    with pytest.raises(SetupError):
        Compensation(**fields)


def test_the_sign_follows_the_route_unless_it_is_given() -> None:
    assert [Compensation(route="k0").sign(i) for i in range(3)] == [-1, -1, -1]
    assert [Compensation(route="r").sign(i) for i in range(3)] == [1, 1, 1]
    assert [Compensation(signs=(1, -1, 1)).sign(i) for i in range(3)] == [1, -1, 1]


def test_other_node_names_by_field_and_by_state() -> None:
    settings = SinumerikSettings(url=URL).with_nodes(
        {
            "probe_in_spindle": "/Plc/DB99.DBX0.1",
            "states.coolant": "/Plc/Q4.0",
            "r_parameter": "/Channel/Parameter/R[u2,{n}]",
        }
    )
    assert settings.paths.probe_in_spindle == "/Plc/DB99.DBX0.1"
    assert settings.state_sources["coolant"] == Source("/Plc/Q4.0")
    assert settings.state_sources["speed_C"].divisor == 360.0
    assert settings.r(60) == "/Channel/Parameter/R[u2,60]"
    with pytest.raises(SetupError, match=r"nodes\.coolant: unknown"):
        SinumerikSettings(url=URL).with_nodes({"coolant": "/Plc/Q4.0"})
