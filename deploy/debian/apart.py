"""Moves what only the report needs out of an environment: the libraries of the package talc-gateway-report.

python deploy/debian/apart.py SITE_PACKAGES OTHER_SITE_PACKAGES

It follows what the distributions say that they require, from talc-gateway without its extra `report` on; what is not
reached that way is moved.
"""

import re
import sys
from collections.abc import Mapping
from importlib.metadata import Distribution, distributions
from pathlib import Path

_KEPT = ("talc-gateway", "talc-gateway-simulators")
_EXTRAS = frozenset({"web"})
"""Of talc-gateway; no other distribution is asked for an extra."""


def normal(name: str) -> str:
    """The normal form of a distribution's name: https://peps.python.org/pep-0503/."""
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(installed: Mapping[str, Distribution]) -> set[str]:
    """Names of everything that the program needs without the report."""
    found, left = set[str](), [name for name in _KEPT if name in installed]
    while left:
        name = left.pop()
        if name in found:
            continue
        found.add(name)
        for line in installed[name].requires or ():
            wanted = normal(re.split(r"[^\w.-]", line)[0])
            extra = re.search(r"""extra\s*==\s*['"]([\w-]+)""", line)
            asked = extra is None or (name == _KEPT[0] and extra[1] in _EXTRAS)
            if asked and wanted in installed:
                left.append(wanted)
    return found


def main(site: Path, other: Path) -> None:
    """Raises SystemExit if a folder belongs to both."""
    installed = {normal(each.metadata["Name"]): each for each in distributions(path=[str(site)])}
    kept = needed(installed)
    if _KEPT[0] not in kept or len(kept) == len(installed):
        raise SystemExit(f"{site}: expected talc-gateway, and something that only its report needs")
    tops: dict[bool, set[str]] = {True: set(), False: set()}
    for name, each in installed.items():
        tops[name in kept] |= {file.parts[0] for file in each.files or () if file.parts[0] not in ("..", "bin")}
    if both := tops[True] & tops[False] - {"__pycache__"}:
        raise SystemExit(f"{site}: {', '.join(sorted(both))} belongs to both packages")
    scripts = {file.name for name, each in installed.items() if name not in kept for file in each.files or ()
               if file.parts[0] in ("..", "bin")}  # fmt: skip
    other.mkdir(parents=True)
    for top in tops[False] - {"__pycache__"}:
        (site / top).rename(other / top)
    for script in scripts:  # such as fonttools: nobody calls them
        (site.parents[2] / "bin" / script).unlink(missing_ok=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
