"""Broken configurations: each message knows line, section, field and value of what is wrong, and shows the line."""

from pathlib import Path

import pytest

from gateway.config.file import load
from gateway.config.problems import ConfigError, Problem

VALID = (Path(__file__).parent / "cases" / "valid" / "gateway.toml").read_text(encoding="utf-8")
HERE = "  # here"
"""Marks the line that is to be named."""
RTU, TCP = 'kind = "modbus_rtu"', 'host = "192.168.0.10"'
DEVICE, ADAM = 'profile = "icpdas_m7015"', 'profile = "advantech_adam6015"'
CHANNELS = "bed_front = 0\nbed_rear = 1\n"
URL = 'url = "opc.tcp://192.168.214.1:4840"'
END = 'security = "none"\n'

SCHEMA = [
    # what stands in the file, what somebody made of it, section, field, value
    ('[machine]\nname = "mill"', 'machine = "mill"  # here', "[machine]", "", "mill"),
    ('name = "mill"', 'nam = "mill"  # here', "[machine]", "name", None),
    ('name = "mill"', 'name = "mill 7"  # here', "[machine]", "name", "mill 7"),
    ('name = "mill"', 'name = "fräse"  # here', "[machine]", "name", "fräse"),
    ('name = "mill"', "name = 7  # here", "[machine]", "name", 7),
    ('name = "mill"', 'name = ""  # here', "[machine]", "name", ""),
    ('name = "mill"', 'name = "mill"\narmed = true  # here', "[machine]", "armed", True),
    ("[machine]\n", "armed = true  # here\n[machine]\n", "[armed]", "", True),
    ("[[state]]", "[[states]]  # here", "[states]", "", [{"name": "spindle_speed"}]),
    (RTU, f"{RTU}\nbaud = 0  # here", "bus 'rtu1'", "baud", 0),
    (RTU, f'{RTU}\nbaud = "9600"  # here', "bus 'rtu1'", "baud", "9600"),
    (RTU, f"{RTU}\nbaud = 9600.0  # here", "bus 'rtu1'", "baud", 9600.0),
    (RTU, f'{RTU}\nparity = "even"  # here', "bus 'rtu1'", "parity", "even"),
    (RTU, f"{RTU}\nstopbits = 3  # here", "bus 'rtu1'", "stopbits", 3),
    (RTU, f"{RTU}\nunit = 1  # here", "bus 'rtu1'", "unit", 1),
    (RTU, f"{RTU}\nperiod_s = 0  # here", "bus 'rtu1'", "period_s", 0),
    (RTU, f"{RTU}\nperiod_s = -1.0  # here", "bus 'rtu1'", "period_s", -1.0),
    (RTU, f"{RTU}\ntimeout_s = 500  # here", "bus 'rtu1'", "timeout_s", 500),
    (RTU, f"{RTU}\nread_limit_s = 0.1  # here", "bus 'rtu1'", "read_limit_s", 0.1),
    (RTU, f"{RTU}\nhost = \"10.0.0.1\"  # here", "bus 'rtu1'", "host", "10.0.0.1"),
    ('port = "/dev/serial/by-id/usb-adapter"', "port = 1  # here", "bus 'rtu1'", "port", 1),
    ('port = "/dev/serial/by-id/usb-adapter"', 'port = ""  # here', "bus 'rtu1'", "port", ""),
    (TCP, 'host = "127.0.0.300"  # here', "bus 'tcp1'", "host", "127.0.0.300"),
    (TCP, 'host = "192.168.0"  # here', "bus 'tcp1'", "host", "192.168.0"),
    (TCP, 'host = "192.168.O.10"  # here', "bus 'tcp1'", "host", "192.168.O.10"),
    (TCP, 'host = "192.168.0.10:502"  # here', "bus 'tcp1'", "host", "192.168.0.10:502"),
    (TCP, 'host = "http://adam"  # here', "bus 'tcp1'", "host", "http://adam"),
    (TCP, f"{TCP}\nport = 65536  # here", "bus 'tcp1'", "port", 65536),
    (TCP, f'{TCP}\nport = "502"  # here', "bus 'tcp1'", "port", "502"),
    (TCP, f"{TCP}\nbaud = 9600  # here", "bus 'tcp1'", "baud", 9600),
    (f"{DEVICE}\nunit = 1", f"{DEVICE}\nunit = 0  # here", "device 'rtd1'", "unit", 0),
    (DEVICE, 'profile = "absent.toml"  # here', "device 'rtd1'", "profile", "absent.toml"),
    (DEVICE, f"{DEVICE}\nlimits = [0, 80]  # here", "device 'rtd1'", "limits", [0, 80]),
    (DEVICE, f"{DEVICE}\nperiod_s = 1.0  # here", "device 'rtd1'", "period_s", 1.0),
    ('name = "adam"', 'names = "adam"  # here', "device number 2", "name", None),
    (CHANNELS, "bed_front = -1  # here\n", "device 'rtd1'", "channels.bed_front", -1),
    (CHANNELS, 'bed_front = "0"  # here\n', "device 'rtd1'", "channels.bed_front", "0"),
    (CHANNELS, '"bed front" = 0  # here\n', "device 'rtd1'", "channels.bed front", 0),
    ('name = "spindle_speed"', 'name = "spindel_speed"  # here-1', "state 'spindel_speed'", "", None),
    (URL, 'url = "192.168.214.1"  # here', "[nc]", "url", "192.168.214.1"),
    ('kind = "sinumerik"', 'kind = "fanuc"  # here', "[nc]", "kind", "fanuc"),
    (END, 'security = "None"  # here\n', "[nc]", "security", "None"),
    (END, f"{END}user = \"talc\"\n", "[nc]", "", None),
    (END, f"{END}[limits]\nbed_front = [0, 80]  # here\n", "[limits]", "bed_front", [0, 80]),
    (END, f"{END}[limits.bed_front]\nlow = 0  # here\n", "[limits.bed_front]", "low", 0),
    (END, f"{END}[probing]\nposes_deg = [[0, 0], [0, 1.57], [1.57, 0]]  # here\n", "[probing]", "poses_deg",
     [[0, 0], [0, 1.57], [1.57, 0]]),
    (END, f"{END}[probing]\nposes_deg = [[0, 0], [0, 90], 180]  # here\n", "[probing]", "poses_deg[2]", 180),
    (END, f"{END}[probing]\nposes_deg = [\n  [0, 0],\n  [0, 90], [0,\n  4000],  # here\n  [90, 0],\n]\n", "[probing]",
     "poses_deg[2][1]", 4000),
    (END, f"{END}[probing]\nposes_deg = [  # [\n  [0, 0],\n  [0],  # here\n  [0, '180'],\n]\n", "[probing]",
     "poses_deg[1][1]", None),
    (END, f"{END}[probing]\nsphere_radius_mm = 0.12  # here\n", "[probing]", "sphere_radius_mm", 0.12),
    (END, f"{END}[probing]\nsphere_radius_mm = \"120\"  # here\n", "[probing]", "sphere_radius_mm", "120"),
    (END, f"{END}[probing]\narmed = \"yes\"  # here\n", "[probing]", "armed", "yes"),
    (END, f"{END}[probing]\nmode = \"monitor\"  # here\n", "[probing]", "mode", "monitor"),
    (END, f"{END}[compensation]\nmode = \"on\"  # here\n", "[compensation]", "mode", "on"),
    (END, f"{END}[compensation]\nbound_um = 20  # here\n", "[compensation]", "bound_um", 20),
    (END, f"{END}[compensation]\nbound_um = [2e4, 1, 1]  # here\n", "[compensation]", "bound_um[0]", 2e4),
    (END, f"{END}[compensation]\nwatchdog_s = 1  # here\n", "[compensation]", "watchdog_s", 1),
    (END, f"{END}[grid]\nstep = 300  # here\n", "[grid]", "step", 300),
    (END, f"{END}[grid]\nstep_s = nan  # here\n", "[grid]", "step_s", None),
    (END, "grid = 300  # here\n", "[nc]", "grid", 300),
    (END, f"{END}[storage]\npath = 5  # here\n", "[storage]", "path", 5),
    (END, f"{END}[storage]\npath = \"..\"  # here\n", "[storage]", "path", ".."),
    (END, f"{END}[telemetry]\nlisten = \"tcp/a:7447\"  # here\n", "[telemetry]", "listen", "tcp/a:7447"),
    (END, f"{END}[telemetry]\nlisten = [\"127.0.0.1:7447\"]  # here\n", "[telemetry]", "listen[0]", "127.0.0.1:7447"),
    (END, f"{END}[telemetry]\nlisten = [\"tcp/127.0.0.300:7447\"]  # here\n", "[telemetry]", "listen[0]",
     "tcp/127.0.0.300:7447"),
    (END, f"{END}[telemetry]\nlisten = [\n  \"tcp/127.0.0.1:7447\",\n  \"tcp/x\",  # here\n]\n", "[telemetry]",
     "listen[1]", "tcp/x"),
    (END, f"{END}[telemetry]\nprefix = \"/talc\"  # here\n", "[telemetry]", "prefix", "/talc"),
    (END, f"{END}[talc]\nmethod = \"magic\"  # here\n", "[talc]", "method", "magic"),
]  # fmt: skip

SYNTAX = [
    # what stands in the file, what somebody made of it, code of the remedy
    ('name = "mill"', "name = mill  # here", "toml_bare"),
    (TCP, "host = 192.168.0.10  # here", "toml_bare"),
    ('name = "mill"', "name = “mill”  # here", "toml_curly"),
    ('name = "mill"', 'name = "mill  # here', "toml_quote"),
    ('name = "mill"', 'name: "mill"  # here', "toml_colon"),
    ('name = "mill"', "name =  # here", "toml_nothing"),
    ('name = "mill"', "name  # here", "toml_pair"),
    ('name = "mill"', 'machine name = "mill"  # here', "toml_key"),
    ('name = "mill"', 'name = "mill" "7"  # here', "toml_rest"),
    (RTU, f"{RTU}\nperiod_s = 0,5  # here", "toml_decimal"),
    (RTU, f"{RTU}\nperiod_s = .5  # here", "toml_point"),
    (RTU, f"{RTU}\nbaud = 09600  # here", "toml_zero"),
    (RTU, f"{RTU}\nrs485_rts = True  # here", "toml_truth"),
    (TCP, f"{TCP}, port = 502  # here", "toml_line"),
    (f"[device.channels]\n{CHANNELS}", "channels = {  # here\n  bed_front = 0\n}\n", "toml_table"),
    (END, f"{END}[compensation]\nbound_um = (20, 20, 20)  # here\n", "toml_list"),
    ("[machine]", "machine:  # here", "toml_brackets"),
    ("unit = 1", "unit == 1  # here", "toml_pair"),
    ("[machine]", "machine]  # here", "toml_brackets"),
    ('port = "/dev/serial/by-id/usb-adapter"', r'port = "C:\dev"  # here', "toml_backslash"),
    ("[[state]]", "[[state]  # here", "toml_brackets"),
    ("[[state]]\n", '[state]\nname = "tool"\n[[state]]  # here\n', "toml_array"),
    (END, f"{END}[probing]\nposes_deg = [[0, 0] [0, 90]]  # here\n", "toml_comma"),
    (END, f"{END}[probing]\nposes_deg = [[0, 0], [0, 90]  # here\n", "toml_comma"),
    ("unit = 1", "unit = 1\nunit = 2  # here", "toml_twice"),
    (END, f"{END}[machine]  # here\n", "toml_twice"),
]


def broken(old: str, new: str) -> tuple[str, int]:
    """The text, and the line that is to be named: `# here-1` marks the one after it; 0: none."""
    assert VALID.count(old) == 1, old
    lines = VALID.replace(old, new).split("\n")
    marked = [number for number, line in enumerate(lines, 1) if HERE in line]
    above = any("# here-1" in line for line in lines)
    return "\n".join(lines), marked[0] - above if marked else 0


def problems(text: str | bytes, folder: Path) -> tuple[Problem, ...]:
    file = folder / "gateway.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as refused:
        load(file)
    said = str(refused.value)
    for problem in refused.value.problems:
        assert f"{file}: {problem}" in said
        if problem.at is not None:
            assert f"{problem.at.line} | {problem.at.source}" in said
    return refused.value.problems


@pytest.mark.parametrize(("old", "new", "section", "field", "value"), SCHEMA)
def test_a_wrong_field_is_named_with_its_line(
    old: str, new: str, section: str, field: str, value: object, tmp_path: Path
) -> None:
    text, line = broken(old, new)
    found = [problem.at for problem in problems(text, tmp_path) if problem.at is not None]
    if value is None:
        assert (section, field) in [(spot.section, spot.field) for spot in found]
    else:
        assert (section, field, value) in [(spot.section, spot.field, spot.value) for spot in found]
    assert not line or line in [spot.line for spot in found if (spot.section, spot.field) == (section, field)]


@pytest.mark.parametrize(("old", "new", "remedy"), SYNTAX)
def test_a_line_that_cannot_be_read_is_named_with_a_remedy(old: str, new: str, remedy: str, tmp_path: Path) -> None:
    text, line = broken(old, new)
    (problem,) = problems(text, tmp_path)
    assert problem.at is not None
    assert problem.at.line == line
    assert problem.text.says(remedy)


def test_a_file_in_latin_1_is_named_with_its_line(tmp_path: Path) -> None:
    text, line = broken('name = "mill"', 'name = "fräse"  # here')
    (problem,) = problems(text.encode("latin-1"), tmp_path)
    assert problem.at is not None
    assert (problem.at.line, problem.text.value_of("letter")) == (line, "ä")


def test_a_profile_of_ones_own_in_latin_1_is_named_with_its_line(tmp_path: Path) -> None:
    profile = tmp_path / "own.toml"
    profile.write_bytes('protocol = "modbus"\ntitle = "Messgerät"\n'.encode("latin-1"))
    (problem,) = problems(broken(DEVICE, 'profile = "own.toml"')[0], tmp_path)
    assert problem.text.says("file_not_utf8")
    assert f"{profile}:2" in str(problem)


@pytest.mark.parametrize(
    ("old", "new", "sections"),
    [(RTU, f"{RTU}\nunit = 1", "[[device]]"), ('name = "mill"', 'name = "mill"\narmed = true', "[probing]"),
     (END, f"{END}[probing]\nmode = 'monitor'\n", "[compensation]"), (TCP, f"{TCP}\nbaud = 9600", "modbus_rtu"),
     (DEVICE, f"{DEVICE}\nlimits = [0, 80]", "[limits.NAME]"),
     ("[device.channels]\nbed", "[channels]\nbed", "[device.channels]"),
     (URL, 'host = "192.168.214.1"', "[nc] of kind 'linuxcnc'")],
)  # fmt: skip
def test_a_key_of_another_section_is_told_its_section(old: str, new: str, sections: str, tmp_path: Path) -> None:
    told = [problem.text for problem in problems(broken(old, new)[0], tmp_path)]
    assert any(text.says("unknown_key_elsewhere") and sections in str(text.value_of("sections")) for text in told)


def test_the_example_of_a_table_can_be_pasted(tmp_path: Path) -> None:
    (problem,) = problems(VALID + "[limits]\nbed_front = [0, 80]\n", tmp_path)
    example = str(problem.text.value_of("example"))
    file = tmp_path / "gateway.toml"
    file.write_text(VALID + f"[limits]\nbed_front = {example}\n", encoding="utf-8")
    (limits,) = load(file).limits.values()
    assert (limits.min, limits.max) == (0, 80)


@pytest.mark.parametrize(
    ("new", "example"), [("[compensation]\nbound_um = 20\n", "[20, …, …]"), ('[telemetry]\nlisten = "a"\n', "['a']")]
)
def test_a_single_value_is_shown_as_the_list_that_is_expected(new: str, example: str, tmp_path: Path) -> None:
    (problem,) = problems(VALID + new, tmp_path)
    assert problem.text.value_of("example") == example


ONE_BUS = VALID[: VALID.index("[[bus]]")] + VALID[VALID.rindex("[[bus]]") :].replace('bus = "rtu1"', 'bus = "tcp1"')


@pytest.mark.parametrize(
    ("text", "line", "remedy", "name"),
    [(ONE_BUS.replace("[[bus]]", "[bus]"), 4, "toml_several", "bus"),
     (VALID.replace("[machine]", "[[machine]]"), 1, "toml_single", "machine"),
     (VALID.replace(f"[device.channels]\n{CHANNELS}", f"[[device.channels]]\n{CHANNELS}"), 19, "toml_single",
      "device.channels")],
)  # fmt: skip
def test_a_section_with_the_brackets_of_several_is_told_its_own(
    text: str, line: int, remedy: str, name: str, tmp_path: Path
) -> None:
    (found,) = [problem for problem in problems(text, tmp_path) if problem.text.says(remedy)]
    assert found.at is not None
    assert (found.at.line, found.text.value_of("name")) == (line, name)


@pytest.mark.parametrize(("kind", "meant"), [("Modbus_RTU", "modbus_rtu"), ("modbus-tcp", "modbus_tcp")])
def test_capitals_and_dashes_are_no_other_name(kind: str, meant: str, tmp_path: Path) -> None:
    told = [problem.text for problem in problems(broken(RTU, f'kind = "{kind}"')[0], tmp_path)]
    assert any(text.says("mean") and text.value_of("name") == meant for text in told)
