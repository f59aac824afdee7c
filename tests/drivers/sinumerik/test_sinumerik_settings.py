"""Invalid settings are reported on construction, without any network."""

import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from drivers.base import SetupError
from drivers.problems import settings_of
from drivers.sinumerik.settings import (
    ErrorParameters,
    Handshake,
    LeaseParameters,
    OffsetRoute,
    Paths,
    SinumerikSettings,
    StateNode,
)

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
        ({"channel": 0}, "channel: 0: expected at least 1"),
        (
            {
                "nodes": Paths(tool_length="/Channel/State/actToolLength1[u1]"),
                "compensation": OffsetRoute(route="k0_slope", travel_mm=((0.0, 1.0),) * 3),
            },
            "route 'k0_slope' does not take it",
        ),
        ({"poses": 0}, "poses: 0: expected at least 1"),
        (
            {"origin_mm": (0.0, math.nan, 0.0)},
            r"origin_mm\[1\]: nan: expected a finite number",
        ),
        ({"handshake": Handshake(request=64)}, "R64 is handshake.request as well as handshake.answers"),
        ({"handshake": Handshake(results=50)}, r"R60 is handshake.request as well as handshake.results \(of 6 poses\)"),
        ({"poses": 8}, r"R88 is handshake.results \(of 8 poses\) as well as handshake.spread"),
        ({"lease": LeaseParameters(beat=60)}, "R60 is handshake.request as well as lease.beat"),
        ({"compensation": OffsetRoute(route="r", first_r=92)}, "R93 is lease.owner as well as compensation.first_r"),
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
    ("part", "fields", "message"),
    [
        (Paths, {"position": "/Channel/pos"}, "position: '/Channel/pos': expected a node name .* that holds {n} once"),
        (Paths, {"referenced": "/ref"}, "referenced: '/ref': expected .* that holds {n} once, or an empty text"),
        (Paths, {"tool": "actTNumber"}, "tool: 'actTNumber': expected a node name beginning with /, or an empty text"),
        (Paths, {"alarms": ("numAlarms",)}, r"alarms\[0\]: 'numAlarms': expected a node name beginning with /"),
        (StateNode, {"path": "Plc/M1.0"}, "path: 'Plc/M1.0': expected a node name beginning with /"),
        (StateNode, {"path": "/Plc/M1.0", "divisor": 0.0}, "divisor: 0.0: expected a number that is not 0"),
        (StateNode, {"path": "/Plc/M1.0", "divisor": math.inf}, "divisor: inf: expected a finite number"),
        (Handshake, {"request_valid_for_s": -1.0}, "request_valid_for_s: -1.0: expected at least 0"),
        (Handshake, {"request_valid_for_s": 1e300}, r"request_valid_for_s: 1e\+300: expected at most 1e\+09"),
        (Handshake, {"withdraw": -1}, "withdraw: -1: expected at least 0"),
        (LeaseParameters, {"beat": -1}, "beat: -1: expected at least 0"),
        (ErrorParameters, {"terms": -1}, "terms: -1: expected at least 0"),
        (OffsetRoute, {"first_r": -1}, "first_r: -1: expected at least 0"),
        (OffsetRoute, {"route": "K0"}, "route: 'K0' is invalid"),
        (OffsetRoute, {"signs": (1, 0, 1)}, r"signs\[1\]: 0: expected -1 or 1"),
        (OffsetRoute, {"largest_um": 0.0}, "largest_um: 0.0: expected more than 0"),
        (OffsetRoute, {"largest_um": math.inf}, "largest_um: inf: expected a finite number"),
        (OffsetRoute, {"largest_um": 1e300}, r"largest_um: 1e\+300: expected at most 1e\+09"),
    ],
)
def test_an_invalid_part_is_named(part: type[BaseModel], fields: dict[str, Any], message: str) -> None:
    with pytest.raises(SetupError, match=f"^{message}"):
        settings_of(part, fields)


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
    assert settings.state_sources["speed_X"] == StateNode(path="/Channel/MachineAxis/actFeedRate[u1,3]")
    assert settings.state_sources["speed_C"] == StateNode(path="/Channel/MachineAxis/actFeedRate[u1,6]", divisor=360.0)


def test_the_channel_takes_the_place_of_the_first_one_in_its_own_nodes_alone() -> None:
    second = SinumerikSettings(security="none", url=URL, channel=2)
    assert second.r(94) == "/Channel/Parameter/R[u2,94]"
    assert second.linear(second.nodes.position)[0] == "/Channel/MachineAxis/actToolBasePos[u2,1]"
    assert second.linear(second.nodes.k0)[0] == "/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u1]"
    assert second.state_sources["spindle_speed"].path == "/Channel/Spindle/actSpeed[u2,1]"
    assert second.in_channel("/Channel/Parameter/R[u10,1]") == "/Channel/Parameter/R[u10,1]"
