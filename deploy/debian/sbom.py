"""Writes what an environment holds: a CycloneDX 1.5 list (JSON) and the licences as a text.

python deploy/debian/sbom.py SITE_PACKAGES FOLDER
"""

import json
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


def main(site: Path, folder: Path) -> None:
    found = sorted(distributions(path=[str(site)]), key=lambda d: d.metadata["Name"].lower())
    if not found:
        raise SystemExit(f"{site}: holds no distributions")
    bom = {"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1, "components": [component(d) for d in found]}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sbom.cdx.json").write_text(json.dumps(bom, indent=1) + "\n", encoding="utf-8")
    rows = [f"{d.metadata['Name']} {d.version}: {licence(d)}" for d in found]
    (folder / "licences.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
