"""The first configuration of a machine: valid, unarmed, and every guess in it named."""

from pathlib import Path

import pytest

from drivers.mtconnect.suggest import SuggestedItems
from drivers.recognition import Recognition
from gateway.commissioning.scan.first import (
    Answers,
    LinuxCncAnswers,
    MtConnectAnswers,
    SinumerikAnswers,
    answers_text,
    first_configuration,
    read_answers,
    to_confirm,
)
from gateway.commissioning.scan.found import Found, Place
from gateway.config.consequences import unarmed
from gateway.config.controls import MtConnectNc
from gateway.config.file import parse
from gateway.config.problems import ConfigError

ADAM = Place(
    "modbus_tcp", {"host": "10.0.0.9"}, (Found(1, Recognition("advantech_adam6015", (0, 1), "module name")),)
)  # fmt: skip
SHOWN = Path(__file__).parents[4] / "examples" / "init" / "answers.toml"
GUESSED = {
    None: ["a name for each input"],
    "sinumerik": ["password", "the gateway's", "its key", "copied", "number of each", "machine coordinates", "a bit",
                  "likewise", "dial gauge", "A and C of each pose", "distance", "height", "largest offset"],
    "linuxcnc": ["agent's key", "distance", "height", "largest offset"],
    "agent": ["agent's key", "A and C of each", "distance", "height", "largest offset"],
}  # fmt: skip


@pytest.mark.parametrize(
    "control",
    [None, SinumerikAnswers(kind="sinumerik"), SinumerikAnswers(kind="sinumerik", user=""),
     LinuxCncAnswers(kind="linuxcnc"), LinuxCncAnswers(kind="agent")],
)  # fmt: skip
def test_it_is_valid_arms_nothing_and_names_each_guess(
    control: SinumerikAnswers | LinuxCncAnswers | None, tmp_path: Path
) -> None:
    text = first_configuration(Answers(machine="mill", control=control), [ADAM], tmp_path / "gateway.toml")
    config = parse(text, tmp_path / "gateway.toml")
    assert (config.machine.name, [d.profile for d in config.devices]) == ("mill", ["advantech_adam6015"])
    assert not config.probing.armed
    assert config.compensation.mode == "monitor"
    assert ("there is no [nc]" in unarmed(config)[0]) == (control is None)
    kind = None if control is None else control.kind
    expected = [*GUESSED[None], *(GUESSED[kind] if kind else [])]
    if isinstance(control, SinumerikAnswers) and not control.user:
        expected.remove("password")
    guesses = to_confirm(text)
    lines = text.splitlines()
    assert len(guesses) == len(expected)
    for (number, what), word in zip(guesses, expected, strict=True):
        assert word in what or word in lines[number - 1]


def test_a_file_below_etc_has_its_database_where_the_service_may_write(tmp_path: Path) -> None:
    installed = Path("/etc/talc-gateway/gateway.toml")
    text = first_configuration(Answers(machine="mill"), [ADAM], installed)
    assert parse(text, installed).storage.path == Path("/var/lib/talc-gateway/gateway.sqlite")
    elsewhere = first_configuration(Answers(machine="mill"), [ADAM], tmp_path / "gateway.toml")
    assert parse(elsewhere, tmp_path / "gateway.toml").storage.path == tmp_path / "gateway.sqlite"


ITEMS = SuggestedItems(
    positions={"X": "x1", "Y": "y1", "Z": "z1", "C": "c1"}, states={"speed_C": "c2"}, named={"mode": "m", "tool": "t"}
)


def mtconnect(items: SuggestedItems | None, path: Path, machine: str = "") -> tuple[str, MtConnectNc]:
    control = MtConnectAnswers(kind="mtconnect", machine=machine)
    text = first_configuration(Answers(machine="mill", control=control), [ADAM], path, items)
    config = parse(text, path)
    assert isinstance(config.nc, MtConnectNc)
    assert [state.name for state in config.states] == list(config.nc.states)
    assert config.compensation.mode == "monitor"
    return text, config.nc


def test_data_items_of_an_agent_are_written_and_what_it_lacks_is_to_be_confirmed(tmp_path: Path) -> None:
    text, nc = mtconnect(ITEMS, tmp_path / "gateway.toml")
    assert nc.positions == {"X": "x1", "Y": "y1", "Z": "z1", "A": "Aabs", "C": "c1"}
    assert (nc.states, nc.mode, nc.tool, nc.program, nc.machine) == ({"speed_C": "c2"}, "m", "t", "", "")
    lines = text.splitlines()
    guesses = {lines[number - 1].split(" =")[0]: what for number, what in to_confirm(text)}
    assert list(guesses)[1:] == [
        "mode", "# program", "tool", "# emergency_stop", "origin_mm", *"XYZAC", "speed_C",
    ]  # fmt: skip
    assert {name for name, what in guesses.items() if what.startswith("not found")} == {"A"}


def test_an_agent_that_was_not_read_leaves_placeholders(tmp_path: Path) -> None:
    text, nc = mtconnect(None, tmp_path / "gateway.toml")
    assert (nc.positions["X"], nc.states, nc.mode) == ("Xabs", {}, "")
    assert sum("not found; id of the position" in what for _, what in to_confirm(text)) == 5


@pytest.mark.parametrize(("asked", "written"), [("mill_3", "mill_3"), ("", "mill_2")])
def test_of_several_machines_the_one_asked_for_or_the_first_is_named(asked: str, written: str, tmp_path: Path) -> None:
    several = SuggestedItems("mill_2", ITEMS.positions, ITEMS.states, ITEMS.named)
    text, nc = mtconnect(several, tmp_path / "gateway.toml", asked)
    assert nc.machine == written
    assert any("it has others" in what for _, what in to_confirm(text)) == (asked == "")


def test_without_a_device_the_answers_are_written_and_check_refuses_them_still(tmp_path: Path) -> None:
    answers = Answers(machine="mill", control=SinumerikAnswers(kind="sinumerik"))
    text = first_configuration(answers, [], tmp_path / "gateway.toml")
    with pytest.raises(ConfigError, match="without a device"):
        parse(text, tmp_path / "gateway.toml")
    extended = first_configuration(answers, [ADAM], tmp_path / "gateway.toml", existing=text)
    config = parse(extended, tmp_path / "gateway.toml")
    assert ([d.profile for d in config.devices], config.nc is not None) == (["advantech_adam6015"], True)
    assert first_configuration(answers, [ADAM], tmp_path / "gateway.toml", existing=extended) == extended


def test_kept_answers_are_the_answers(tmp_path: Path) -> None:
    path = tmp_path / "answers.toml"
    answers = read_answers(SHOWN)
    path.write_text(answers_text(answers), encoding="utf-8")
    assert read_answers(path) == answers


def test_answers_in_a_file_are_as_strict_as_a_configuration(tmp_path: Path) -> None:
    path = tmp_path / "answers.toml"
    path.write_text('machine = "mill 7"\nhost = "10.0.0.9"\n[control]\nkind = "fanuc"\n', encoding="utf-8")
    with pytest.raises(ConfigError) as found:
        read_answers(path)
    told = str(found.value)
    assert "'mill 7': expected a letter" in told
    assert "host" in told
    assert "fanuc" in told
    assert told.count(str(path)) == 3


def test_the_answers_that_the_page_shows_are_valid() -> None:
    answers = read_answers(SHOWN)
    assert set(Answers.model_fields) == answers.model_fields_set
    assert answers.control is not None
    assert answers.control.kind == "sinumerik"
