"""What the Containerfile refers to: names and places of the package, and the time that a stop may need."""

import re
from fnmatch import fnmatch
from pathlib import Path

import pytest

from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.service.run import stop_s

DEPLOY = Path(__file__).parents[1] / "deploy"
TEXT = (DEPLOY / "container/Containerfile").read_text(encoding="utf-8")
UNIT = (DEPLOY / "systemd/talc-gateway.service").read_text(encoding="utf-8")


def instruction(name: str) -> str:
    (found,) = re.findall(rf"^{name} (.*)$", TEXT, re.MULTILINE)
    return str(found)


def unit(name: str) -> str:
    (found,) = re.findall(rf"^{name}=(.*)$", UNIT, re.MULTILINE)
    return str(found)


@pytest.mark.parametrize("architecture", ["amd64", "arm64"])
def test_it_installs_what_the_build_makes(architecture: str) -> None:
    build = (DEPLOY / "debian/build.sh").read_text(encoding="utf-8")
    (name,) = re.findall(r'"\$output/(\S+\.deb)"', build)
    built = name.replace("${version}", "0.1.0").replace("$architecture", architecture)
    assert fnmatch(built, instruction("COPY").split()[0])


def test_it_runs_as_the_service_does() -> None:
    assert instruction("USER") == unit("User")
    assert instruction("WORKDIR") == unit("WorkingDirectory")
    program = instruction("ENTRYPOINT").strip('["]')
    arguments = [word.strip(' "') for word in instruction("CMD").strip("[]").split(",")]
    assert unit("ExecStart").split()[1:] == arguments
    assert Path(program).name == Path(unit("ExecStart").split()[0]).name
    assert f'"$root{program}"' in (DEPLOY / "debian/build.sh").read_text(encoding="utf-8")


def corrected() -> GatewayConfig:
    """The default bounds and slew."""
    return validate({
        "machine": {"name": "mill"},
        "nc": {"kind": "sinumerik", "url": "opc.tcp://nowhere:4840", "security": "none"},
        "compensation": {"mode": "compensate"},
    })  # fmt: skip


def test_a_stop_waits_for_the_ramp() -> None:
    (waits_s,) = re.findall(r"--stop-timeout (\d+)", TEXT)
    assert float(waits_s) >= stop_s(corrected()) > 60.0
