"""Where buses are: serial ports, whose relative path starts at the configuration's folder, CAN channels, and hosts."""

from pathlib import Path

import pytest

from drivers.recognition import Recognition
from gateway.commissioning.scan.found import Found, Place
from gateway.commissioning.scan.fragment import merged
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError
from gateway.config.wires import wires_toml

MODULE = Recognition("icpdas_m7015", (0,), "type code 0x20")
TEXT = """[machine]
name = "mill"
[[bus]]
name = "rtu1"
kind = "modbus_rtu"
port = "line"
[[bus]]
name = "growth1"
kind = "me_rs485"
port = "/dev/serial/by-id/growth"
[[bus]]
name = "can1"
kind = "canopen"
interface = "slcan"
channel = "adapters/can"
[[bus]]
name = "can2"
kind = "can"
channel = "can0"
[[device]]
name = "rtd1"
bus = "rtu1"
profile = "icpdas_m7015"
channels = { bed = 0 }
"""


def loaded(folder: Path, text: str = TEXT) -> GatewayConfig:
    (folder / "gateway.toml").write_text(text, encoding="utf-8")
    return load(folder / "gateway.toml")


@pytest.mark.parametrize("elsewhere", ["/", "."])
def test_ports_start_at_the_file_wherever_the_command_is_started(
    elsewhere: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(elsewhere)
    assert [bus.place for bus in loaded(tmp_path).buses] == [
        f"{tmp_path}/line",
        "/dev/serial/by-id/growth",
        f"slcan {tmp_path}/adapters/can",
        "socketcan can0",
    ]


@pytest.mark.parametrize(
    "url", ["rfc2217://10.0.0.9:4001", "socket://device-server.plant:4001", "rfc2217://[fe80::9]:1"]
)
@pytest.mark.parametrize("port", ["line", "/dev/serial/by-id/growth"])
def test_the_port_of_a_device_server_is_taken_as_it_is(port: str, url: str, tmp_path: Path) -> None:
    assert url in [bus.place for bus in loaded(tmp_path, TEXT.replace(f'"{port}"', f'"{url}"')).buses]


@pytest.mark.parametrize(
    "url",
    ["loop://", "spy:///dev/ttyUSB0", "rfc2217://10.0.0.9", "rfc2217://10.0.0.9:0", "socket://10.0.0.9:70000",
     "rfc2217://10.0.0.9:4001?logging=debug"],
)  # fmt: skip
@pytest.mark.parametrize("port", ["line", "/dev/serial/by-id/growth"])
def test_another_url_is_refused_with_what_is_possible(port: str, url: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, TEXT.replace(f'"{port}"', f'"{url}"'))
    (problem,) = caught.value.problems
    assert f"'{url}': expected the path of a serial port" in problem.what
    assert "rfc2217://HOST:PORT" in problem.what


def test_an_adapter_of_a_can_bus_is_on_this_computer(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="rfc2217:// cannot be opened for this bus"):
        loaded(tmp_path, TEXT.replace('"adapters/can"', '"rfc2217://10.0.0.9:4001"'))


def test_the_direction_of_a_device_servers_line_is_not_switched_from_here(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="rs485_rts: has no effect on a port of a device server"):
        loaded(tmp_path, TEXT.replace('port = "line"', 'port = "socket://10.0.0.9:4001"\nrs485_rts = "high"'))


def test_a_recording_that_is_played_asks_for_no_rts(tmp_path: Path) -> None:
    """A pseudo-terminal could not switch the direction."""
    config = loaded(tmp_path, TEXT.replace('port = "line"', 'port = "line"\nrs485_rts = "low"\nrs485_after_s = 0.01'))
    file = tmp_path / "played.toml"
    file.write_text(wires_toml(config, {"rtu1": {"rs485_rts": None, "rs485_after_s": None}}), encoding="utf-8")
    assert load(file).buses[0] == config.buses[0].model_copy(update={"rs485_rts": None, "rs485_after_s": 0.0})


def test_a_scan_writes_the_port_so_that_the_file_finds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The port was typed relative to the working directory; the file may be elsewhere."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    place = Place("modbus_rtu", {"port": "line", "baud": 9600, "parity": "N"}, (Found(1, MODULE),))
    beside = merged("", [place], Path("gateway.toml"))
    assert 'port = "line"' in beside
    above = merged("", [place], tmp_path / "gateway.toml")
    assert f'port = "{tmp_path}/here/line"' in above
    assert merged(above, [place], tmp_path / "gateway.toml") == above, "the same line, found again"
    assert loaded(tmp_path, above).buses[0].place == f"{tmp_path}/here/line"


@pytest.mark.parametrize("channel", ["/dev/ttyACM0", "socket://10.0.0.9:4001", "can 0", "a_name_of_16_chars", "can0:1"])
def test_a_channel_that_the_system_cannot_have_is_refused(channel: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected the system's name of a CAN interface, such as can0"):
        loaded(tmp_path, TEXT.replace('"can0"', f'"{channel}"'))


HOST = """
[[bus]]
name = "tcp1"
kind = "{}"
host = "{}"
port = 502
"""


@pytest.mark.parametrize("kind", ["modbus_tcp", "modbus_rtu_tcp", "me_ethernet"])
@pytest.mark.parametrize("host", ["http://10.0.0.9", "10.0.0.9:502", "adam.plant:502", "adam/1", "adam 1", "[fe80::9]",
                                  "192.168.0..30", "..", "." , "a" * 64 + ".plant"])  # fmt: skip
def test_a_host_with_protocol_or_port_is_refused(kind: str, host: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="without protocol; the port is a separate field"):
        loaded(tmp_path, TEXT + HOST.format(kind, host))


@pytest.mark.parametrize("host", ["10.0.0.9", "adam", "adam-6015.plant", "fe80::9", "fe80::9%eth0", "prüfstand", "a_1"])
def test_names_and_addresses_of_hosts_are_taken(host: str, tmp_path: Path) -> None:
    in_a_url = f"[{host}]" if ":" in host else host
    assert loaded(tmp_path, TEXT + HOST.format("modbus_tcp", host)).buses[-1].place == f"{in_a_url}:502"


@pytest.mark.parametrize(
    ("given", "nul"),
    [
        ('port = "line"', 'port = "li\\u0000ne"'),
        ('profile = "icpdas_m7015"', 'profile = "./x\\u0000y.toml"'),
        ("[machine]", '[storage]\npath = "x\\u0000y"\n[machine]'),
    ],
)
def test_a_path_with_a_null_character_is_refused(given: str, nul: str, tmp_path: Path) -> None:
    assert TEXT.count(given) == 1
    with pytest.raises(ConfigError, match="no path contains a null character"):
        loaded(tmp_path, TEXT.replace(given, nul))
