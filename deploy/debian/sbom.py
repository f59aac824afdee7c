"""Lists what an environment contains: a CycloneDX 1.5 list (JSON), and the licences as a text.

python deploy/debian/sbom.py SITE_PACKAGES BUILD_SITE_PACKAGES FOLDER

BUILD_SITE_PACKAGES: of the environment in which the kernel was compiled; its nanobind is part of talc/_kernel. The
texts of the licences, in talc/licences, are nanobind's LICENSE and ext/robin_map/LICENSE.
"""

import json
import re
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, distributions
from pathlib import Path


def licence(distribution: Distribution) -> str:
    """As its maker states it: the expression, else the classifiers, else the field unless it is a whole text."""
    about = distribution.metadata
    classifiers = (c.rpartition(" :: ")[2] for c in about.get_all("Classifier", []) if c.startswith("License ::"))
    stated = (about["License"] or "").strip()
    short = stated if "\n" not in stated else ""
    return about["License-Expression"] or ", ".join(classifiers) or short or "not stated; see the package's files"


def entry(purl: str, name: str, version: str, stated: str) -> dict[str, object]:
    """One entry of the list. purl: without its version."""
    purl = f"{purl}@{version}"
    licences = [{"license": {"name": stated}}]
    return {
        "type": "library", "bom-ref": purl, "name": name, "version": version, "purl": purl, "licenses": licences
    }  # fmt: skip


def pypi(name: str) -> str:
    """The package URL of a distribution, whose name has a normal form: https://peps.python.org/pep-0503/."""
    return f"pkg:pypi/{re.sub(r'[-_.]+', '-', name).lower()}"


def component(distribution: Distribution) -> dict[str, object]:
    """The entry of an installed distribution."""
    name = distribution.metadata["Name"]
    return entry(pypi(name), name, distribution.version, licence(distribution))


def words(text: str) -> list[str]:
    """The words of a licence, without comment signs and line breaks."""
    return text.replace("*", " ").split()


def compiled_in(site: Path, build: Path) -> Iterator[tuple[dict[str, object], str]]:
    """The entries and licence texts of what the compiler has put into talc/_kernel."""
    found = list(distributions(name="nanobind", path=[str(build)]))
    if len(found) != 1:
        raise SystemExit(f"{build}: expected nanobind, with which the kernel was compiled, found {len(found)}")
    headers = build / "nanobind/ext/robin_map/include/tsl"
    defined = (headers / "robin_growth_policy.h").read_text(encoding="utf-8")
    robin = ".".join(re.findall(r"#define TSL_RH_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)", defined))
    if robin.count(".") != 2:
        raise SystemExit(f"{headers}/robin_growth_policy.h: expected three numbers of its version, found {robin!r}")
    first = (headers / "robin_map.h").read_text(encoding="utf-8").partition("*/")[0]
    theirs = {
        "nanobind": (found[0].read_text("licenses/LICENSE") or "", pypi("nanobind"), found[0].version, "BSD-3-Clause"),
        "robin-map": (first.partition("/**")[2], "pkg:github/tessil/robin-map", f"v{robin}", "MIT"),
    }
    for name, (text, purl, version, stated) in theirs.items():
        ours = site / "talc/licences" / f"{name}.txt"
        shipped = ours.read_text(encoding="utf-8")
        if words(shipped) != words(text):
            raise SystemExit(f"{ours}: expected the licence of {name} {version} in {build}; copy it to talc/licences")
        yield entry(purl, name, version, stated), shipped


def script(site: Path) -> dict[str, object]:
    """The entry of the report's charts: a script that is part of our own wheel."""
    first = (site / "gateway/reporting/uplot/uPlot.iife.min.js").read_text(encoding="utf-8").partition("\n")[0]
    found = re.search(r"\(v([\d.]+)\)", first)
    if found is None:
        raise SystemExit(f"uPlot.iife.min.js: expected its version in the first line, found {first!r}")
    return entry("pkg:npm/uplot", "uplot", found[1], "MIT")


def main(site: Path, build: Path, folder: Path) -> None:
    """Write both files."""
    found = sorted(distributions(path=[str(site)]), key=lambda d: d.metadata["Name"].lower())
    if not found:
        raise SystemExit(f"{site}: contains no distributions")
    ours = (site / "talc").exists()  # and not only libraries
    compiled = list(compiled_in(site, build)) if ours else []
    scripts = [script(site)] if ours else []
    components = [*map(component, found), *scripts, *(part for part, _ in compiled)]
    bom = {"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1, "components": components}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sbom.cdx.json").write_text(json.dumps(bom, indent=1) + "\n", encoding="utf-8")
    rows = [f"{c['name']} {c['version']}: {c['licenses'][0]['license']['name']}" for c in components]
    notices = [f"\n{part['name']} is compiled into talc/_kernel:\n\n{text.strip()}" for part, text in compiled]
    (folder / "licences.txt").write_text("\n".join([*rows, *notices]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
