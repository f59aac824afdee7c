"""The configuration: golden cases of every mistake, and what a good file becomes."""

import re
import tomllib
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.build import BUS_KINDS
from gateway.config.extended import stored_configuration
from gateway.config.file import from_data, load, parse
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError
from gateway.config.reference import reference
from gateway.config.rules import cautions
from simulators.bench import gateway_toml
from talc.presets import PRESETS
from tests.benches.refusals import coded

CASES = Path(__file__).parent / "cases"
MISTAKES = tomllib.loads((CASES.parent / "mistakes.toml").read_text(encoding="utf-8"))
BENCH = Path(__file__).parents[3] / "simulators" / "bench" / "gateway.toml"
PLACES = {
    "zenoh_connect": "[]",
    "talc": "",
    "folder": "/tmp",
    "zenoh_port": "7447",
    "rtu_port": "/dev/pts/1",
    "tcp_port": "5020",
    "can_port": "/dev/pts/2",
    "growth_port": "/dev/pts/3",
    "nc_port": "4840",
}


def bench() -> GatewayConfig:
    return parse(gateway_toml(PLACES), BENCH)


def valid_text() -> str:
    return (CASES / "valid" / "gateway.toml").read_text(encoding="utf-8")


def mistaken(name: str, folder: Path) -> Path:
    """A file with this mistake."""
    old, file = MISTAKES[name]["old"], folder / "gateway.toml"
    assert valid_text().count(old) == 1
    file.write_text(valid_text().replace(old, MISTAKES[name]["new"]), encoding="utf-8")
    return file


def told(file: Path) -> str:
    """Line, place and code of each problem; empty: there is none."""
    try:
        load(file)
    except ConfigError as error:
        return "\n".join(f"{p.at.line if p.at else 0}: {p.place}: {coded(p.what)}" for p in error.problems)
    return ""


@pytest.mark.parametrize("name", MISTAKES)
def test_every_mistake_has_its_line(name: str, tmp_path: Path) -> None:
    assert told(mistaken(name, tmp_path)) == MISTAKES[name]["says"].replace("ALL KINDS", ", ".join(sorted(BUS_KINDS)))


@pytest.mark.parametrize("case", sorted(CASES.iterdir()), ids=lambda case: case.name)
def test_several_mistakes_have_theirs(case: Path) -> None:
    expected = (case / "expected.txt").read_text(encoding="utf-8")
    assert told(case / "gateway.toml").replace(str(case), "") == expected.rstrip("\n")


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    file = CASES / "valid" / "gateway.toml"
    (tmp_path / "gateway.toml").write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert load(tmp_path / "gateway.toml").machine == load(file).machine


@pytest.mark.parametrize(
    ("section", "field", "value", "most"),
    [
        ("storage", "commit_s", 1e300, "3600"),
        ("storage", "keep_samples_days", 1e300, "36500"),
        ("storage", "keep_minutes_days", 1e300, "36500"),
        ("storage", "unstored_after_s", 2e9, "1e+09"),
        ("probing", "poll_s", 1e300, "1e+09"),
        ("compensation", "watchdog_s", 1e300, "1e+09"),
    ],
)
def test_a_number_that_nobody_means_is_refused(section: str, field: str, value: float, most: str) -> None:
    with pytest.raises(ConfigError) as refused:
        from_data({**tomllib.loads(valid_text()), section: {field: value}}, Path("gateway.toml"))
    assert f"[{section}] {field}: " in str(refused.value)
    assert f"{value:g}: expected at most {most}" in str(refused.value)


def test_bench_has_thirty_channels_then_the_states_in_file_order() -> None:
    config = bench()
    names = config.input_names
    assert len(config.channels) == 30
    assert names[:2] == ("bed_front_left", "bed_front_right")
    assert names[29:] == ("spindle_growth", "spindle_speed", "speed_X", "speed_Y", "speed_A", "speed_C", "coolant")
    assert [c.name for c in config.channels] == list(names[:30])
    assert (config.channels[18].device, config.channels[18].bus) == ("adam", "tcp1")


def test_canonical_text_is_the_same_configuration_again() -> None:
    config = bench()
    again = stored_configuration(config.canonical())
    assert again == config
    assert again.fingerprint() == config.fingerprint()


def test_a_preset_is_a_paper_s_system_but_for_the_keys_beside_it() -> None:
    text = valid_text() + '\n[talc]\npreset = "zimmermann-2022"\n[talc.control]\ncalibration_steps = 144\n'
    talc = parse(text, CASES / "gateway.toml").talc
    assert talc == replace(
        PRESETS["zimmermann-2022"], control=replace(PRESETS["zimmermann-2022"].control, calibration_steps=144)
    )


def test_fingerprint_depends_on_behaviour_not_on_layout() -> None:
    text = valid_text()
    path = CASES / "valid" / "gateway.toml"
    plain = parse(text, path).fingerprint()
    assert parse("# a remark\n" + text.replace("unit = 1\n", "unit = 1   # left\n"), path).fingerprint() == plain
    assert parse(text + "period_s = 1.0\n", path).fingerprint() == plain, "a default written out changes nothing"
    assert parse(text.replace("unit = 1", "unit = 2"), path).fingerprint() != plain
    swapped = text.replace("bed_front = 0\nbed_rear = 1\n", "bed_rear = 1\nbed_front = 0\n")
    assert parse(swapped, path).fingerprint() != plain, "the order of channels is the order of inputs"


def test_fingerprints_of_supplied_profiles_are_of_the_canonical_text_alone() -> None:
    """Databases of earlier programs contain such fingerprints."""
    assert bench().fingerprint() == sha256(bench().canonical().encode()).hexdigest()


def test_stored_text_with_a_profile_of_the_user_needs_no_file(tmp_path: Path) -> None:
    supplied = Path(__file__).parents[3] / "drivers" / "profiles" / "icpdas_m7015.toml"
    (tmp_path / "mine.toml").write_bytes(supplied.read_bytes())
    config = parse(valid_text().replace("icpdas_m7015", "mine.toml"), tmp_path / "gateway.toml")
    (tmp_path / "mine.toml").unlink()
    assert stored_configuration(config.canonical()).canonical() == config.canonical()


def test_relative_paths_start_at_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(valid_text() + '\n[storage]\npath = "data/mill.sqlite"\n')
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert load(file).storage.path == tmp_path / "data" / "mill.sqlite"
    file.write_text(valid_text())
    assert load(file).storage.path == tmp_path / "gateway.sqlite"
    file.write_text(valid_text() + "\n[storage]\ncommit_s = 2.0\n")
    assert load(file).storage.path == tmp_path / "gateway.sqlite"


def test_unreadable_files_say_so(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read: No such file"):
        load(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'name = "M\xfchle"')
    with pytest.raises(ConfigError, match=r"is not UTF-8 text: byte 9 is 0xfc"):
        load(tmp_path / "latin.toml")


def test_profile_of_the_user_is_found_beside_the_file(tmp_path: Path) -> None:
    supplied = Path(__file__).parents[3] / "drivers" / "profiles" / "icpdas_m7015.toml"
    (tmp_path / "mine.toml").write_text(supplied.read_text(encoding="utf-8"))
    file = tmp_path / "gateway.toml"
    file.write_text(valid_text().replace("icpdas_m7015", "mine.toml"))
    assert load(file).devices[0].profile == str(tmp_path / "mine.toml")


def test_raw_usb_port_is_a_caution_not_an_error() -> None:
    path = CASES / "valid" / "gateway.toml"
    text = valid_text().replace("192.168.214.1", "127.0.0.1")
    assert cautions(parse(text, path)) == []
    raw = parse(text.replace("/dev/serial/by-id/usb-adapter", "/dev/ttyUSB0"), path)
    (caution,) = cautions(raw)
    assert caution.where == "bus 'rtu1', port"
    assert "/dev/serial/by-id" in caution.what


def test_a_database_below_etc_is_a_caution_as_the_service_may_not_write_there() -> None:
    """Also a database that no line names: it would be beside the file."""
    text = valid_text().replace("192.168.214.1", "127.0.0.1")
    installed = Path("/etc/talc-gateway/gateway.toml")
    (caution,) = cautions(parse(text, installed))
    assert caution.where == "[storage] path"
    assert "'/etc/talc-gateway/gateway.sqlite' is in /etc" in caution.what
    elsewhere = f'{text}\n[storage]\npath = "/var/lib/talc-gateway/gateway.sqlite"\n'
    assert cautions(parse(elsewhere, installed)) == []


def test_an_address_as_in_a_manual_is_a_caution(tmp_path: Path) -> None:
    """Not an error: some devices have such addresses, and devices that have all addresses show some number."""
    profile = 'protocol = "modbus"\ntitle = "meter"\nbuses = ["modbus_tcp"]\nunit = "W"\n'
    for function, address in ((3, 40101), (4, 100), (4, 30001)):
        profile += f'[[block]]\nfunction = {function}\naddress = {address}\ntype = "int16"\n'
    profile += '[[block]]\nfunction = 3\naddress = 40011\ntype = "bit"\nbit = 3\n'
    profile += '[[block]]\nfunction = 1\naddress = 40012\ntype = "bit"\n'  # manuals number coils differently
    (tmp_path / "meter.toml").write_text(profile)
    file = tmp_path / "gateway.toml"
    file.write_text(
        '[machine]\nname = "mill"\n[telemetry]\nenabled = false\n'
        '[[bus]]\nname = "b"\nkind = "modbus_tcp"\nhost = "127.0.0.1"\n'
        '[[device]]\nname = "meter"\nbus = "b"\nprofile = "meter.toml"\nunit = 1\n'
        "channels = { x = 0, y = 1, z = 2, alarm = 3, coil = 4 }\n"
    )
    told = {caution.where: [int(n) for n in re.findall(r"\d+", caution.what)][-3:] for caution in cautions(load(file))}
    assert told == {
        "device 'meter', channels.x": [40101, 3, 100],
        "device 'meter', channels.z": [30001, 4, 0],
        "device 'meter', channels.alarm": [40011, 3, 10],
    }


def test_a_timeout_longer_than_the_period_is_a_caution_where_devices_are_asked() -> None:
    path = CASES / "valid" / "gateway.toml"
    text = valid_text().replace("192.168.214.1", "127.0.0.1")
    slow = text.replace('name = "tcp1"', 'name = "tcp1"\ntimeout_s = 2.0')
    assert cautions(parse(slow, path)) == [], "nobody else is on it"
    second = """[[device]]
name = "second"
bus = "tcp1"
profile = "advantech_adam6015"
unit = 2
channels.roof = 0
"""
    (caution,) = cautions(parse(slow.replace("[[state]]", f"{second}\n[[state]]"), path))
    assert caution.where == "bus 'tcp1', timeout_s"
    assert caution.what.startswith("2 is longer than period_s = 1: one silent device costs the others")
    listening = 'name = "can1"\nkind = "can"\nchannel = "can0"\ntimeout_s = 2.0\n'
    assert cautions(parse(f"{text}\n[[bus]]\n{listening}", path)) == []


def test_password_is_not_in_the_canonical_text(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("hunter2")
    file = tmp_path / "gateway.toml"
    file.write_text(valid_text() + 'user = "gw"\npassword_file = "secret"\n')
    assert "hunter2" not in load(file).canonical()


def test_a_file_names_the_same_kinds_of_bus_as_the_drivers() -> None:
    schema = GatewayConfig.model_json_schema(by_alias=True)
    kinds = {ref["$ref"] for ref in schema["properties"]["bus"]["items"]["oneOf"]}
    named = {schema["$defs"][ref.rpartition("/")[2]]["properties"]["kind"]["const"] for ref in kinds}
    assert named == BUS_KINDS.keys()


def test_reference_is_the_program_s() -> None:
    page = (Path(__file__).parents[3] / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert page == reference(), "run: python -m gateway.config.reference > docs/configuration.md"


def test_a_list_of_words_is_a_key_of_the_reference() -> None:
    assert "| `may` | list | required |" in reference()


def test_every_key_of_the_reference_says_what_it_means() -> None:
    rows = [line for line in reference().splitlines() if line.startswith("| `")]
    assert len(rows) > 60
    assert not [row for row in rows if row.endswith("|  |")]


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.text(max_size=8),
    st.lists(st.integers(), max_size=3),
    st.dictionaries(st.text(max_size=5), st.integers(), max_size=3),
    st.lists(st.dictionaries(st.sampled_from(["name", "kind", "channels", "x"]), st.text(max_size=4)), max_size=3),
)


def _places(data: object, here: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Every place in the data."""
    found = [here] if here else []
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        found += _places(value, (*here, key))
    return found


@pytest.mark.slow
@settings(max_examples=200)
@given(st.data())
def test_whatever_stands_in_the_file_it_is_a_configuration_or_a_list_of_lines(data: st.DataObject) -> None:
    content = tomllib.loads(valid_text())
    for place in data.draw(st.lists(st.sampled_from(_places(content)), min_size=1, max_size=3)):
        holder: Any = content
        with suppress(KeyError, IndexError, TypeError):
            for part in place[:-1]:
                holder = holder[part]
            if data.draw(st.booleans()) and isinstance(holder, dict):
                holder[data.draw(st.text(min_size=1, max_size=6))] = data.draw(JUNK)
            else:
                holder[place[-1]] = data.draw(JUNK)
    found: ConfigError | None = None
    try:
        config = from_data(content, Path("gateway.toml"))
    except ConfigError as error:
        found = error
    if found is None:
        assert stored_configuration(config.canonical()) == config
    else:
        lines = str(found).splitlines()
        assert len(lines) == len(found.problems) > 0
        assert all(line.startswith("gateway.toml: ") for line in lines)


@pytest.mark.parametrize("channels", [1000, 1001])
def test_more_channels_than_a_database_can_number_are_refused(channels: int, tmp_path: Path) -> None:
    (tmp_path / "hall.toml").write_text(
        'protocol = "mqtt"\ntitle = "hall"\nunit = "degC"\nmax_age_s = 1\n'
        + "".join(f'[[topic]]\ntopic = "hall/{number}"\n' for number in range(channels))
    )
    bus = '[machine]\nname = "mill"\n[[bus]]\nname = "hall"\nkind = "mqtt"\nurl = "mqtt://127.0.0.1"\n'
    device = '[[device]]\nname = "hall"\nbus = "hall"\nprofile = "hall.toml"\n[device.channels]\n'
    text = bus + device + "".join(f"s{number} = {number}\n" for number in range(channels))
    if channels <= 1000:
        parse(text, tmp_path / "gateway.toml")
        return
    with pytest.raises(ConfigError, match="1001 channels: expected at most 1000 at one gateway"):
        parse(text, tmp_path / "gateway.toml")
