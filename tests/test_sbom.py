"""The list of components and the licences of the Debian package, from environments made for the test
(deploy/debian/sbom.py)."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.benches.locked import locked

ROOT = Path(__file__).parents[1]
LICENCES = ROOT / "talc" / "licences"


def distribution(site: Path, name: str, version: str, stated: str = "License-Expression: MIT") -> Path:
    """A distribution as an installer leaves it."""
    folder = site / f"{name}-{version}.dist-info"
    folder.mkdir(parents=True)
    about = f"Metadata-Version: 2.4\nName: {name}\nVersion: {version}\n{stated}\n"
    (folder / "METADATA").write_text(about, encoding="utf-8")
    return folder


def environments(folder: Path) -> tuple[Path, Path]:
    """What is installed, and with what the kernel was compiled."""
    site, build = folder / "site", folder / "build"
    for name, version in (("typing_extensions", "4.16.0"), ("Jinja2", "3.1.6"), ("zope.interface", "7.0")):
        distribution(site, name, version)
    charts = site / "gateway/reporting/uplot"
    charts.mkdir(parents=True)
    shutil.copy(ROOT / "gateway/reporting/uplot/uPlot.iife.min.js", charts)
    shutil.copytree(LICENCES, site / "talc" / "licences")
    distribution(build, "ninja", "1.13.2")
    licences = (
        distribution(build, "nanobind", "3.1.0", "Classifier: License :: OSI Approved :: BSD License") / "licenses"
    )
    licences.mkdir()
    shutil.copy(LICENCES / "nanobind.txt", licences / "LICENSE")
    headers = build / "nanobind/ext/robin_map/include/tsl"
    headers.mkdir(parents=True)
    lines = (LICENCES / "robin-map.txt").read_text("utf-8").splitlines()
    (headers / "robin_map.h").write_text(
        "\n".join(["/**", *(f" * {line}" for line in lines), " */", "#ifndef X"]), encoding="utf-8"
    )
    numbers = zip(("MAJOR", "MINOR", "PATCH"), (1, 4, 2), strict=True)
    policy = "\n".join(f"// {part}\n#define TSL_RH_VERSION_{part} {number}" for part, number in numbers)
    (headers / "robin_growth_policy.h").write_text(policy, encoding="utf-8")
    return site, build


def listed(site: Path, build: Path, out: Path) -> subprocess.CompletedProcess[str]:
    script = ROOT / "deploy" / "debian" / "sbom.py"
    return subprocess.run([sys.executable, script, site, build, out], capture_output=True, text=True)


def components(out: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((out / "sbom.cdx.json").read_text("utf-8"))["components"]
    return found


def test_it_lists_what_is_installed_and_what_is_compiled_into_the_kernel(tmp_path: Path) -> None:
    done = listed(*environments(tmp_path), tmp_path / "out")
    assert done.returncode == 0, done.stderr
    found = components(tmp_path / "out")
    assert {part["purl"] for part in found} == {
        "pkg:pypi/jinja2@3.1.6",
        "pkg:pypi/typing-extensions@4.16.0",
        "pkg:pypi/zope-interface@7.0",
        "pkg:npm/uplot@1.6.32",
        "pkg:pypi/nanobind@3.1.0",
        "pkg:github/tessil/robin-map@v1.4.2",
    }
    assert all(part["bom-ref"] == part["purl"] for part in found)
    stated = {part["name"]: part["licenses"][0]["license"]["name"] for part in found}
    assert (stated["nanobind"], stated["robin-map"]) == ("BSD-3-Clause", "MIT")


def test_the_notices_of_what_is_compiled_in_come_with_it(tmp_path: Path) -> None:
    listed(*environments(tmp_path), tmp_path / "out")
    text = (tmp_path / "out" / "licences.txt").read_text("utf-8")
    assert "nanobind 3.1.0: BSD-3-Clause" in text.splitlines()
    assert "Copyright (c) 2022 Wenzel Jakob" in text
    assert "2. Redistributions in binary form must reproduce the above copyright notice" in text
    assert "Copyright (c) 2017 Thibaut Goetghebuer-Planchon" in text
    assert "The above copyright notice and this permission notice shall be included in all" in text


def test_a_licence_that_has_changed_is_not_replaced_by_the_former_one(tmp_path: Path) -> None:
    site, build = environments(tmp_path)
    changed = build / "nanobind-3.1.0.dist-info/licenses/LICENSE"
    changed.write_text(changed.read_text("utf-8").replace("2022", "2022-2027"), encoding="utf-8")
    done = listed(site, build, tmp_path / "out")
    assert done.returncode != 0
    assert "nanobind.txt: expected the licence of nanobind 3.1.0" in done.stderr
    assert not (tmp_path / "out").exists()


def test_without_the_environment_of_the_kernel_there_is_no_list(tmp_path: Path) -> None:
    site, _ = environments(tmp_path)
    done = listed(site, tmp_path / "elsewhere", tmp_path / "out")
    assert done.returncode != 0
    assert "expected nanobind, with which the kernel was compiled, found 0" in done.stderr


def test_what_a_lock_installs_depends_on_the_python(tmp_path: Path) -> None:
    lock = tmp_path / "run.lock"
    lock.write_text(
        "cffi==2.1.1 ; platform_python_implementation != 'PyPy' \\\n    --hash=sha256:00\n    # via x==1\n"
        "numpy==2.4.6 ; python_full_version < '3.12' \\\n    --hash=sha256:00\n"
        "numpy==2.5.5 ; python_full_version >= '3.12' \\\n    --hash=sha256:00\n",
        encoding="utf-8",
    )
    assert locked(lock, "3.11") == {"cffi==2.1.1", "numpy==2.4.6"}
    assert locked(lock, "3.13") == {"cffi==2.1.1", "numpy==2.5.5"}
