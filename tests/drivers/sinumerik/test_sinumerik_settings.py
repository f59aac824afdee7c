"""Invalid settings are reported on construction, without any network."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.base import SetupError
from drivers.problems import settings_of
from drivers.sinumerik.settings import Handshake, LeaseParameters, OffsetRoute, Paths, SinumerikSettings, StateNode

URL = "opc.tcp://127.0.0.1:4840"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"url": "http://mill:4840"}, "url: 'http://mill:4840': expected opc.tcp://"),
        ({"url": "mill"}, "url: 'mill': expected opc.tcp://"),
        ({"timeout_s": 0.0}, "timeout_s: 0.0: expected more than 0"),
        ({"security": "Basic128"}, "security: 'Basic128' is invalid"),
        ({"user": "gateway"}, "user and password_file"),
        ({"password_file": Path("secret")}, "user and password_file"),
        ({"security": "Basic256Sha256"}, "needs certificate and private_key"),
        ({"security": "Basic256Sha256", "certificate": Path("a.pem")}, "needs certificate and private_key"),
        (
            {"security": "Basic256Sha256", "certificate": Path("a.crt"), "private_key": Path("b.pem")},
            r"certificate: 'a.crt': expected a file ending in \.pem or \.der",
        ),
        ({"axis_numbers": {"X": 1, "Y": 2, "Z": 3}}, "axis_numbers"),
        ({"axis_numbers": {"X": 1, "Y": 1, "Z": 3, "A": 4, "C": 5}}, "axis_numbers"),
        ({"axis_numbers": {"X": 0, "Y": 1, "Z": 3, "A": 4, "C": 5}}, "axis_numbers"),
        ({"subscribe_s": math.nan}, "subscribe_s: nan: expected a finite number"),
        ({"poses": 0}, "poses: 0: expected at least 1"),
        (
            {"origin_mm": (0.0, math.nan, 0.0)},
            r"origin_mm\[1\]: nan: expected a finite number",
        ),
        ({"handshake": Handshake(request=64)}, "R64 is handshake.request as well as handshake.answers"),
        ({"handshake": Handshake(results=50)}, r"R60 is handshake.request as well as handshake.results \(of 6 poses\)"),
        ({"handshake": Handshake(withdraw=-1)}, "handshake.withdraw = -1"),
        ({"poses": 8}, r"R88 is handshake.results \(of 8 poses\) as well as handshake.spread"),
        ({"lease": LeaseParameters(beat=60)}, "R60 is handshake.request as well as lease.beat"),
        ({"compensation": OffsetRoute(route="r", first_r=92)}, "R93 is lease.owner as well as compensation.first_r"),
        ({"compensation": OffsetRoute(route="r", first_r=-1)}, "compensation.first_r .* = -1"),
    ],
)
def test_an_invalid_field_is_named(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(SetupError, match=message):
        settings_of(SinumerikSettings, {"url": URL, "security": "none"} | fields)


def test_parameters_of_a_route_that_is_not_taken_may_have_another_meaning() -> None:
    assert (
        SinumerikSettings(
            security="none", url=URL, compensation=OffsetRoute(route="k0", first_r=60)
        ).compensation.first_r
        == 60
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Paths(position="/Channel/MachineAxis/actToolBasePos"), "position = .* holds {n} once"),
        (lambda: Paths(tool="actTNumber"), "tool = 'actTNumber'"),
        (lambda: Paths(alarms=("numAlarms",)), "alarms holds 'numAlarms'"),
        (lambda: StateNode("Plc/M1.0"), "path = 'Plc/M1.0'"),
        (lambda: StateNode("/Plc/M1.0", 0.0), "divisor = 0.0"),
        (lambda: StateNode("/Plc/M1.0", math.inf), "divisor = inf"),
        (lambda: Handshake(request_valid_for_s=-1.0), "request_valid_for_s = -1.0"),
    ],
)
def test_an_invalid_part_is_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(SetupError, match=message):
        make()


@pytest.mark.parametrize(
    "fields", [{"route": "K0"}, {"signs": (1, 0, 1)}, {"largest_um": 0.0}, {"largest_um": math.inf}]
)
def test_an_invalid_compensation(fields: dict[str, Any]) -> None:
    with pytest.raises(SetupError):
        OffsetRoute(**fields)


def test_the_sign_follows_the_route_unless_it_is_given() -> None:
    assert [OffsetRoute(route="k0").sign(i) for i in range(3)] == [-1, -1, -1]
    assert [OffsetRoute(route="r").sign(i) for i in range(3)] == [1, 1, 1]
    assert [OffsetRoute(signs=(1, -1, 1)).sign(i) for i in range(3)] == [1, -1, 1]


def test_node_names_of_r_parameters_and_speeds_follow_the_settings() -> None:
    settings = SinumerikSettings(
        security="none",
        url=URL,
        nodes=Paths(r_parameter="/Channel/Parameter/R[u2,{n}]"),
        axis_numbers={"X": 3, "Y": 2, "Z": 1, "A": 4, "C": 6},
    )
    assert settings.r(60) == "/Channel/Parameter/R[u2,60]"
    assert settings.state_sources["speed_X"] == StateNode("/Channel/MachineAxis/actFeedRate[u1,3]")
    assert settings.state_sources["speed_C"] == StateNode("/Channel/MachineAxis/actFeedRate[u1,6]", 360.0)
