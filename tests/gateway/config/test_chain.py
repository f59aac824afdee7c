"""`[machine] chain`: what `check` refuses on a machine that is not compensated, and what `nc poses` says of it."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.config.consequences import unarmed
from gateway.config.file import load, parse
from gateway.config.problems import ConfigError
from gateway.model.codes import NoticeCode
from gateway.model.text import plain
from talc.kinematics import CHAIN
from tests.benches.one_device import ONE_DEVICE

FILE = Path("/srv/talc/gateway.toml")
MILL = """chain = "w X' Y' b Z S t"
work_mm = [[0, 600], [0, 400], [-400, 0]]
[machine.linear]
X = { travel_mm = [0, 600] }
Y = { travel_mm = [0, 400] }
Z = { travel_mm = [-400, 0] }
"""
AGENT = """
[nc]
kind = "agent"
host = "127.0.0.1"
key_file = "talc.key"
"""


def machine(keys: str, more: str = "") -> str:
    return ONE_DEVICE.replace('name = "mill"\n', f'name = "mill"\n{keys}\n', 1) + more


def refused(text: str) -> dict[str, str]:
    """Code of each problem, by its place."""
    with pytest.raises(ConfigError) as error:
        parse(text, FILE)
    return {problem.where: plain(problem.what).code for problem in error.value.problems}


def test_the_default_is_the_chain_of_the_method_however_it_is_written() -> None:
    for keys in ("", "chain = \"w C' A' X' b Y Z S t\"", f'chain = "{CHAIN}"'):
        config = parse(machine(keys), FILE)
        assert (config.machine.chain, config.machine.corrected) == (CHAIN, True)


@pytest.mark.parametrize(
    "keys",
    [
        MILL,
        'chain = "w C\' b X Y Z A S t"',
        "[machine.rotary.A]\nsense = -1",
        "[machine.rotary.C]\norigin_mm = [0, 5, 0]",
    ],
)
def test_no_other_machine_is_probed_or_compensated(keys: str) -> None:
    armed = "[probing]\narmed = true\n"
    control = "" if "X' Y'" in keys else AGENT
    assert refused(machine(keys, control + armed))["[probing] armed"] == NoticeCode.CHAIN_NOT_CORRECTED
    for mode in ("advise", "compensate"):
        text = machine(keys, f'{control}[compensation]\nmode = "{mode}"\n')
        assert refused(text)["[compensation] mode"] == NoticeCode.CHAIN_NOT_CORRECTED
    reads = parse(machine(keys, control), FILE)
    assert NoticeCode.OFF_CHAIN in [text.code for text in unarmed(reads)]


def test_a_control_is_refused_that_is_read_with_other_axes() -> None:
    assert refused(machine(MILL, AGENT)) == {"[nc]": NoticeCode.CONTROL_OTHER_AXES}


@pytest.mark.parametrize(
    ("keys", "where", "code"),
    [
        ('chain = "w X Y b Z S t"', "[machine] chain", NoticeCode.CHAIN_FORM),
        ("work_mm = [[0, 1], [5, 5], [0, 1]]", "[machine] work_mm[1]", NoticeCode.LIMITS_REVERSED),
        ("[machine.rotary.B]\nsense = 1", "[machine.rotary.B]", NoticeCode.AXIS_NOT_IN_CHAIN),
    ],
)
def test_a_mistake_is_named_with_its_place(keys: str, where: str, code: str) -> None:
    assert refused(machine(keys)) == {where: code}


def nc(folder: Path, text: str, *words: str) -> Result:
    (folder / "gateway.toml").write_text(text)
    return CliRunner().invoke(main, ["nc", words[0], str(folder / "gateway.toml"), *words[1:]])


def test_neither_a_dry_run_nor_a_program_is_made_for_another_machine(tmp_path: Path) -> None:
    turned = "[machine.rotary.A]\nsense = -1"
    sinumerik = '[nc]\nkind = "sinumerik"\nurl = "opc.tcp://127.0.0.1:1"\nsecurity = "none"\norigin_tool_mm = 80.0\n'
    sinumerik += '[nc.compensation]\nroute = "errors"\ntravel_mm = [[-300, 300], [-200, 250], [-400, 0]]\n'
    for words in (("dry-run",), ("sinumerik-files", "-o", str(tmp_path))):
        done = nc(tmp_path, machine(turned, sinumerik), *words)
        assert done.exit_code == 2
        assert CHAIN in done.output
    assert not list(tmp_path.glob("*.SPF"))


def test_a_three_axis_mill_learns_what_one_sphere_cannot_tell(tmp_path: Path) -> None:
    done = nc(tmp_path, machine(MILL), "poses", "--sphere-mm", "300", "200", "-300", "--language", "en")
    assert done.exit_code == 0, done.output
    hidden = [line for line in done.output.splitlines() if line.startswith("CANNOT BE KNOWN")]
    assert [line.split()[3] for line in hidden] == ["EXX", "EYY", "EZZ", "EC0Y", "EB0Z", "EA0Z"]
    assert "4 spheres at X300 Y200 Z-300" in done.output
    german = nc(tmp_path, machine(MILL), "poses", "--sphere-mm", "300", "200", "-300", "--language", "de")
    assert german.output.count("NICHT ERKENNBAR") == 6
    lost = nc(tmp_path, machine(MILL), "poses")
    assert lost.exit_code == 2
    assert "120 0 80" in lost.output, "the sphere of [probing], which the travel does not reach"


def planned(done: Result) -> list[list[float]]:
    found = re.search(r"= (\[\[.*\]\])", done.output)
    assert found is not None, done.output
    poses: list[list[float]] = json.loads(found[1])
    return poses


def test_five_axes_get_poses_and_what_six_of_them_make_of_others(tmp_path: Path) -> None:
    limited = '[machine.linear]\nX = { feedback = "scale" }\nY = { feedback = "scale" }\nZ = { feedback = "scale" }'
    limited += "\n[machine.rotary]\nA = { travel_deg = [-30, 30] }"
    done = nc(tmp_path, machine(limited), "poses", "--language", "en")
    assert done.exit_code == 0, done.output
    assert "CANNOT BE KNOWN" not in done.output
    poses = planned(done)
    assert len(poses) == 6, "as many as the programs on a control have room for"
    assert max(abs(a) for a, _ in poses) <= 30
    residuals = [float(line.rsplit(" ", 2)[1]) for line in done.output.splitlines() if line.startswith("  EB0A")]
    assert residuals[0] == 0.38, "with the poses of [probing] it is lost in noise of 1 µm"
    pasted = machine(f"{limited}\n[probing]\nposes_deg = {poses}")
    again = nc(tmp_path, pasted, "poses", "--language", "en", "--most-poses", "9")
    assert 6 < len(planned(again)) <= 9
    few = nc(tmp_path, pasted, "poses", "--language", "en", "--most-poses", "2")
    assert len(planned(few)) == 2
    assert "do not separate EY0A" in few.output
    assert load(tmp_path / "gateway.toml").machine.corrected
