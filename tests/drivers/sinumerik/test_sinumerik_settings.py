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
from tests.benches.refusals import refusing

URL = "opc.tcp://127.0.0.1:4840"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"url": "http://mill:4840"}, "url: expected value='http://mill:4840' opcua_an_url"),
        ({"url": "mill"}, "url: expected value='mill' opcua_an_url"),
        ({"timeout_s": 0.0}, "timeout_s: expected value=0.0 more_than limit=0.0"),
        ({"security": "Basic128"}, "security: invalid value='Basic128' possible"),
        ({"user": "gateway"}, "both_or_neither first=user"),
        ({"password_file": Path("secret")}, "both_or_neither first=user"),
        ({"security": "Basic256Sha256"}, "security: opcua_needs_key"),
        ({"security": "Basic256Sha256", "certificate": Path("a.pem")}, "security: opcua_needs_key"),
        (
            {"security": "Basic256Sha256", "certificate": Path("a.crt"), "private_key": Path("b.pem")},
            "certificate: opcua_ending path=a.crt",
        ),
        ({"axis_numbers": {"X": 1, "Y": 2, "Z": 3}}, "axis_numbers: sinumerik_axis_numbers"),
        (
            {"axis_numbers": {"X": 1, "Y": 1, "Z": 3, "A": 4, "C": 5}},
            "axis_numbers: sinumerik_axis_numbers",
        ),
        (
            {"axis_numbers": {"X": 0, "Y": 1, "Z": 3, "A": 4, "C": 5}},
            "axis_numbers: sinumerik_axis_numbers",
        ),
        ({"subscribe_s": math.nan}, "subscribe_s: expected value=nan a_finite_number"),
        ({"channel": 0}, "channel: expected value=0 at_least limit=1"),
        (
            {
                "nodes": Paths(tool_length="/Channel/State/actToolLength1[u1]"),
                "compensation": OffsetRoute(route="k0_slope", travel_mm=((0.0, 1.0),) * 3),
            },
            "nodes.tool_length: sinumerik_no_tool_length",
        ),
        ({"poses": 0}, "poses: expected value=0 at_least limit=1"),
        (
            {"origin_mm": (0.0, math.nan, 0.0)},
            "origin_mm[1]: expected value=nan a_finite_number",
        ),
        (
            {"handshake": Handshake(request=64)},
            "sinumerik_r_twice one=handshake.request other=handshake.answers sinumerik_other_r",
        ),
        (
            {"handshake": Handshake(results=50)},
            "sinumerik_r_twice one=handshake.request other=handshake.results_(of_6_poses) sinumerik_other_r",
        ),
        ({"poses": 8}, "sinumerik_r_twice one=handshake.results_(of_8_poses) other=handshake.spread sinumerik_other_r"),
        (
            {"lease": LeaseParameters(beat=60)},
            "sinumerik_r_twice one=handshake.request other=lease.beat sinumerik_other_r",
        ),
        ({"compensation": OffsetRoute(route="r", first_r=92)}, "sinumerik_r_twice one=lease.owner sinumerik_other_r"),
    ],
)
def test_an_invalid_field_is_named(fields: dict[str, Any], message: str) -> None:
    with refusing(SetupError, message):
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
        (Paths, {"position": "/Channel/pos"}, "position: expected value='/Channel/pos' sinumerik_a_numbered"),
        (Paths, {"referenced": "/ref"}, "referenced: expected value='/ref' sinumerik_numbered_or_none"),
        (Paths, {"tool": "actTNumber"}, "tool: expected value='actTNumber' sinumerik_node_or_none"),
        (Paths, {"alarms": ("numAlarms",)}, "alarms[0]: expected value='numAlarms' sinumerik_a_node"),
        (StateNode, {"path": "Plc/M1.0"}, "path: expected value='Plc/M1.0' sinumerik_a_node"),
        (StateNode, {"path": "/Plc/M1.0", "divisor": 0.0}, "divisor: sinumerik_not_zero value=0.0"),
        (StateNode, {"path": "/Plc/M1.0", "divisor": math.inf}, "divisor: expected value=inf a_finite_number"),
        (Handshake, {"request_valid_for_s": -1.0}, "request_valid_for_s: expected value=-1.0 at_least"),
        (Handshake, {"request_valid_for_s": 1e300}, "request_valid_for_s: expected value=1e+300 at_most"),
        (Handshake, {"withdraw": -1}, "withdraw: expected value=-1 at_least limit=0"),
        (LeaseParameters, {"beat": -1}, "beat: expected value=-1 at_least limit=0"),
        (ErrorParameters, {"terms": -1}, "terms: expected value=-1 at_least limit=0"),
        (OffsetRoute, {"first_r": -1}, "first_r: expected value=-1 at_least limit=0"),
        (OffsetRoute, {"route": "K0"}, "route: invalid value='K0' mean"),
        (OffsetRoute, {"signs": (1, 0, 1)}, "signs[1]: sinumerik_sign value=0"),
        (OffsetRoute, {"largest_um": 0.0}, "largest_um: expected value=0.0 more_than limit=0.0"),
        (OffsetRoute, {"largest_um": math.inf}, "largest_um: expected value=inf a_finite_number"),
        (OffsetRoute, {"largest_um": 1e300}, "largest_um: expected value=1e+300 at_most"),
    ],
)
def test_an_invalid_part_is_named(part: type[BaseModel], fields: dict[str, Any], message: str) -> None:
    with refusing(SetupError, message):
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
