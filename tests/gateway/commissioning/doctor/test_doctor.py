"""`doctor` on a computer whose files say what is wrong."""

import os
import pwd
import tempfile
from dataclasses import replace
from pathlib import Path
from shutil import chown

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.commissioning.doctor.credential_files import unread_files
from gateway.commissioning.doctor.health import health_findings, show
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.events import EventReported, FrameMade, MeasurementEnded
from gateway.model.notice import Notice
from gateway.model.text import Text, texts
from gateway.model.wording import problem_event
from gateway.storage.store import Store
from talc.frame import Frame
from tests.benches.plant_authority import DAY, PlantAuthority
from tests.benches.stepped_clock import SteppedClock
from tests.benches.telemetry_examples import OUTCOME

TEXT = """
[machine]
name = "mill"
[storage]
warn_free_mb = 0.0
[[bus]]
name = "rtu1"
kind = "modbus_rtu"
port = "line"
[[bus]]
name = "can1"
kind = "canopen"
channel = "can0"
[[device]]
name = "rtd1"
bus = "rtu1"
profile = "icpdas_m7015"
channels = { bed = 0, column = 1, room = 2 }
"""
THROTTLED = "sys/devices/platform/soc/soc:firmware/get_throttled"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A computer on which all is well."""
    root = tmp_path / "root"
    write(root / THROTTLED, "0x0")
    write(root / "sys/class/net/can0/operstate", "up")
    return root


@pytest.fixture
def config(tmp_path: Path) -> GatewayConfig:
    write(tmp_path / "gateway.toml", TEXT)
    return load(tmp_path / "gateway.toml")


def write(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")


def found(config: GatewayConfig, root: Path, *, synchronised: bool = True) -> list[str]:
    """What is wrong; each says why and what to do."""
    all_of_it = list(health_findings(config, root, synchronised=synchronised))
    assert all(finding.why and finding.remedy for finding in all_of_it)
    return [finding.what for finding in all_of_it]


def test_nothing_is_found_where_nothing_is_wrong(config: GatewayConfig, root: Path) -> None:
    assert found(config, root) == []


def test_a_clock_that_nobody_synchronises_is_found(config: GatewayConfig, root: Path) -> None:
    assert found(config, root, synchronised=False) == ["the clock is not synchronised: no time service has set it"]


def vcgencmd(root: Path, script: str) -> None:
    """The firmware's own command, as a shell script."""
    write(root / "usr/bin/vcgencmd", f"#!/bin/sh\n{script}\n")
    (root / "usr/bin/vcgencmd").chmod(0o755)


def test_a_supply_that_is_too_weak_is_found(config: GatewayConfig, root: Path) -> None:
    vcgencmd(root, '[ "$*" = get_throttled ] && echo throttled=0x50001')
    assert found(config, root) == [
        "the supply voltage is now too low",
        "the supply voltage was, since the start, too low",
        "the processor was, since the start, throttled",
    ]


@pytest.mark.parametrize(
    "script", ["echo VCHI initialization failed; exit 255", "echo throttled=?", "echo volt=0x1", "kill -9 $$"]
)
def test_without_the_firmwares_command_the_kernel_knows_the_last_seconds_only(
    script: str, config: GatewayConfig, root: Path
) -> None:
    vcgencmd(root, script)
    write(root / THROTTLED, "50001")
    assert found(config, root) == [
        Text(NoticeCode.SUPPLY_LOW, moment="now").about("text", "en"),
        Text(NoticeCode.SUPPLY_LOW, moment="lately").about("text", "en"),
        Text(NoticeCode.PROCESSOR_SLOW, moment="lately", how="throttled").about("text", "en"),
    ]


@pytest.mark.parametrize(
    ("name", "alarm", "seen"), [("rpi_volt", "1", True), ("rpi_volt", "0", False), ("a", "1", False)]
)
def test_a_kernel_that_has_only_a_sensor_of_the_supply_is_asked(
    name: str, alarm: str, seen: bool, config: GatewayConfig, root: Path
) -> None:
    (root / THROTTLED).unlink()
    write(root / "sys/class/hwmon/hwmon1/name", name)
    write(root / "sys/class/hwmon/hwmon1/in0_lcrit_alarm", f"{alarm}\n")
    assert found(config, root) == [Text(NoticeCode.SUPPLY_LOW, moment="now").about("text", "en")] * seen


@pytest.mark.parametrize(
    ("bits", "whats"),
    [
        ("0x2", ["the processor is now slowed down"]),
        ("0x4", ["the processor is now throttled"]),
        ("0x8", ["the processor is now slowed down, as it is hot"]),
        ("0x20000", ["the processor was in the last seconds slowed down"]),
        ("0x80000\n", ["the processor was in the last seconds slowed down, as it is hot"]),
        ("e0006", [
            "the processor is now slowed down", "the processor is now throttled",
            "the processor was in the last seconds slowed down", "the processor was in the last seconds throttled",
            "the processor was in the last seconds slowed down, as it is hot",
        ]),
        ("", []),
        ("?", []),
    ],
)  # fmt: skip
def test_a_processor_that_is_or_was_slowed_down_is_found(
    bits: str, whats: list[str], config: GatewayConfig, root: Path
) -> None:
    write(root / THROTTLED, bits)
    assert found(config, root) == whats
    assert all("cool the computer" in one.remedy for one in health_findings(config, root, synchronised=True))


def test_a_computer_that_names_its_firmware_by_address_is_asked_too(config: GatewayConfig, root: Path) -> None:
    (root / THROTTLED).unlink()
    write(root / "sys/devices/platform/soc@107c000000/soc@107c000000:firmware/get_throttled", "0x1")
    assert found(config, root) == [Text(NoticeCode.SUPPLY_LOW, moment="now").about("text", "en")]


def test_a_can_interface_that_is_down_or_absent_is_found(config: GatewayConfig, root: Path) -> None:
    write(root / "sys/class/net/can0/operstate", "down\n")
    assert found(config, root) == ["can0 is down"]
    write(root / "sys/class/net/can0/flags", "0x40080\n")
    assert found(config, root) == ["can0 is down"]
    write(root / "sys/class/net/can0/flags", "0x40081\n")
    assert found(config, root) == ["can0 is up and has left the bus (bus-off), or has no carrier"]
    (root / "sys/class/net/can0/operstate").unlink()
    assert found(config, root) == ["there is no interface can0"]


def test_a_disk_that_is_nearly_full_is_found(config: GatewayConfig, root: Path) -> None:
    storage = config.storage.model_copy(update={"warn_free_mb": 1e12})
    (what,) = found(config.model_copy(update={"storage": storage}), root)
    assert "MB are free on the disk of" in what


def test_a_folder_for_the_database_that_is_not_there_is_found(
    config: GatewayConfig, root: Path, tmp_path: Path
) -> None:
    storage = config.storage.model_copy(update={"path": tmp_path / "data" / "gateway.sqlite"})
    assert found(config.model_copy(update={"storage": storage}), root) == [f"{tmp_path}/data does not exist"]


def test_a_second_program_on_a_serial_line_is_found(config: GatewayConfig, root: Path, tmp_path: Path) -> None:
    for process in ("17", "23"):
        (root / "proc" / process / "fd").mkdir(parents=True)
        (root / "proc" / process / "fd" / "5").symlink_to(tmp_path / "line")
    write(root / "proc/17/comm", "ein Prüfer\n")
    write(root / "proc/23/comm", "minicom\n")
    assert found(config, root) == [f"bus 'rtu1': {tmp_path}/line is open in 2 processes: 17, 23 (minicom)"]


def test_a_user_who_does_not_see_other_users_programs_is_told_so(
    config: GatewayConfig, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    without = config.model_copy(update={"buses": [bus for bus in config.buses if bus.name != "rtu1"]})
    for each, sees_all, told in ((config, True, False), (config, False, True), (without, False, False)):
        show(each, root, sees_all=sees_all)
        assert (texts("en")["doctor.unseen"] in capsys.readouterr().out) is told


@pytest.mark.parametrize(
    ("serial", "product", "shared"), [(False, "7523", True), (True, "7523", False), (False, "6001", False)]
)
def test_a_name_that_two_adapters_have_is_found(
    serial: bool, product: str, shared: bool, root: Path, tmp_path: Path
) -> None:
    """Two adapters: of one kind, without and with serial numbers, and of two kinds."""
    for name, of in (("ttyUSB0", "7523"), ("ttyUSB1", product)):
        write(root / "dev" / name, "")
        usb = root / "sys/devices" / f"of {name}"
        write(usb / "idVendor", "1a86\n")
        write(usb / "idProduct", f"{of}\n")
        if serial:
            write(usb / "serial", name)
        (usb / "interface").mkdir()
        link(root / "sys/class/tty" / name / "device", str(usb / "interface"))
        link(root / "dev/serial/by-path" / f"socket {name}", f"../../{name}")
    link(root / "dev/serial/by-id/ch340", "../../ttyUSB0")
    write(tmp_path / "gateway.toml", TEXT.replace('port = "line"', 'port = "/dev/serial/by-id/ch340"'))
    (*found_texts,) = found(load(tmp_path / "gateway.toml"), root)
    assert bool(found_texts) is shared


def link(file: Path, target: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.symlink_to(target)


@pytest.mark.parametrize(("other", "seen"), [("/dev/ptmx", False), ("/dev/null", True)])
def test_a_program_that_plays_the_devices_of_a_line_is_not_a_second_program(
    other: str, seen: bool, config: GatewayConfig, root: Path, tmp_path: Path
) -> None:
    (tmp_path / "line").symlink_to("/dev/pts/4711")
    for process, opened in (("17", ("/dev/pts/4711",)), ("23", ("/dev/pts/4711", other))):
        (root / "proc" / process / "fd").mkdir(parents=True)
        for number, target in enumerate(opened):
            (root / "proc" / process / "fd" / str(number)).symlink_to(target)
    assert len(found(config, root)) == seen


@pytest.mark.parametrize(
    "fields", ['kind = "me_rs485"\nport = "line2"', 'kind = "canopen"\ninterface = "slcan"\nchannel = "line2"']
)
def test_a_second_program_on_a_line_of_another_kind_is_found(fields: str, tmp_path: Path, root: Path) -> None:
    write(tmp_path / "gateway.toml", f'{TEXT}\n[[bus]]\nname = "other"\n{fields}\n')
    config = load(tmp_path / "gateway.toml")
    assert found(config, root) == []
    for process in ("17", "23"):
        (root / "proc" / process / "fd").mkdir(parents=True)
        (root / "proc" / process / "fd" / "5").symlink_to(tmp_path / "line2")
    assert found(config, root) == [f"bus 'other': {tmp_path}/line2 is open in 2 processes: 17, 23"]


def test_a_certificate_of_the_telemetry_that_has_expired_is_found(tmp_path: Path, root: Path) -> None:
    certificate, key = PlantAuthority(tmp_path / "plant").issue("mill", -DAY)
    tls = f'[telemetry.tls]\ncertificate = "{certificate}"\nkey = "{key}"\n'
    write(tmp_path / "gateway.toml", TEXT + tls)
    (what,) = found(load(tmp_path / "gateway.toml"), root)
    assert f"[telemetry.tls] certificate: '{certificate}' has expired on" in what


@pytest.mark.parametrize(("days", "soon"), [(10, True), (29, True), (31, False)])
def test_a_certificate_of_the_telemetry_that_ends_soon_is_found(
    days: int, soon: bool, tmp_path: Path, root: Path
) -> None:
    certificate, key = PlantAuthority(tmp_path / "plant").issue("mill", days * DAY)
    tls = f'[telemetry.tls]\ncertificate = "{certificate}"\nkey = "{key}"\n'
    write(tmp_path / "gateway.toml", TEXT + tls)
    whats = found(load(tmp_path / "gateway.toml"), root)
    assert len(whats) == soon
    assert all(f"[telemetry.tls] certificate: '{certificate}' expires on 20" in what for what in whats)


def test_an_authority_of_the_telemetry_that_ends_soon_is_found(tmp_path: Path, root: Path) -> None:
    ending, _ = PlantAuthority(tmp_path / "plant").issue("authority2", 10 * DAY)
    write(tmp_path / "gateway.toml", TEXT + f'[telemetry.tls]\nauthority = "{ending}"\n')
    (what,) = found(load(tmp_path / "gateway.toml"), root)
    assert f"[telemetry.tls] authority: '{ending}'" in what


@pytest.mark.parametrize(
    ("section", "field", "name", "why", "page"),
    [
        ('[nc]\nkind = "linuxcnc"\nkey_file = "talc.key"', "[nc] key_file", "talc.key",
         "without it the gateway cannot connect to the control", "docs/agent.md"),
        ('[telemetry]\nuser = "u"\npassword_file = "word"\nconnect = ["tcp/127.0.0.1:7447"]',
         "[telemetry] password_file", "word",
         "without it no other computer receives anything from the gateway", "docs/site.md"),
        ('[[telemetry.operator]]\nname = "anna"\nkey_file = "anna.key"\nmay = ["pause"]',
         "[[telemetry.operator]] 'anna', key_file", "anna.key",
         "without it every command of 'anna' is refused", "docs/commands.md"),
        ('[[bus]]\nname = "cell"\nkind = "mqtt"\nurl = "mqtts://broker"\npassword_file = "word"\nuser = "u"',
         "bus 'cell', password_file", "word", "without it bus 'cell' cannot be read", "docs/devices.md"),
    ],
    ids=["control", "telemetry", "operator", "bus"],
)  # fmt: skip
def test_for_a_missing_key_it_names_the_file_the_setting_and_what_to_do(
    section: str, field: str, name: str, why: str, page: str, tmp_path: Path, root: Path
) -> None:
    write(tmp_path / "gateway.toml", f"{TEXT}{section}\n")
    (ailment,) = health_findings(load(tmp_path / "gateway.toml"), root, synchronised=True)
    assert ailment.what == f"{field}: '{tmp_path / name}' does not exist"
    assert ailment.why == why
    assert ailment.remedy == (
        f"make the file ({page}) or copy it there, readable only by the gateway's user (chmod 600), or change"
        f" {field.split()[-1]} in the configuration"
    )


@pytest.mark.peer
def test_root_asks_for_the_user_who_owns_the_database(root: Path) -> None:
    """A key that root made, as docs/install-pi.md shows, must belong to the service's user."""
    assert os.geteuid() == 0, "only root can ask for another user"
    with tempfile.TemporaryDirectory() as name:  # pytest's own folder is closed to all others
        folder, service = Path(name), pwd.getpwnam("nobody")
        folder.chmod(0o755)
        write(folder / "data" / "gateway.sqlite", "")
        chown(folder / "data" / "gateway.sqlite", service.pw_uid)
        write(folder / "talc.key", "k" * 32)
        (folder / "talc.key").chmod(0o600)
        store = '[nc]\nkind = "linuxcnc"\nkey_file = "talc.key"'
        write(
            folder / "gateway.toml", TEXT.replace("warn_free_mb", 'path = "data/gateway.sqlite"\nwarn_free_mb') + store
        )
        config = load(folder / "gateway.toml")
        config = config.model_copy(update={"storage": config.storage.model_copy(update={"path": folder / "absent"})})
        assert [one.what for one in health_findings(config, root, synchronised=True)] == [], "the folder is root's own"
        config = load(folder / "gateway.toml")
        (ailment,) = unread_files(config).values()
        chown(folder / "talc.key", service.pw_uid)
        assert not unread_files(config)
    assert ailment == (
        f"[nc] key_file: '{folder}/talc.key' cannot be read: not by nobody, the user who owns the database"
    )
    assert ailment.about("remedy", "en").startswith(f"chown nobody {folder}/talc.key")


def test_if_no_key_opens_a_certificate_it_says_only_what_cannot_be_read(tmp_path: Path, root: Path) -> None:
    (tmp_path / "gw.key").mkdir()
    certificate, _ = PlantAuthority(tmp_path / "plant").issue("mill")
    write(tmp_path / "gateway.toml", f'{TEXT}[telemetry.tls]\ncertificate = "{certificate}"\nkey = "gw.key"\n')
    (ailment,) = health_findings(load(tmp_path / "gateway.toml"), root, synchronised=True)
    assert f"[telemetry.tls] key: '{tmp_path}/gw.key'" in ailment.what


def test_two_names_that_were_the_same_all_day_are_found_and_neighbours_are_not(
    config: GatewayConfig, root: Path
) -> None:
    day = 20.0 + 3.0 * np.sin(np.arange(288) / 288 * 2 * np.pi)
    with Store(config.storage.path, "boot-1", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "", None)
        for k, value in enumerate(day):
            store.record(FrameMade(Frame(k, np.array([value, value + 0.001, value + 0.5]), np.full(3, True))))
        store.flush()
    assert found(config, root) == ["bed and column were the same all day"]


@pytest.mark.parametrize(("step_s", "steps", "a_day"), [(900.0, 96, True), (300.0, 96, False), (10.0, 288, False)])
def test_all_day_is_a_day_at_any_grid_step(
    step_s: float, steps: int, a_day: bool, config: GatewayConfig, root: Path
) -> None:
    config = config.model_copy(update={"grid": config.grid.model_copy(update={"step_s": step_s})})
    with Store(config.storage.path, "boot-1", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "", None)
        for k, value in enumerate(np.linspace(20.0, 23.0, steps)):
            store.record(FrameMade(Frame(k, np.array([value, value, value + 0.5]), np.full(3, True))))
        store.flush()
    assert found(config, root) == (["bed and column were the same all day"] if a_day else [])


@pytest.mark.parametrize(("last_um", "grown"), [(0.8, []), (2.5, ["grew from 0.5 to 2.5 µm"])])
def test_probing_that_scatters_more_than_at_first_is_found(
    last_um: float, grown: list[str], config: GatewayConfig, root: Path
) -> None:
    with Store(config.storage.path, "boot-1", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "", None)
        for number in range(30):
            residual_um = 0.5 if number < 20 else last_um
            store.record(MeasurementEnded(replace(OUTCOME, number=number, residual_um=residual_um)))
        store.flush()
    whats = found(config, root)
    assert len(whats) == len(grown)
    assert all(part in what for part, what in zip(grown, whats, strict=True))


@pytest.mark.parametrize("ended", [False, True])
def test_another_master_that_the_gateway_hears_is_found(ended: bool, config: GatewayConfig, root: Path) -> None:
    heard = Text(NoticeCode.OTHER_MASTER, bus="rtu1", evidence="3 frames in the last minute are not ours")
    notices = [Notice("line of bus rtu1", heard)]
    if ended:
        notices.append(Notice("line of bus rtu1", Text(NoticeCode.NO_OTHER_MASTER, bus="rtu1"), ended=True))
    with Store(config.storage.path, "boot-1", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "", None)
        for notice in notices:
            store.record(EventReported(problem_event(notice), None))
        store.flush()
    assert found(config, root) == ([] if ended else [heard])


def test_the_command_says_what_is_found_on_this_computer(config: GatewayConfig, tmp_path: Path) -> None:
    answer = CliRunner().invoke(main, ["doctor", str(tmp_path / "gateway.toml")], catch_exceptions=False)
    here = list(health_findings(config, Path("/"), synchronised=True))
    assert answer.exit_code == (3 if here else 0)
    said = " ".join(answer.output.split())
    for finding in here:
        assert " ".join(finding.what.split()) in said
        assert " ".join(finding.remedy.split()) in said
