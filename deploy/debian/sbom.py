"""Writes what an environment holds: a CycloneDX 1.5 list (JSON) and the licences as a text.

python deploy/debian/sbom.py SITE_PACKAGES FOLDER
"""

import json
import re
import sys
from importlib.metadata import Distribution, distributions
from pathlib import Path


def licence(distribution: Distribution) -> str:
    """As its maker states it: the expression, else the classifiers, else the field unless it is a whole text."""
    about = distribution.metadata
    classifiers = (c.rpartition(" :: ")[2] for c in about.get_all("Classifier", []) if c.startswith("License ::"))
    stated = (about["License"] or "").strip()
    short = stated if "\n" not in stated else ""
    return about["License-Expression"] or ", ".join(classifiers) or short or "not stated; see the package's files"


def component(distribution: Distribution) -> dict[str, object]:
    """One entry of the list."""
    name, version = distribution.metadata["Name"], distribution.version
    return {
        "type": "library",
        "bom-ref": f"pkg:pypi/{name.lower()}@{version}",
        "name": name,
        "version": version,
        "purl": f"pkg:pypi/{name.lower()}@{version}",
        "licenses": [{"license": {"name": licence(distribution)}}],
    }


def script(site: Path) -> dict[str, object]:
    """The entry of the report's charts: a script that is part of our own wheel."""
    first = (site / "gateway/report/uplot/uPlot.iife.min.js").read_text(encoding="utf-8").partition("\n")[0]
    found = re.search(r"\(v([\d.]+)\)", first)
    if found is None:
        raise SystemExit(f"uPlot.iife.min.js: expected its version in the first line, found {first!r}")
    purl = f"pkg:npm/uplot@{found[1]}"
    licences = [{"license": {"name": "MIT"}}]
    return {
        "type": "library", "bom-ref": purl, "name": "uplot", "version": found[1], "purl": purl, "licenses": licences
    }  # fmt: skip


def main(site: Path, folder: Path) -> None:
    found = sorted(distributions(path=[str(site)]), key=lambda d: d.metadata["Name"].lower())
    if not found:
        raise SystemExit(f"{site}: holds no distributions")
    components = [*map(component, found), script(site)]
    bom = {"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1, "components": components}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sbom.cdx.json").write_text(json.dumps(bom, indent=1) + "\n", encoding="utf-8")
    rows = [f"{c['name']} {c['version']}: {c['licenses'][0]['license']['name']}" for c in components]
    (folder / "licences.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
