"""What a bus of another package says of itself, and what the gateway takes it for when it says nothing."""

import re
from pathlib import Path

import pytest

from gateway.acquisition.wire_log import not_recorded
from gateway.commissioning.doctor.health import health_findings
from gateway.config.file import parse
from gateway.config.rules import cautions
from tests.benches.command import Done, here
from tests.benches.extension_package import files_of, install
from tests.benches.one_device import ONE_DEVICE

pytestmark = pytest.mark.usefixtures("no_package_stays_loaded")

SERIAL = """from typing import Literal
from gateway.config.extensions import OtherBus

class It(OtherBus):
    kind: Literal["strange"]
    port: str
    units = (1, 31)
    @property
    def place(self):
        return self.port
    @property
    def serial_path(self):
        return "port", self.port
    def cautions(self):
        yield "port", "is old"
    def bus(self, tap):
        return None
    def driver(self, device, bus, clock):
        return None
"""
"""A package's bus on a serial line."""
ON_IT = '[[device]]\nname = "{}"\nbus = "odd"\nprofile = "{}"\nunit = {}\n[device.channels]\n{} = 0\n'
TWO_ON_IT = ON_IT.format("d1", "p", 3, "a") + ON_IT.format("d2", "q", 3, "b")


def check(folder: Path, text: str) -> Done:
    file = folder / "gateway.toml"
    file.write_text(text, encoding="utf-8")
    return here("check", file)


def with_bus(folder: Path, monkeypatch: pytest.MonkeyPatch, code: str, kind: str = "strange") -> str:
    """The section of a bus of this package, which is installed in the folder."""
    rows = {"talc_gateway.buses": {kind: "other_package:It"}}
    install(files_of("other", rows, {"other_package.py": code.replace("strange", kind)}, "2.3"), folder / "site")
    monkeypatch.syspath_prepend(str(folder / "site"))
    return f'[[bus]]\nname = "odd"\nkind = "{kind}"\n'


def test_a_serial_bus_of_a_package_is_warned_about_as_the_gateway_s_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = with_bus(tmp_path, monkeypatch, SERIAL) + 'port = "/dev/ttyUSB0"\n'
    config = parse(ONE_DEVICE + section, tmp_path / "gateway.toml")
    assert [str(caution) for caution in cautions(config)] == [
        "bus 'odd', port: '/dev/ttyUSB0' may be another adapter after a reboot; use its name in /dev/serial/by-id",
        "bus 'odd', port: is old",
    ]


@pytest.mark.parametrize(("line", "wrong"), [("serial_path", "[[bus]]"), ("cautions", "")])
def test_a_bug_in_what_a_bus_says_of_itself_is_one_line(
    line: str, wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = SERIAL.replace(f"def {line}(self):", f"def {line}(self):\n        raise KeyError('X')")
    done = check(tmp_path, ONE_DEVICE + with_bus(tmp_path, monkeypatch, code) + 'port = "/dev/ttyUSB0"\n')
    assert done.code == (2 if wrong else 0), done.together
    assert "bus 'odd': the package of kind 'strange' failed: KeyError: 'X'" in done.together


@pytest.mark.parametrize("kind", ["strange", "modbus_strange"])
def test_two_devices_of_a_package_s_bus_need_two_addresses(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the kind is called: only the package knows whether one address may be several devices."""
    section = with_bus(tmp_path, monkeypatch, SERIAL, kind) + 'port = "/dev/line"\n'
    done = check(tmp_path, ONE_DEVICE + section + TWO_ON_IT)
    assert done.code == 2
    assert "device 'd2', unit: 3 on bus 'odd' is already device 'd1'\n" in done.together


@pytest.mark.parametrize("answer", ["units = None", "units = (1, 31)\n    several_per_unit = True"])
def test_a_package_may_say_that_its_devices_need_no_address_of_their_own(
    answer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = with_bus(tmp_path, monkeypatch, SERIAL.replace("units = (1, 31)", answer)) + 'port = "/dev/line"\n'
    done = check(tmp_path, ONE_DEVICE + section + TWO_ON_IT)
    assert done.code == 0, done.together


def test_a_field_with_the_name_of_what_the_gateway_asks_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = with_bus(tmp_path, monkeypatch, SERIAL.replace("units = (1, 31)", "timeout_is_age: bool"))
    with pytest.warns(UserWarning, match="shadows an attribute"):
        done = check(tmp_path, ONE_DEVICE + section)
    assert done.code == 2
    assert "other_package:It has a field timeout_is_age, which is a member of OtherBus; rename" in done.together


def test_a_field_may_stand_in_the_place_of_a_value(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    section = with_bus(tmp_path, monkeypatch, SERIAL.replace("units = (1, 31)", "only_listens: bool"))
    with pytest.warns(UserWarning, match="shadows an attribute"):
        done = check(tmp_path, ONE_DEVICE + section + 'port = "/dev/line"\nonly_listens = true\n')
    assert done.code == 0, done.together


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("units = 7", "TypeError: cannot unpack non-iterable int object"),
        ("units = ('1', '31')", "TypeError: units is or contains '1': expected int"),
        ("only_listens = 'yes'", "TypeError: only_listens is or contains 'yes': expected bool"),
        (
            "def timeout_is_age(self, options):\n        raise KeyError('X')",
            "KeyError: 'X'",
        ),
        ("place = None", "TypeError: place is or contains None: expected str"),
    ],
)  # fmt: skip
def test_an_answer_of_another_type_is_one_line(
    code: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = SERIAL.replace("units = (1, 31)", code)
    if code.startswith("place"):
        text = SERIAL.replace("return self.port", "return None")
    done = check(tmp_path, ONE_DEVICE + with_bus(tmp_path, monkeypatch, text) + 'port = "/dev/line"\n')
    assert done.code == 2
    assert f"bus 'odd': the package of kind 'strange' failed: {says}" in done.together


def test_doctor_finds_a_second_program_on_a_package_s_serial_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = with_bus(tmp_path, monkeypatch, SERIAL) + f'port = "{tmp_path}/line"\n'
    config = parse(ONE_DEVICE + section + f'[storage]\npath = "{tmp_path}/db"\n', tmp_path / "gateway.toml")
    for process in ("17", "23"):
        (tmp_path / "proc" / process / "fd").mkdir(parents=True)
        (tmp_path / "proc" / process / "fd" / "5").symlink_to(tmp_path / "line")
    found = [ailment.what for ailment in health_findings(config, tmp_path, synchronised=True)]
    (what,) = (what for what in found if f"{tmp_path}/line" in what)
    assert re.findall(r"\d+", what.partition("/line")[2]) == ["2", "17", "23"]


def test_record_says_what_a_package_s_bus_never_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = SERIAL.replace("units = (1, 31)", 'unrecorded = "a sealed line"')
    section = with_bus(tmp_path, monkeypatch, code) + 'port = "/dev/line"\n'
    (said,) = not_recorded(parse(ONE_DEVICE + section, tmp_path / "gateway.toml"))
    assert "bus 'odd' (strange)" in said
    assert "a sealed line" in said
