"""Scanning a serial line: which units there are, at which speed, without disturbing any other program."""

import asyncio
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.modbus.settings import ModbusRtuSettings
from gateway.commissioning.scan.found import Found, ScanReport
from gateway.commissioning.scan.fragment import merged
from gateway.commissioning.scan.serial import SerialScan, plan, scan_line
from gateway.config.file import load
from simulators.devices import M7015, MeSensor, RtuLine
from simulators.devices.modbus_servers import crc16
from simulators.devices.modbus_unit import ModbusUnit, answer
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.pty_port import PtyPort
from simulators.devices.source import SensorFault
from simulators.devices.voltage_input import VoltageInput
from tests.benches.buggy_library import BuggyDecoder
from tests.benches.command import beside, here, talc_gateway
from tests.benches.started import started

TIMEOUT_S = 0.2
SIX = [20.04, 21.26, -3.3, 40.0, 99.96, 22.22]
EIGHT = [*SIX, 0.0, 94.96]


def quiet(_done: int, _text: str) -> None:
    """Nobody watches."""


def line_plan(
    port: str, *, bauds: Sequence[int] = (9600,), units: Sequence[int] = (1, 2, 3), me: bool = False
) -> SerialScan:
    return plan(
        port,
        bauds=bauds,
        parities=("N",),
        units=units,
        me_bauds=(230_400,),
        me_addresses=(126,) if me else (),
        timeout_s=TIMEOUT_S,
    )


def line(units: dict[int, ModbusUnit], baud: int = 0) -> AbstractAsyncContextManager[str]:
    return started(RtuLine(units, baud=baud))


async def scan(what: SerialScan) -> ScanReport:
    return await scan_line(what, quiet, lambda: False)


def by_unit(report: ScanReport) -> dict[int, Found]:
    return {device.unit: device for device in report.found}


@pytest.mark.simulated_time
async def test_slow_module_can_be_written_to_a_configuration_that_loads(tmp_path: Path) -> None:
    """600 baud is slower than what a configuration once accepted."""
    async with line({1: M7015(lambda: SIX)}, baud=600) as path:
        report = await scan(line_plan(path, bauds=(1200, 600), units=(1,)))
    file = tmp_path / "gateway.toml"
    file.write_text(merged("", report.places, file), encoding="utf-8")
    (bus,) = load(file).buses
    settings: object = bus
    assert isinstance(settings, ModbusRtuSettings)
    assert (settings.baud, settings.place) == (600, path)


@pytest.mark.simulated_time
async def test_known_modules_are_recognised_and_others_called_unknown() -> None:
    broken = M7015(lambda: SIX)
    broken.faults.set(2, SensorFault.OPEN)
    voltage = VoltageInput(lambda: [100.0] * 8, range_um=500.0)
    async with line({1: broken, 2: Pta8d08(lambda: EIGHT), 3: voltage}) as path:
        found = by_unit(await scan(line_plan(path, units=(1, 2, 3, 4))))
    assert {unit: device.what.profile for unit, device in found.items()} == {
        1: "icpdas_m7015",
        2: "eletechsup_pta8d08",
        3: "",
    }
    assert found[1].what.inputs == tuple(range(6))
    assert found[1].reads == "20.00 21.30 sensor_fault 40.00 100.00 22.20 degC"
    assert found[2].reads == "20.00 21.30 -3.30 40.00 out_of_range 22.20 0.00 95.00 degC"


@pytest.mark.simulated_time
async def test_input_set_to_another_type_is_left_out_and_reported() -> None:
    module = M7015(lambda: SIX)
    module.set_type_code(3, 0x05)  # a voltage
    async with line({1: module}) as path:
        (device,) = (await scan(line_plan(path, units=(1,)))).found
    assert device.what.inputs == (0, 1, 2, 4, 5)
    assert device.what.doubts == ("input 3 has type code 0x0005, which the profile cannot read",)


@pytest.mark.simulated_time
async def test_module_in_another_data_format_is_reported() -> None:
    module = M7015(lambda: SIX)
    module.engineering = False
    async with line({1: module}) as path:
        (device,) = (await scan(line_plan(path, units=(1,)))).found
    assert device.what.profile == "icpdas_m7015"
    assert device.what.doubts == (
        "data format (coil 00269) is 0: set the module to engineering format, 1; 0 is hexadecimal",
    )
    assert device.reads.startswith("WrongDevice: data format (coil 00269) is 0")


@pytest.mark.simulated_time
@pytest.mark.parametrize(
    ("off", "profile"), [(2, "eletechsup_pta8d08"), (-2, "eletechsup_pta8d08"), (4, ""), (-4, ""), (200, "")]
)
async def test_a_unit_is_a_pta8d08_if_its_resistances_agree_within_three_tenths_of_an_ohm(
    off: int, profile: str
) -> None:
    class Meter(Pta8d08):
        def memory(self, function: int) -> dict[int, int]:
            held = dict(super().memory(function))
            return {**held, 34: held[34] + off} if function == 3 else held

    async with line({1: Meter(lambda: EIGHT)}) as path:
        (device,) = (await scan(line_plan(path, units=(1,)))).found
    assert device.what.profile == profile


@pytest.mark.simulated_time
async def test_speed_at_which_the_line_talks_is_found() -> None:
    async with line({2: M7015(lambda: SIX)}, baud=38400) as path:
        report = await scan(line_plan(path, bauds=(9600, 38400, 115200)))
    (place,) = report.places
    assert place.options == {"port": path, "baud": 38400, "parity": "N"}
    assert [device.unit for device in place.devices] == [2]
    assert report.asked == report.total == 9


@pytest.mark.simulated_time
async def test_a_device_without_a_speed_is_found_once() -> None:
    async with line({2: M7015(lambda: SIX)}) as path:
        report = await scan(line_plan(path, bauds=(9600, 38400, 115200), me=True))
    (place,) = report.places
    assert place.options["baud"] == 9600
    assert [device.unit for device in place.devices] == [2]
    assert "3 speeds" in report.remarks[-1]


@pytest.mark.simulated_time
@pytest.mark.parametrize(("payload", "profile"), [("float", "me_rs485"), ("counted", "me_dt6120")])
async def test_displacement_sensor_is_recognised_by_its_answer(payload: str, profile: str) -> None:
    sensor = MeSensor(lambda: [123.4], range_um=500.0, payload="counted" if payload == "counted" else "float")
    async with started(sensor) as path:
        report = await scan(line_plan(path, me=True))
    (device,) = report.found
    assert (device.what.profile, device.unit, device.reads) == (profile, 126, "123.40 µm")
    assert report.places[0].options["baud"] == 230_400


@pytest.mark.simulated_time
async def test_answers_that_collide_are_reported_and_are_not_a_device() -> None:
    """Two units with one id: their bits mix, here by AND as on an RS-485 pair pulled down by both."""
    wire = RtuLine({1: M7015(lambda: SIX)})
    wire.spoil = lambda _, frame: [(0.0, bytes(a & b for a, b in zip(frame, frame[1:] + b"\x12", strict=True)))]
    async with started(wire) as path:
        report = await scan(line_plan(path, units=(1,)))
    assert report.found == []
    assert "two units with one id" in report.remarks[0]


@pytest.mark.simulated_time
async def test_speed_that_the_port_cannot_do_is_a_remark_and_the_rest_goes_on() -> None:
    """Pseudo-terminals have no parity, and say so when nothing but the parity changes."""
    async with line({1: M7015(lambda: SIX)}) as path:
        both = plan(
            path, bauds=(9600,), parities=("N", "E"), units=(1,), me_bauds=(), me_addresses=(), timeout_s=TIMEOUT_S
        )
        report = await scan(both)
    assert [device.unit for device in report.found] == [1]
    assert report.remarks[0].startswith("9600 8E1 could not be tried: cannot open serial port")


@pytest.mark.simulated_time
async def test_unit_that_knows_one_function_only_is_found_with_it() -> None:
    """It does not answer another function at all, contrary to the standard."""
    unit = VoltageInput(lambda: [100.0] * 8, range_um=500.0)

    def heard(request: bytes) -> None:
        if request[:2] == b"\x01\x04":
            reply = request[:1] + answer(unit, request[1:-2])
            port.write(reply + crc16(reply))

    port = PtyPort(heard)
    async with started(port) as path:
        plain = line_plan(path, units=(1,))
        assert (await scan(plain)).found == []
        (device,) = (await scan(replace(plain, function=4))).found
    assert (device.unit, device.what.profile) == (1, "")


@pytest.mark.simulated_time
async def test_only_reading_is_ever_asked() -> None:
    requests: list[bytes] = []
    units: dict[int, ModbusUnit] = {1: M7015(lambda: SIX), 2: VoltageInput(lambda: [1.0] * 8, range_um=500.0)}

    def heard(request: bytes) -> None:
        requests.append(request)
        if (unit := units.get(request[0])) is not None:
            reply = request[:1] + answer(unit, request[1:-2])
            port.write(reply + crc16(reply))

    port = PtyPort(heard)
    async with started(port) as path:
        await scan(line_plan(path, units=(1, 2, 3)))
    assert len(requests) > 6
    assert all(crc16(request[:-2]) == request[-2:] for request in requests)
    assert {request[1] for request in requests} <= {1, 2, 3, 4}


@pytest.mark.simulated_time
async def test_stopping_waits_for_the_request_under_way() -> None:
    """A stopped scan leaves no unit answering into another program's request."""
    asked = asyncio.Event()
    requests: list[bytes] = []

    def heard(data: bytes) -> None:
        requests.append(data)
        asked.set()

    async with started(PtyPort(heard)) as path:
        running = asyncio.create_task(scan_line(line_plan(path, units=range(1, 200)), quiet, asked.is_set))
        await asked.wait()
        report = await running
    assert report.asked == len(requests) == 1


@pytest.mark.simulated_time
def test_command_writes_a_configuration_that_validates(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with beside(line({1: M7015(lambda: SIX), 7: Pta8d08(lambda: EIGHT)}, baud=9600)) as path:
        where = ("scan", "serial", path, "--units", "1,7", "--baud", "9600", "--protocol", "modbus_rtu")
        arguments = (*where, "--timeout", "5", "--toml", str(file))  # of a busy computer; the units answer sooner
        done = here(*arguments)
        assert done.code == 0, done.err
        again = here(*arguments)
        probed = here("probe", str(file))
    assert "2 requests (modbus_rtu at 9600 8N1); at most 10 s if nothing answers" in done.err
    assert "2 answered, 2 recognised" in done.out
    config = load(file)
    assert [(d.unit, d.profile, len(d.channels)) for d in config.devices] == [
        (1, "icpdas_m7015", 6),
        (7, "eletechsup_pta8d08", 8),
    ]
    assert "already contains everything" in again.err
    assert (probed.code, probed.out.splitlines()[-1]) == (3, "13 of 14 good")  # unit 7: 99.96 degC is not plausible


def test_file_that_exists_is_added_to_only_after_a_yes(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(
        '[machine]\nname = "mill"\n\n[[bus]]\nname = "tcp1"\nkind = "modbus_tcp"\nhost = "10.0.0.9"\n\n'
        '[[device]]\nname = "rtd1"\nbus = "tcp1"\nprofile = "advantech_adam6015"\n[device.channels]\nbed = 0\n',
        encoding="utf-8",
    )
    before = file.read_text(encoding="utf-8")
    with beside(line({1: M7015(lambda: SIX)})) as path:
        where = ("scan", "serial", path, "--units", "1", "--baud", "9600", "--protocol", "modbus_rtu")
        arguments = (*where, "--timeout", "5")  # of a busy computer; the unit answers sooner
        for answer in ("n\n", ""):  # "": the input has ended
            refused = here(*arguments, "--toml", str(file), answer=answer)
            assert file.read_text(encoding="utf-8") == before
            assert refused.code == 0
            assert f"{file} stays as it is. A configuration of what was found:" in refused.err
            assert f'[[bus]]\nname = "rtu1"\nkind = "modbus_rtu"\nport = "{path}"' in refused.out, "nothing is lost"
        here(*arguments, "--toml", str(file), answer="y\n")
    assert file.read_text(encoding="utf-8").startswith(before)
    config = load(file)
    assert [device.name for device in config.devices] == ["rtd1", "rtd2"]
    assert config.machine.name == "mill"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b'[machine]\nname = "mill\n', "is not valid TOML: Illegal character '\\n' (at line 2, column 13)"),
        (b'[machine]\nname = "M\xfchle"\n', "is not UTF-8 text: byte 19 is 0xfc"),
        (b'[machine]\nnames = "mill"\n', "[machine] name: missing; is 'names' meant to be it?"),
        (
            b'[machine]\nname = "mill"\n[[device]]\nname = "a"\nbus = "x"\nprofile = "icpdas_m7015"\n'
            b"[device.channels]\nbed = 0\n",
            "unknown bus 'x'",
        ),
    ],
)
def test_file_that_cannot_be_added_to_is_reported_before_the_scan(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "gateway.toml"
    file.write_bytes(content)
    done = here("scan", "serial", "/dev/does-not-exist", "--toml", str(file))
    assert done.code == 2, done.err
    assert f"error: {file}: " in done.err
    assert said in done.err
    assert "nothing was scanned: correct this file, or give another one with --toml" in done.err
    assert file.read_bytes() == content


@pytest.mark.slow
async def test_ctrl_c_shows_what_was_found_and_frees_the_port(tmp_path: Path) -> None:
    answered = asyncio.Event()

    class Noted(M7015):
        def memory(self, function: int) -> dict[int, int]:
            if function == 2:  # the last of what is read when it is looked at
                answered.set()
            return dict(super().memory(function))

    async with line({1: Noted(lambda: SIX)}) as path:
        done = await talc_gateway(
            "scan", "serial", path, "--units", "1-247", "--timeout", "1", "--baud", "9600", interrupt=answered.wait
        )
        assert (await scan(line_plan(path, units=(1,)))).found  # the port is free, the line is quiet
    assert done.code == 0
    assert "icpdas_m7015" in done.out
    assert "interrupted: " in done.out


def test_limit_ends_a_scan_that_would_last_for_hours() -> None:
    with beside(line({})) as path:
        done = here("scan", "serial", path, "--units", "1-247", "--timeout", "2", "--limit", "1")
    assert "it will be stopped after 1 s" in done.err
    assert "stopped after 1 s: 1 of 1239 asked" in done.out
    assert done.code == 3


@pytest.mark.parametrize(
    ("units", "says"),
    [
        ("0", "'0': expected 1 to 247"),
        ("1-248", "'1-248': expected 1 to 247"),
        ("a", "'a': expected numbers such as 1-8,12"),
        ("", "'': expected numbers such as 1-8,12"),
        ("1,5-3", "'1,5-3': expected the smaller number first, 3-5"),
    ],
)
def test_invalid_units_are_refused(units: str, says: str) -> None:
    done = here("scan", "serial", "/dev/null", "--units", units)
    assert done.code == 2
    assert says in " ".join(done.err.split())


@pytest.mark.parametrize("port", ["", ".", "rfc2217://moxa:4001"])
def test_a_port_that_no_scan_can_open_is_refused_by_name(port: str) -> None:
    done = here("scan", "serial", port, columns=200)
    assert (done.code, repr(port) in done.err) == (2, True), done.err


@pytest.mark.parametrize("path", ["/dev/null", "/etc/passwd", "/tmp"])
@pytest.mark.parametrize("what", [("serial",), ("can", "--interface", "slcan", "--bitrate", "125000")])
def test_a_file_that_is_not_a_serial_port_is_reported(what: tuple[str, ...], path: str) -> None:
    done = here("scan", what[0], path, *what[1:])
    assert (done.code, f"{path}: " in done.err) == (3, True), done.err


@pytest.mark.simulated_time
async def test_a_bug_in_the_library_is_a_remark_and_the_scan_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    bug = BuggyDecoder(monkeypatch, failures=1)
    async with line({1: M7015(lambda: SIX), 2: M7015(lambda: SIX)}) as path:
        report = await scan(line_plan(path))
    assert bug.failures == 0
    assert list(by_unit(report)) == [2]
    (remark,) = report.remarks
    assert "unexpected KeyError in the request to unit 1: 'no such key' (please report it" in remark
