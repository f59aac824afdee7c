"""The commands of the documentation that install something, given as they are shown, without installing it here."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.pages import ROOT, commands

pytestmark = [pytest.mark.peer, pytest.mark.slow]

GIVEN = sorted(
    {
        part.strip()
        for _, command in commands()
        for part in command.split("&&")
        if re.match(r" *((apt|apt-get|uv) |dpkg --add-architecture)", part)
    }
)
UV = "uv==0.13.9"


def given(program: str) -> list[list[str]]:
    """The commands that begin with this program."""
    found = [words for words in map(shlex.split, GIVEN) if words[0] == program]
    assert found
    return found


def run(words: list[str], folder: Path, **more: str) -> str:
    """The output of a command; fails with all of it."""
    environment = {**os.environ, **more}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{shlex.join(words)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_debian_has_what_the_pages_install(tmp_path: Path) -> None:
    """apt and dpkg know this computer's packages, change only a folder, and say what they would install."""
    for name in ("lists/partial", "cache/archives/partial", "dpkg"):
        (tmp_path / name).mkdir(parents=True)
    shutil.copy("/var/lib/dpkg/status", tmp_path / "dpkg")
    config = tmp_path / "apt.conf"
    config.write_text(
        f'Dir::State::lists "{tmp_path}/lists"; Dir::State::status "{tmp_path}/dpkg/status";\n'
        f'Dir::Cache "{tmp_path}/cache"; Dir::Log "{tmp_path}"; APT::Get::Simulate "true";\n'
        f'DPkg::Options {{ "--admindir={tmp_path}/dpkg"; }};\n',
        encoding="utf-8",
    )
    there = {"APT_CONFIG": str(config), "DPKG_ADMINDIR": str(tmp_path / "dpkg"), "LC_ALL": "C"}
    for words in given("dpkg"):
        run(words, tmp_path, **there)
    assert "arm64" in (tmp_path / "dpkg" / "arch").read_text(encoding="ascii").split()
    commands = sorted(given("apt-get") + given("apt"), key=lambda words: words[1] != "update")
    assert [words[1] for words in commands].count("update") == 1
    for words in commands:
        said = run(words, tmp_path, **there)
        if words[1] == "install":
            for name in words[2:]:
                package = re.escape(name.partition(":")[0])
                assert re.search(rf"(?m)^Inst {package}[ :]|^{package} (is already the newest|set to manual)", said), (
                    name
                )


def test_the_locks_are_what_their_commands_make(tmp_path: Path) -> None:
    """Compares names only; where an index no longer has a version, uv takes a newer one."""
    run([sys.executable, "-m", "pip", "install", "--quiet", "--target", str(tmp_path / "uv"), UV], tmp_path)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copytree(ROOT / "requirements", tmp_path / "requirements")
    path = f"{tmp_path}/uv/bin:{os.environ['PATH']}"
    made = []
    for words in sorted(given("uv"), key=lambda words: words[-1].endswith("wheels.lock")):  # it reads another one
        run(words, tmp_path, PATH=path, UV_CACHE_DIR=str(tmp_path / "cache"))
        made.append(Path(words[-1]).name)
        text = (tmp_path / words[-1]).read_text(encoding="utf-8")
        assert packages(text) == packages((ROOT / words[-1]).read_text(encoding="utf-8")), words[-1]
        assert text.count("--hash=") >= len(packages(text))
    assert sorted(made) == sorted(file.name for file in (ROOT / "requirements").glob("*.lock"))


def packages(lock: str) -> set[str]:
    """The names of the packages."""
    return set(re.findall(r"(?m)^([\w.-]+)==", lock))
