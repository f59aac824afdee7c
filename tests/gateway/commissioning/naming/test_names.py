"""Names in the text of a configuration, in a wiring list, and taken back."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from gateway.commissioning.naming.names import Input, Listed, Names, changes, checklist, read_list, written
from gateway.commissioning.naming.renamed import confirmed, renamed
from gateway.config.file import parse
from gateway.config.problems import ConfigError
from tests.benches.refusals import refusing

PATH = Path("gateway.toml")
TEXT = """# our mill; bed = old
[machine]
name = "mill"
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "127.0.0.1"
[[device]]
name = "adam"  # cabinet
bus = "tcp1"
profile = "advantech_adam6015"
[device.channels]  # CONFIRM: a name for each input, such as bed_front_left
bed = 0  # left
"column" = 1
x_nut = 2
[limits.bed]
min = 5.0
[limits]
column.max = 60.0
"""


def test_two_exchange_their_names_wherever_they_stand_and_comments_stay() -> None:
    made = renamed(TEXT, {"bed": "column", "column": "bed"}, PATH)
    assert made.splitlines()[0] == "# our mill; bed = old"
    assert "column = 0  # left\nbed = 1\n" in made
    config = parse(made, PATH)
    assert list(config.devices[0].channels.items()) == [("column", 0), ("bed", 1), ("x_nut", 2)]
    assert (config.limits["column"].min, config.limits["bed"].max) == (5.0, 60.0)
    assert renamed(made, {"bed": "column", "column": "bed"}, PATH) == TEXT.replace('"column"', "column")
    assert "CONFIRM" not in confirmed(made, "adam")
    assert confirmed(made, "other") == made


def test_channels_on_one_line_are_renamed_too() -> None:
    one = TEXT.split("[device.channels]")[0] + "channels = { bed = 0, column = 1 }\n"
    assert "channels = { column = 0, nut = 1 }" in renamed(one, {"bed": "column", "column": "nut"}, PATH)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (TEXT.replace('"column" = 1', '"col\\u0075mn" = 1'), {"column": "spindle"}),
        (TEXT, {"bed": "column"}),
    ],
    ids=["escaped", "taken"],
)
def test_what_cannot_be_written_changes_nothing(text: str, names: dict[str, str]) -> None:
    with pytest.raises(ConfigError):
        renamed(text, names, PATH)


def test_an_earlier_name_goes_to_whoever_had_the_new_one_until_that_was_named() -> None:
    names = Names.of(parse(TEXT, PATH))
    bed, column = Input("adam", 0), Input("adam", 1)
    given = names.give(column, "bed", "warmed")
    assert (names.now[column], names.now[bed]) == ("bed", "column")
    assert changes(given) == {"column": "bed", "bed": "column"}
    with refusing(ValueError, "name_taken device=adam number=1"):
        names.give(bed, "bed", "warmed")
    with refusing(ValueError, "expected a_machine_name"):
        names.give(bed, "3 nuts", "warmed")
    assert names.undo() == given
    assert list(names.now.values()) == ["bed", "column", "x_nut"]
    assert names.undo() is None


def test_a_session_goes_on_from_the_protocol_of_earlier_ones(tmp_path: Path) -> None:
    names, protocol = Names.of(parse(TEXT, PATH)), tmp_path / "gateway.names.csv"
    later = Names.of(parse(TEXT, PATH))
    later.resume(protocol)
    assert not later.given, "there was none"
    at = datetime(2026, 1, 2, tzinfo=UTC)
    for number, name in ((1, "bed"), (0, "column_top"), (2, "nut"), (2, "")):
        given = names.give(Input("adam", number), name, "warmed") if name else names.undo()
        assert given is not None
        written(protocol, at, "Ada", given, None, back=not name)
    later.now |= names.now
    later.resume(protocol)
    assert later.given == names.given
    while later.undo() is not None:
        pass
    assert list(later.now.values()) == ["bed", "column", "x_nut"], "also what was exchanged"
    later.now |= names.now | {Input("adam", 0): "by_hand"}
    later.resume(protocol)
    assert [each.name for each in later.given] == ["bed"], "what was edited since is asked for again"


def test_a_filled_checklist_is_read_back_and_its_mistakes_have_lines(tmp_path: Path) -> None:
    config, file = parse(TEXT, PATH), tmp_path / "wiring.csv"
    printed = checklist(config)
    assert printed == "device,input,now,name\nadam,0,bed,\nadam,1,column,\nadam,2,x_nut,\n"
    file.write_text(printed.replace("bed,", "bed,bed_left").replace(",", ";"), encoding="utf-8")
    assert read_list(file, config) == [Listed("bed_left", Input("adam", 0))]
    file.write_text("name\nbed_left\nspindle\n", encoding="utf-8")
    assert read_list(file, config) == [Listed("bed_left"), Listed("spindle")]
    file.write_text("device,input,name\nadam,9,bed\nadam,x,nut\nadam,1,a b\nadam,1,ok\nadam,1,ok2\n", encoding="utf-8")
    with pytest.raises(ConfigError) as wrong:
        read_list(file, config)
    assert [str(each).split(":")[0] for each in wrong.value.problems] == ["line 2", "line 3", "line 4", "line 6"]
    file.write_text("sensor;where\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="sensor;where"):
        read_list(file, config)
