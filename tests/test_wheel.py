"""What is installed: the service, and as a separate distribution the demo's machine, which no real machine needs."""

import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
from email import message_from_bytes
from email.message import Message
from hashlib import sha256
from pathlib import Path
from zipfile import ZipFile

import pytest

from tests.benches.pages import commands

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
VALID = ROOT / "tests" / "gateway" / "config" / "cases" / "valid" / "gateway.toml"
INSTALLED = {"gateway", "drivers", "talc"}
NOT_BESIDE_A_MACHINE = {"celer", "clarabel", "hypothesis", "matplotlib", "pyarrow", "pytest", "scikit-fem", "skglm"}


def pip(*arguments: str | Path) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "SOURCE_DATE_EPOCH": "1767225600"}
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy: the environment of these tests uses the tree's own build folder."""
    here = shutil.ignore_patterns(".*", "build", "dist", "out", "__pycache__", "*.so")
    return shutil.copytree(ROOT, tmp_path_factory.mktemp("wheel") / "source", ignore=here)


def build(source: Path, folder: Path) -> None:
    pip("wheel", "--no-deps", "--wheel-dir", folder, source)


def only_wheel(folder: Path) -> Path:
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    build(source, folder := tmp_path_factory.mktemp("service-wheel"))
    return only_wheel(folder)


@pytest.fixture(scope="module")
def simulators(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    build(source / "deploy" / "simulators", folder := tmp_path_factory.mktemp("simulators-wheel"))
    return only_wheel(folder)


def packed(wheel: Path) -> tuple[set[str], list[str]]:
    """The packages in it, and all of its files."""
    with ZipFile(wheel) as archive:
        names = archive.namelist()
    tops = {name.partition("/")[0] for name in names}
    return {top for top in tops if not top.endswith(".dist-info")}, names


def metadata(wheel: Path) -> Message:
    with ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return message_from_bytes(archive.read(name))


def test_the_wheel_contains_the_service_and_no_simulators_studies_benchmarks_or_tests(wheel: Path) -> None:
    packages, names = packed(wheel)
    assert packages == INSTALLED
    assert not [name for name in names if Path(name).name.startswith(("test_", "conftest"))]
    assert not [name for name in names if name.endswith((".cpp", ".hpp", ".in", ".lock"))]
    notices = ("talc/licences/nanobind.txt", "talc/licences/robin-map.txt")  # of what is compiled into the kernel
    for needed in ("drivers/profiles/icpdas_m7015.toml", "gateway/__main__.py", *notices):
        assert needed in names
    assert [name for name in names if name.startswith("talc/_kernel") and name.endswith(".so")]


@pytest.mark.peer
def test_unzip_lists_it_as_contributing_shows(wheel: Path) -> None:
    """`unzip -l dist/talc_gateway-*.whl` ends with the number of files, and no line names a room that should not be
    there."""
    command = f"unzip -l {wheel.parent}/talc_gateway-*.whl"
    listed = subprocess.run(command, shell=True, capture_output=True, text=True, check=True).stdout
    assert listed.splitlines()[-1].split()[-2:] == [str(len(packed(wheel)[1])), "files"]
    assert not re.search(r" (simulators|studies|benchmarks|tests)/", listed)


@pytest.mark.parametrize("shown", sorted({c for _, c in commands() if re.match(r"pip install ['\"]?talc-gateway", c)}))
def test_pip_finds_all_that_an_installation_shown_on_a_page_names(shown: str, wheel: Path, simulators: Path) -> None:
    """What it would install of ours; the third-party packages are there, in the versions that the wheel asks for."""
    _, _, named = shlex.split(shown)
    file = named.replace("talc-gateway", str(wheel), 1)
    command = ["-m", "pip", "--disable-pip-version-check", "install", "--dry-run", "--no-index"]
    done = subprocess.run(
        [sys.executable, *command, "--find-links", simulators.parent, file], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"(?m)^Would install talc-gateway-\d", done.stdout)
    assert "does not provide the extra" not in done.stderr


def test_the_wheel_names_what_of_others_is_in_it(wheel: Path) -> None:
    """A list below .dist-info/sboms (PEP 770), with the versions that it was compiled with, and their licences."""
    with ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if ".dist-info/sboms/" in name)
        bom = json.loads(archive.read(name))
        licences = {Path(n).name for n in archive.namelist() if ".dist-info/licenses/" in n}
    stated = {part["purl"]: [one["license"]["id"] for one in part["licenses"]] for part in bom["components"]}
    assert {re.sub(r"@v?\d+\.\d+\.\d+$", "", purl): licence for purl, licence in stated.items()} == {
        "pkg:pypi/nanobind": ["BSD-3-Clause"],
        "pkg:github/tessil/robin-map": ["MIT"],
        "pkg:npm/uplot": ["MIT"],
    }
    about = metadata(wheel)
    assert bom["metadata"]["component"]["version"] == about["Version"]
    assert about["License-Expression"] == "Apache-2.0 AND BSD-3-Clause AND MIT"
    assert licences == {"LICENSE", "nanobind.txt", "robin-map.txt"}


def test_no_wheel_is_built_with_another_script_for_the_charts(source: Path, tmp_path: Path) -> None:
    changed = shutil.copytree(source, tmp_path / "changed")
    with (changed / "gateway/reporting/uplot/uPlot.iife.min.js").open("a", encoding="utf-8") as script:
        script.write(" ")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", tmp_path / "wheels", changed]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode != 0
    said = " ".join((done.stdout + done.stderr).split())
    assert "uPlot.iife.min.js: not the file whose SHA-512 is in gateway/reporting/uplot/SHA512SUMS" in said


def test_whatever_builds_a_package_is_installed_by_hash() -> None:
    scripts = sorted((ROOT / "deploy").rglob("*.sh"))
    lines = [line for script in scripts for line in script.read_text("utf-8").replace("\\\n", "").splitlines()]
    installs = [line for line in lines if re.search(r'(pip\b.*|\[@\]}" )install |into\[@\]', line) and "=(" not in line]
    assert len(installs) >= 4
    assert [line for line in installs if "--require-hashes" not in line and "--no-index" not in line] == []


def test_the_same_source_in_another_folder_gives_the_same_bytes(source: Path, simulators: Path, tmp_path: Path) -> None:
    """Of the simulators, which need no compiler."""
    build(shutil.copytree(source, tmp_path / "elsewhere" / "source") / "deploy" / "simulators", tmp_path / "again")
    again = only_wheel(tmp_path / "again")
    assert again.name == simulators.name
    assert sha256(again.read_bytes()).hexdigest() == sha256(simulators.read_bytes()).hexdigest()


def test_an_installation_needs_nothing_that_only_studies_benchmarks_or_tests_need(wheel: Path) -> None:
    requirements = metadata(wheel).get_all("Requires-Dist", [])
    plain = [requirement for requirement in requirements if "extra ==" not in requirement]
    assert any(requirement.startswith("numpy") for requirement in plain)
    assert not [r for r in plain if r.startswith(tuple(NOT_BESIDE_A_MACHINE))]


def test_what_is_installed_has_no_studies_benchmarks_or_tests(wheel: Path, tmp_path: Path) -> None:
    pip("install", "--no-deps", "--no-index", "--target", tmp_path / "site", wheel)
    found = {entry.name for entry in (tmp_path / "site").iterdir() if not entry.name.endswith(".dist-info")}
    assert found == INSTALLED | {"bin"}
    assert [entry.name for entry in (tmp_path / "site" / "bin").iterdir()] == ["talc-gateway"]


def test_the_extra_for_the_demo_brings_the_simulators_and_the_report(wheel: Path, simulators: Path) -> None:
    packages, names = packed(simulators)
    assert packages == {"simulators"}
    assert "simulators/bench/gateway.toml" in names
    assert not [name for name in names if name.endswith(("pyproject.toml", ".pyc", ".cpp", ".hpp"))]
    service, version = metadata(wheel), metadata(simulators)["Version"]
    extra = [r for r in service.get_all("Requires-Dist", []) if r.endswith(('extra == "demo"', "extra == 'demo'"))]
    named = [requirement.partition(";")[0].strip() for requirement in extra]
    assert named == ["talc-gateway[report]", f"talc-gateway-simulators=={version}"]
    assert metadata(simulators).get_all("Requires-Dist") == [f"talc-gateway=={service['Version']}"]


def test_the_service_alone_works_and_its_demo_says_what_to_install(
    wheel: Path, simulators: Path, tmp_path: Path
) -> None:
    site = tmp_path / "site"
    with ZipFile(wheel) as archive:
        archive.extractall(site)
    for arguments, code, said in [
        (("check", str(VALID)), 0, "good."),
        (("demo",), 2, "pip install 'talc-gateway[demo]'"),
    ]:
        assert_said(site, arguments, code, said)
    with ZipFile(simulators) as archive:
        archive.extractall(site)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        demo = ("demo", "--folder", str(tmp_path / "demo"), "--zenoh-port", str(port))
        assert_said(site, demo, 3, f"port {port} on 127.0.0.1 cannot be used")


def assert_said(site: Path, arguments: tuple[str, ...], code: int, said: str) -> None:
    """Run the program in `site` without this tree: neither the path nor the finder of its editable installation."""
    alone = (
        "import sys; sys.meta_path = [f for f in sys.meta_path if 'editable' not in type(f).__module__.lower()];"
        f"sys.path = [{str(site)!r}, *(p for p in sys.path if p != {str(ROOT)!r})];"
        "from gateway.cli.main import main; main()"
    )
    done = subprocess.run([sys.executable, "-I", "-c", alone, *arguments], capture_output=True, text=True)
    assert (done.returncode, said in done.stdout + done.stderr) == (code, True), done.stdout + done.stderr


def test_the_lock_of_an_installation_adds_the_report_alone() -> None:
    lines = (ROOT / "requirements" / "run.lock").read_text("utf-8").splitlines()
    locked = {line.partition("==")[0] for line in lines if "==" in line and not line.startswith(" ")}
    assert "numpy" in locked
    assert locked & NOT_BESIDE_A_MACHINE == {"matplotlib"}
