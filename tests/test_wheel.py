"""What is installed: the service, and as a separate distribution the demo's machine, which no real machine needs."""

import json
import os
import re
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

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
VALID = ROOT / "tests" / "gateway" / "config" / "cases" / "valid" / "gateway.toml"
INSTALLED = {"gateway", "drivers", "talc"}
NOT_BESIDE_A_MACHINE = {"celer", "clarabel", "hypothesis", "matplotlib", "pyarrow", "pytest", "scikit-fem", "skglm"}


Environment = dict[str, str]


def pip(environment: Environment, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment)


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """The environment with the locked tools that build wheels; pip alone would install them for each wheel."""
    folder = tmp_path_factory.mktemp("tools")
    lock = ROOT / "requirements" / "build.lock"
    done = pip(dict(os.environ), "install", "--no-compile", "--target", folder, "--require-hashes", "-r", lock)
    assert done.returncode == 0, done.stderr
    path = f"{folder / 'bin'}:{os.environ['PATH']}"
    return {**os.environ, "PYTHONPATH": str(folder), "PATH": path, "SOURCE_DATE_EPOCH": "1767225600"}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy: the environment of these tests uses the tree's own build folder."""
    here = shutil.ignore_patterns(".*", "build", "dist", "out", "__pycache__", "*.so")
    return shutil.copytree(ROOT, tmp_path_factory.mktemp("wheel") / "source", ignore=here)


def tried(tools: Environment, source: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    return pip(tools, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, source)


def build(tools: Environment, source: Path, folder: Path) -> Path:
    done = tried(tools, source, folder)
    assert done.returncode == 0, done.stderr
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(tools: Environment, source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tools, source, tmp_path_factory.mktemp("service-wheel"))


@pytest.fixture(scope="module")
def simulators(tools: Environment, source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tools, source / "deploy" / "simulators", tmp_path_factory.mktemp("simulators-wheel"))


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


def test_no_wheel_is_built_with_another_script_for_the_charts(tools: Environment, source: Path, tmp_path: Path) -> None:
    changed = shutil.copytree(source, tmp_path / "changed")
    with (changed / "gateway/reporting/uplot/uPlot.iife.min.js").open("a", encoding="utf-8") as script:
        script.write(" ")
    done = tried(tools, changed, tmp_path / "wheels")
    assert done.returncode != 0
    said = " ".join((done.stdout + done.stderr).split())
    assert "uPlot.iife.min.js: not the file whose SHA-512 is in gateway/reporting/uplot/SHA512SUMS" in said


def test_whatever_builds_a_package_is_installed_by_hash() -> None:
    scripts = sorted((ROOT / "deploy").rglob("*.sh"))
    lines = [line for script in scripts for line in script.read_text("utf-8").replace("\\\n", "").splitlines()]
    installs = [line for line in lines if re.search(r'(pip\b.*|\[@\]}" )install |into\[@\]', line) and "=(" not in line]
    assert len(installs) >= 4
    assert [line for line in installs if "--require-hashes" not in line and "--no-index" not in line] == []


def test_the_same_source_in_another_folder_gives_the_same_bytes(
    tools: Environment, source: Path, simulators: Path, tmp_path: Path
) -> None:
    """Of the simulators, which need no compiler."""
    elsewhere = shutil.copytree(source, tmp_path / "elsewhere" / "source") / "deploy" / "simulators"
    again = build(tools, elsewhere, tmp_path / "again")
    assert again.name == simulators.name
    assert sha256(again.read_bytes()).hexdigest() == sha256(simulators.read_bytes()).hexdigest()


def test_an_installation_needs_nothing_that_only_studies_benchmarks_or_tests_need(wheel: Path) -> None:
    requirements = metadata(wheel).get_all("Requires-Dist", [])
    plain = [requirement for requirement in requirements if "extra ==" not in requirement]
    assert any(requirement.startswith("numpy") for requirement in plain)
    assert not [r for r in plain if r.startswith(tuple(NOT_BESIDE_A_MACHINE))]


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
        (("demo",), 2, "pip install ./deploy/simulators"),
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
