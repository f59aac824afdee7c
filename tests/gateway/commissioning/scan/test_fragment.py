"""Scan results added to configurations of many kinds."""

from pathlib import Path

import pytest

from drivers.modbus.settings import ModbusRtuSettings
from drivers.recognition import Recognition
from gateway.commissioning.scan.found import Found, Place
from gateway.commissioning.scan.fragment import check_addable, merged
from gateway.config.file import parse
from gateway.config.problems import ConfigError

FILE = Path("gateway.toml")
BEGUN = '[machine]\nname = "mill"\n'


def test_file_that_was_broken_during_the_scan_is_reported() -> None:
    with pytest.raises(ConfigError, match=r"^gateway\.toml: is not valid TOML: .*line 3"):
        merged(BEGUN + "[[bus]\n", (), FILE)


@pytest.mark.parametrize("text", ["", "\n", BEGUN])
def test_file_that_is_only_begun_can_be_added_to(text: str) -> None:
    check_addable(text, FILE)


MODULE = Recognition("icpdas_m7015", (0,), "type code 0x20")
NODE = Recognition("cia404", (0,), "vendor 0x17", {"vendor": "esd"})
LINE = '[[bus]]\nname = "rtu1"\nkind = "modbus_rtu"\nport = "/dev/rs485"\n'
UNIT_1 = (
    '[[device]]\nname = "old"\nbus = "rtu1"\nprofile = "icpdas_m7015"\nunit = 1\n[device.channels]\nbed_front = 0\n'
)


def rtu(baud: int, parity: str, *units: int) -> Place:
    options = {"port": "/dev/rs485", "baud": baud, "parity": parity}
    return Place("modbus_rtu", options, tuple(Found(unit, MODULE) for unit in units))


def can(interface: str, channel: str, bitrate: int) -> Place:
    options = {"interface": interface, "channel": channel, "bitrate": bitrate}
    return Place("canopen", options, (Found(5, NODE),))


def devices(text: str) -> list[tuple[str, int]]:
    return [(device.bus, device.unit) for device in parse(text, FILE).devices]


@pytest.mark.parametrize("speed", ["", "baud = 9600\n", 'parity = "N"\n'])
def test_unit_at_the_speed_of_the_file_joins_its_bus(speed: str) -> None:
    """What the file omits has its default."""
    text = merged(BEGUN + LINE + speed + UNIT_1, [rtu(9600, "N", 1, 2)], FILE)
    assert devices(text) == [("rtu1", 1), ("rtu1", 2)]
    assert "set it as" not in text


@pytest.mark.parametrize(("baud", "parity"), [(19200, "E"), (19200, "N"), (9600, "E")])
def test_unit_at_another_speed_than_the_file_s_bus_is_a_comment(baud: int, parity: str) -> None:
    text = merged(BEGUN + LINE + UNIT_1, [rtu(baud, parity, 2)], FILE)
    assert devices(text) == [("rtu1", 1)]
    told = f"# icpdas_m7015 at unit 2 answers as modbus_rtu /dev/rs485, {baud}, {parity}: "
    assert told + "set it as bus rtu1, which is modbus_rtu /dev/rs485, 9600, N\n" in text
    assert merged(text, [rtu(baud, parity, 2)], FILE) == text, "reported once"


@pytest.mark.parametrize("profile", ["icpdas_m7015", ""])
def test_whatever_a_device_calls_itself_adds_no_line(profile: str) -> None:
    name = 'M\n[compensation]\nmode = "compensate"\r\x00\x1b[2J\u2028'
    what = Recognition(profile, (0,), name, doubts=(name,))
    place = Place("modbus_rtu", {"port": "/dev/rs485"}, (Found(1, MODULE), Found(2, what, reads=name)))
    text = merged(BEGUN, [place], FILE)
    assert "[compensation]" in text
    assert "\n[compensation]" not in text
    assert all(line.isprintable() for line in text.splitlines())


@pytest.mark.parametrize("baud", [300, 600, 1200, 4_000_000])
def test_unit_found_at_any_speed_of_a_scan_is_accepted_by_the_configuration(baud: int) -> None:
    text = merged(BEGUN, [rtu(baud, "E", 1)], FILE)
    [bus] = parse(text, FILE).buses
    settings: object = bus
    assert isinstance(settings, ModbusRtuSettings)
    assert (settings.baud, settings.parity) == (baud, "E")


def test_units_at_the_speed_of_the_file_join_it_though_more_have_another() -> None:
    text = merged(BEGUN + LINE + UNIT_1, [rtu(19200, "N", 3, 4, 5), rtu(9600, "N", 2)], FILE)
    assert devices(text) == [("rtu1", 1), ("rtu1", 2)]
    assert [f"at unit {unit} answers as modbus_rtu /dev/rs485, 19200, N" in text for unit in (3, 4, 5)] == [True] * 3


def test_sensor_of_another_protocol_on_the_file_s_wire_is_a_comment() -> None:
    sensor = Recognition("me_rs485", (0,), "answers", {"range_um": 500.0})
    place = Place("me_rs485", {"port": "/dev/rs485", "baud": 230_400, "parity": "N"}, (Found(126, sensor),))
    text = merged(BEGUN + LINE + UNIT_1, [place], FILE)
    assert devices(text) == [("rtu1", 1)]
    assert "# me_rs485 at unit 126 answers as me_rs485 /dev/rs485, 230400, N: set it as bus rtu1" in text


@pytest.mark.parametrize(("interface", "channel", "joins"), [("slcan", "/dev/can", False), ("socketcan", "can0", True)])
def test_bit_rate_counts_where_the_file_sets_it(interface: str, channel: str, joins: bool) -> None:
    bus = f'[[bus]]\nname = "can1"\nkind = "canopen"\ninterface = "{interface}"\nchannel = "{channel}"\n'
    before = BEGUN + LINE + UNIT_1 + bus + "bitrate = 500000\n"
    text = merged(before, [can(interface, channel, 125_000)], FILE)
    assert devices(text) == [("rtu1", 1), *([("can1", 5)] if joins else [])]
    assert (f"answers as canopen {interface}, {channel}, 125000: set it as bus can1" in text) is not joins


def test_hosts_of_two_ports_are_two_buses() -> None:
    """The file's bus has the default port, which the file does not state."""
    before = BEGUN + '[[bus]]\nname = "tcp1"\nkind = "modbus_tcp"\nhost = "10.0.0.9"\n' + LINE + UNIT_1
    adam = Found(1, Recognition("advantech_adam6015", (0,), "type code"))
    for port, bus in ((502, "tcp1"), (5020, "tcp2")):
        text = merged(before, [Place("modbus_tcp", {"host": "10.0.0.9", "port": port}, (adam,))], FILE)
        assert devices(text) == [("rtu1", 1), (bus, 1)]


@pytest.mark.parametrize("url", ["rfc2217://moxa:4001", "socket://10.0.0.7:4001"])
def test_the_port_of_a_device_server_is_written_as_it_is(url: str) -> None:
    place = Place("modbus_rtu", {"port": url, "baud": 9600, "parity": "N"}, (Found(1, MODULE),))
    text = merged("", [place], FILE)
    (bus,) = parse(text, FILE).buses
    assert bus.place == url
    assert devices(merged(text, [place], FILE)) == devices(text), "and found again there"


def test_a_serial_port_begins_at_the_working_directory_whatever_kind_of_bus_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = [
        Place("modbus_rtu", {"port": "a"}, (Found(1, MODULE),)),
        Place("canopen", {"interface": "slcan", "channel": "c"}, (Found(5, NODE),)),
        Place("canopen", {"interface": "socketcan", "channel": "can0"}, (Found(5, NODE),)),
    ]
    text = merged(BEGUN, found, tmp_path / "else" / "gateway.toml")
    assert [line for line in text.splitlines() if line.startswith(("port", "channel"))] == [
        f'port = "{tmp_path}/a"', f'channel = "{tmp_path}/c"', 'channel = "can0"',
    ]  # fmt: skip
    assert [line for line in text.splitlines() if line.startswith("name")][1::2] == [
        'name = "rtu1"', 'name = "can1"', 'name = "can2"',
    ]  # fmt: skip


@pytest.mark.parametrize("unit", ["", "unit = 1\n", "unit = 7\n"])
def test_a_controller_without_an_address_is_added_once_and_without_one(unit: str) -> None:
    controller = Recognition("me_ethernet", (0,), "sends values", {"range_um": 500.0})
    place = Place("me_ethernet", {"host": "10.0.0.9", "port": 10001}, (Found(1, controller),))
    text = merged(BEGUN, [place], FILE)
    assert devices(text) == [("eddy1", 1)]
    assert "unit = " not in text
    known = text.replace("[device.options]", unit + "[device.options]")
    assert merged(known, [place], FILE) == known
