"""What an agent's description suggests for a first configuration."""

import asyncio
from pathlib import Path

import pytest

from drivers.base import BadAnswer, ConnectError
from drivers.mtconnect.make import suggest_mtconnect
from drivers.mtconnect.suggest import SuggestedItems, suggested_items
from tests.benches.mtconnect_agent import mtconnect_agent
from tests.benches.refusals import refusing

pytestmark = pytest.mark.filterwarnings("ignore:datetime:DeprecationWarning")
LIMIT_S = 60.0


def item(item: str, kind: str, units: str = "", **more: str) -> str:
    about = {"id": item, "type": kind, "category": "SAMPLE" if units else "EVENT", "units": units} | more
    return "<DataItem " + " ".join(f'{name}="{value}"' for name, value in about.items() if value) + "/>"


def axis(kind: str, name: str, *items: str, native: str = "") -> str:
    return f'<{kind} id="{name}" name="{name}" nativeName="{native}"><DataItems>{"".join(items)}</DataItems></{kind}>'


def described(*axes: str, device: str = 'name="mill" uuid="m1"', controller: str = "") -> bytes:
    systems = '<CoordinateSystem id="m" type="MACHINE"/><CoordinateSystem id="w" type="WORK"/>'
    return (
        f'<m:MTConnectDevices xmlns:m="urn:mtconnect.org:MTConnectDevices:1.8"><Devices><Device id="d" {device}>'
        f"<Configuration>{systems}</Configuration><Components><Axes><Components>{''.join(axes)}</Components></Axes>"
        f"<Controller><DataItems>{controller}</DataItems></Controller></Components></Device></Devices>"
        "</m:MTConnectDevices>"
    ).encode()


def linear(name: str, *items: str) -> str:
    return axis("Linear", name, item(f"{name}abs", "POSITION", "MILLIMETER", subType="ACTUAL"), *items)


def test_the_agent_of_others_suggests_what_the_driver_accepts(tmp_path: Path) -> None:
    with mtconnect_agent(tmp_path) as (_, url):
        found = asyncio.run(suggest_mtconnect(url, "", LIMIT_S))
    assert found == SuggestedItems(
        positions={name: f"{name}pos" for name in "XYZAC"},
        states={"spindle_speed": "Srpm", "speed_X": "Xfrt", "speed_C": "Cfrt"},
        named={"mode": "mode", "program": "exec", "tool": "tool", "emergency_stop": "estop"},
    )


def test_the_position_that_does_not_move_with_the_workpiece_is_taken_and_the_actual_one_first() -> None:
    document = described(
        axis("Linear", "X",
             item("Xwork", "POSITION", "MILLIMETER", subType="ACTUAL", coordinateSystemIdRef="w"),
             item("Xcom", "POSITION", "MILLIMETER", subType="COMMANDED", coordinateSystemIdRef="m"),
             item("Xtravel", "POSITION", category="CONDITION"),
             item("Xabs", "POSITION", "MILLIMETER", subType="ACTUAL", coordinateSystemIdRef="m"),
             item("Xovr", "AXIS_FEEDRATE", "PERCENT", subType="OVERRIDE"),
             item("Xfrt", "AXIS_FEEDRATE", "MILLIMETER/SECOND")),
        axis("Linear", "Y", item("Ycom", "POSITION", "MILLIMETER", subType="COMMANDED")),
        axis("Linear", "Z", item("Zwork", "POSITION", "MILLIMETER", coordinateSystem="WORK")),
    )  # fmt: skip
    found = suggested_items(document)
    assert found.positions == {"X": "Xabs", "Y": "Ycom"}, "Z has only one in WORK coordinates"
    assert found.states == {"speed_X": "Xfrt"}


def test_a_spindle_that_is_called_c_is_not_an_axis() -> None:
    document = described(
        linear("X1"),
        axis("Rotary", "C", item("S1speed", "SPINDLE_SPEED", "REVOLUTION/MINUTE", subType="ACTUAL"), native="S1"),
        axis("Rotary", "B2", item("Apos", "ANGLE", "DEGREE"), native="A"),
        axis("Rotary", "C3", item("C3pos", "ANGLE", "DEGREE"), item("C3vel", "ANGULAR_VELOCITY", "DEGREE/SECOND")),
    )
    found = suggested_items(document)
    assert found.positions == {"X": "X1abs", "A": "Apos", "C": "C3pos"}
    assert found.states == {"spindle_speed": "S1speed", "speed_C": "C3vel"}


def test_the_controls_own_name_of_an_axis_counts_before_a_number_behind_it() -> None:
    absolute = item("Qabs", "POSITION", "MILLIMETER", subType="ACTUAL")
    found = suggested_items(described(linear("X2"), axis("Linear", "Q", absolute, native="X")))
    assert found.positions == {"X": "Qabs"}


def test_only_the_first_of_several_machines_and_its_items_count() -> None:
    first = described(linear("X"), controller=item("m1", "CONTROLLER_MODE"))
    second = described(linear("Y"), device='uuid="m2"', controller=item("e2", "EXECUTION"))
    found = suggested_items(b"<Both>" + first + second + b"</Both>")
    assert found == SuggestedItems("mill", positions={"X": "Xabs"}, named={"mode": "m1"})
    assert suggested_items(b"<Both>" + second + first + b"</Both>").machine == "m2", "it has no name"
    assert suggested_items(first).machine == ""


@pytest.mark.parametrize(
    ("document", "says"),
    [
        (b"<MTConnectStreams/>", "describes no machine"),
        (b'<E><Error errorCode="NO_DEVICE">no mill2</Error></E>', "the agent reports NO_DEVICE: no mill2"),
        (b"moved", "not XML"),
    ],
)
def test_a_document_that_describes_no_machine_is_reported(document: bytes, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        suggested_items(document)


def test_an_agent_that_cannot_be_read_is_a_drivers_error(tmp_path: Path) -> None:
    with mtconnect_agent(tmp_path) as (_, url), refusing(BadAnswer, "mtc_status request=probe status=404 mtc_check"):
        asyncio.run(suggest_mtconnect(url, "lathe", LIMIT_S))
    with refusing(ConnectError, "mtc_failed why=Connection_refused"):
        asyncio.run(suggest_mtconnect("http://127.0.0.1:9", "", LIMIT_S))
