"""Profiles: the supplied ones are valid, and users' profiles are checked key by key."""

from math import inf, nan
from pathlib import Path

import pytest
from pydantic import ValidationError

from drivers.base import SetupError, SystemClock
from drivers.build import make_device
from drivers.modbus.numbers import NumberFormat
from drivers.modbus.profile import ModbusProfile
from drivers.profiles import load_profile, profile_names
from drivers.readings import total
from simulators.devices.scenario import Scenario
from tests.benches.buses import make_bus
from tests.benches.refusals import coded

CASES = Path(__file__).parent / "profile_cases"


@pytest.mark.parametrize("name", profile_names())
def test_supplied_profiles_load_and_are_frozen(name: str) -> None:
    profile = load_profile(name)
    assert profile.name == name
    assert profile.title
    with pytest.raises(ValidationError):
        profile.title = "changed"  # type: ignore[misc]


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SetupError) as caught:
        load_profile(str(tmp_path / "nowhere.toml"))
    assert caught.value.what.code == "profile_unreadable"
    assert "nowhere.toml" in str(caught.value.what.value_of("profile"))


@pytest.mark.parametrize("case", sorted(path.name for path in CASES.iterdir()))
def test_golden_cases(case: str) -> None:
    """Each folder contains a user's profile and the error it gives, as a code with its values; an empty file: none."""
    expected = (CASES / case / "error.txt").read_text(encoding="utf-8").strip()
    path = CASES / case / "profile.toml"
    if not expected:
        assert load_profile(str(path)).name == "profile"
        return
    with pytest.raises(SetupError) as caught:
        load_profile(str(path))
    assert coded(caught.value).replace(str(CASES), "") == expected
    assert str(caught.value).startswith(str(path))


def test_examples_of_the_documentation_are_right(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    files = sorted(root.glob("examples/io-link/*.toml")) + sorted(root.glob("examples/profiles/*.toml"))
    text = "".join(f"```toml\n{file.read_text(encoding='utf-8')}```" for file in files)
    text += "".join((root / "docs" / name).read_text(encoding="utf-8") for name in ("own-profile.md", "wire-log.md"))
    dbc = 'VERSION ""\nBU_: L\nBO_ 768 Temperatures1: 8 L\n SG_ T1 : 0|16@1- (0.1,0) [-200|850] "degC" L\n'
    (tmp_path / "logger.dbc").write_text(dbc, encoding="ascii")
    path = tmp_path / "own.toml"
    channels = {}
    for example in text.split("```toml\n")[1:]:
        content = example.split("```")[0]
        if "[[at]]" in content:
            assert Scenario.parse(content).values(0.0)[0] == 21.0
            continue
        if content.startswith("[vendor."):
            content = (Path(__file__).parents[2] / "drivers" / "profiles" / "cia404.toml").read_text(
                encoding="utf-8"
            ) + content
        path.write_text(content, encoding="utf-8")
        profile = load_profile(str(path))
        channels[profile.title] = profile.channels
    assert channels == {
        "sensors of the hall": 2,
        "temperatures in LinuxCNC": 2,
        "drives of the control": 2,
        "Somebody's pump": 2,
        "Somebody's logger": 1,
        "temperatures at an ifm IO-Link master": 8,
        "temperatures at a Turck IO-Link master": 8,
        "temperatures at a Comtrol IO-Link master": 4,
        "temperatures at an IO-Link master": 2,
        "Somebody's eight-input module": 8,
        "Somebody's energy meter": 11,
        "Somebody's module with status bits": 8,
        "Somebody's module with type codes": 8,
        "CANopen measuring device, CiA 404": 8,
    }


def test_documentation_names_every_profile() -> None:
    text = (Path(__file__).parents[2] / "docs" / "devices.md").read_text(encoding="utf-8")
    assert [name for name in profile_names() if f"| `{name}` |" not in text] == []


@pytest.mark.parametrize(
    ("number", "registers", "value"),
    [
        (NumberFormat("int16"), [0xFFFF], -1),
        (NumberFormat("uint16"), [0xFFFF], 65535),
        (NumberFormat("int16", byte_order="little"), [0x0100], 1),
        (NumberFormat("int32"), [0x0001, 0x0000], 65536),
        (NumberFormat("int32", word_order="little"), [0x0000, 0x0001], 65536),
        (NumberFormat("uint32"), [0xFFFF, 0xFFFF], 2**32 - 1),
        (NumberFormat("float32"), [0x3F80, 0x0000], 1.0),
        (NumberFormat("float64"), [0x3FF8, 0, 0, 0], 1.5),
        (NumberFormat("float64", word_order="little"), [0, 0, 0, 0x3FF8], 1.5),
        (NumberFormat("float64", byte_order="little", word_order="little"), [0, 0, 0, 0xF83F], 1.5),
        (NumberFormat("int64"), [0xFFFF, 0xFFFF, 0xFFFF, 0xFFFE], -2),
        (NumberFormat("uint64", word_order="little"), [1, 0, 0, 0x8000], 2**63 + 1),
        (NumberFormat("float32", word_order="little"), [0x0000, 0x3F80], 1.0),
        (NumberFormat("float32", byte_order="little", word_order="little"), [0x0000, 0x803F], 1.0),
    ],
)
def test_numbers_are_read_in_every_order(number: NumberFormat, registers: list[int], value: float) -> None:
    assert number.decode(registers) == value


def test_what_rounding_leaves_is_zero_and_a_small_number_is_itself() -> None:
    assert 27315 * 0.01 - 273.15 != 0.0
    assert total(27315 * 0.01, -273.15) == 0.0
    assert total(27316 * 0.01, -273.15) == pytest.approx(0.01)
    assert total(5e-14, 0.0) == 5e-14
    assert total(inf, 1.0) == inf
    assert total(1.0, -1.0 + 1e-12) == pytest.approx(1e-12, rel=1e-3)


RTU = {"port": "/dev/null"}


@pytest.mark.parametrize(
    ("kind", "options", "field", "code"),
    [
        ("modbus_rtu", {}, "port", "missing_no_default"),
        ("modbus_rtu", RTU | {"bauds": 9600}, "bauds", "mean"),
        ("modbus_rtu", RTU | {"baud": "fast"}, "baud", "a_whole_number"),
        ("modbus_rtu", RTU | {"baud": "9600"}, "baud", "a_whole_number"),
        ("modbus_rtu", RTU | {"baud": 299}, "baud", "at_least"),
        ("modbus_rtu", RTU | {"parity": "X"}, "parity", "possible"),
        ("modbus_tcp", {"host": "h", "port": 70000}, "port", "at_most"),
        ("modbus_tcp", {"host": "h", "timeout_s": 0}, "timeout_s", "more_than"),
        ("canopen", {"interface": "usb", "channel": "x"}, "interface", "possible"),
        ("canopen", {"interface": "slcan", "channel": "x", "bitrate": 1}, "bitrate", "one_of"),
    ],
)
def test_wrong_bus_settings_name_field_and_value(kind: str, options: dict[str, object], field: str, code: str) -> None:
    with pytest.raises(SetupError) as caught:
        make_bus("b", kind, options)
    assert (caught.value.bus, caught.value.field) == ("b", (field,))
    assert caught.value.what.says(code)
    if field in options and code != "mean":
        assert str(options[field]) in str(caught.value.what.value_of("value"))


@pytest.mark.parametrize(
    ("profile", "unit", "channels", "options", "channel", "field", "code"),
    [
        ("icpdas_m7015", 0, {"a": 0}, {}, "", ("unit",), "unit_beyond"),
        ("icpdas_m7015", 248, {"a": 0}, {}, "", ("unit",), "unit_beyond"),
        ("icpdas_m7015", 1, {"a": 6}, {}, "a", (), "channel_absent"),
        ("icpdas_m7015", 1, {"a": 1, "b": 1}, {}, "b", (), "channel_taken"),
        ("icpdas_m7015", 1, {}, {}, "", (), "no_channels"),
        ("icpdas_m7015", 1, {"a": 0}, {"unit": 1}, "", ("unit",), "unknown_key"),
        ("cia404", 1, {"a": 0}, {}, "", ("profile",), "profile_misfit"),
    ],
)
def test_wrong_devices_name_bus_device_and_channel(
    profile: str,
    unit: int,
    channels: dict[str, int],
    options: dict[str, object],
    channel: str,
    field: tuple[str, ...],
    code: str,
) -> None:
    with pytest.raises(SetupError) as caught:
        make_device("d", make_bus("b", "modbus_rtu", RTU), profile, unit, channels, options, SystemClock())
    error = caught.value
    assert (error.bus, error.device, error.channel, error.field) == ("b", "d", channel, field)
    assert error.what.says(code)


@pytest.mark.parametrize("zero_um", [nan, inf])
def test_options_that_are_no_finite_number_are_refused(zero_um: float) -> None:
    bus = make_bus("b", "me_rs485", RTU)
    options = {"range_um": 500.0, "zero_um": zero_um}
    with pytest.raises(SetupError) as caught:
        make_device("d", bus, "me_rs485", 126, {"a": 0}, options, SystemClock())
    assert caught.value.field == ("zero_um",)
    assert caught.value.what.says("a_finite_number")


def test_a_vendor_that_a_profile_does_not_have_is_refused() -> None:
    bus = make_bus("b", "canopen", {"interface": "virtual", "channel": "x"})
    with pytest.raises(SetupError) as caught:
        make_device("d", bus, "cia404", 5, {"a": 0}, {"vendor": "acme"}, SystemClock())
    assert (caught.value.what.code, caught.value.field) == ("vendor_absent", ("vendor",))
    assert caught.value.hint.says("vendors_known")


def test_a_vendor_that_a_profile_without_vendors_cannot_have_is_refused(tmp_path: Path) -> None:
    supplied = (Path(__file__).parents[2] / "drivers" / "profiles" / "cia404.toml").read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(supplied[: supplied.index("[vendor.")], encoding="utf-8")
    bus = make_bus("b", "canopen", {"interface": "virtual", "channel": "x"})
    with pytest.raises(SetupError) as caught:
        make_device("d", bus, str(tmp_path / "own.toml"), 5, {"a": 0}, {"vendor": "acme"}, SystemClock())
    assert (caught.value.what.code, caught.value.hint.code) == ("vendor_absent", "vendor_none")


def test_supplied_tables_are_those_of_the_manuals() -> None:
    adam = load_profile("advantech_adam6015")
    assert isinstance(adam, ModbusProfile)
    assert adam.type_codes is not None
    span = adam.type_codes.spans[0x03A4]
    assert (span.apply(0), span.apply(65535)) == (-50.0, 150.0)
