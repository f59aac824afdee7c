"""`talc-gateway nc sinumerik-files`: the program for the machine of a configuration."""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from drivers.sinumerik.programs import ErrorTerms, errors_program
from gateway.cli.main import main
from gateway.config.controls import SinumerikNc
from gateway.config.file import load

CONFIG = """
[machine]
name = "mill"
[nc]
kind = "sinumerik"
url = "opc.tcp://192.168.214.1:4840"
security = "none"
origin_mm = [0.0, 10.0, -50.0]
origin_tool_mm = 80.0
[nc.compensation]
route = "errors"
travel_mm = [[-300.0, 300.0], [-200.0, 250.0], [-400.0, 0.0]]
axis_names = {X = "X1", Y = "Y1", Z = "Z1", A = "A1"}
signs = [-1, 1, -1]
[compensation]
slew_um_per_s = 2.0
bound_um = [40.0, 50.0, 60.0]
[probing]
sphere_radius_mm = 150.0
[[bus]]
name = "ports"
kind = "modbus_tcp"
host = "127.0.0.1"
[[device]]
name = "io"
bus = "ports"
unit = 1
profile = "advantech_adam6015"
channels = {T1 = 0}
"""


def files(folder: Path, text: str) -> Result:
    (folder / "gateway.toml").write_text(text)
    return CliRunner().invoke(main, ["nc", "sinumerik-files", str(folder / "gateway.toml"), "-o", str(folder)])


def test_the_program_contains_the_machine_s_data(tmp_path: Path) -> None:
    done = files(tmp_path, CONFIG)
    assert done.exit_code == 0, done.output
    assert "TALC_ERRORS.SPF: 42 synchronised actions" in done.output
    written = (tmp_path / "TALC_ERRORS.SPF").read_bytes()
    assert written.count(b"\r\n") == written.count(b"\n"), "as the control's editor has it"
    config = load(tmp_path / "gateway.toml")
    assert isinstance(config.nc, SinumerikNc)
    expected = errors_program(
        config.nc.settings(config.probing.poses_deg, ()), ErrorTerms(2.0, 150.0, (40.0, 50.0, 60.0))
    )
    text = written.decode("ascii").replace("\r\n", "\n")
    assert text == expected
    assert "$$SA_TEMP_COMP_ABS_VALUE[Y1] = $AC_PARAM[22]" in text, "its sign"
    assert "$$SA_TEMP_COMP_ABS_VALUE[X1] = 0 - $AC_PARAM[21]" in text
    assert "($AA_IM[Z1] + 50.0)" in text
    assert (
        "R[123] = 2.0 R[124] = 150.0 R[125] = 40.0 R[126] = 50.0 R[127] = 60.0 R[128] = 300.0 R[129] = 424.3819" in text
    )


@pytest.mark.parametrize(
    ("old", "new", "cause"),
    [
        ('route = "errors"', 'route = "k0_slope"', "only 'errors' needs a generated program"),
        ("travel_mm = [[-300.0, 300.0], [-200.0, 250.0], [-400.0, 0.0]]", "", "travel_mm: missing"),
        ('"Z1"', '"X1"', "expected four different names"),
    ],
)
def test_what_cannot_be_written_names_the_setting(tmp_path: Path, old: str, new: str, cause: str) -> None:
    done = files(tmp_path, CONFIG.replace(old, new))
    assert done.exit_code == 2
    assert "[nc" in done.output
    assert cause in done.output
    assert not (tmp_path / "TALC_ERRORS.SPF").exists()
