"""`python -m tests.benches.release`: checks that everything that names the version, the tag included, names the same
one.

Prints what does not agree; exit code 1 then. A commit without a tag may have changes that are not released yet.
"""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def stated(root: Path) -> dict[str, str]:
    """Each place that names the version, and the version there."""
    service = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    simulators = tomllib.loads((root / "deploy/simulators/pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = [*service["optional-dependencies"]["demo"], *simulators["dependencies"]]
    pinned = {name: version for name, _, version in (one.partition("==") for one in needed)}
    cited = re.search(r"^version: (\S+)$", (root / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    released = [heading for heading in headings(root) if heading != "Unreleased"]
    return {
        "pyproject.toml": service["version"],
        "pyproject.toml, extra demo": pinned["talc-gateway-simulators"],
        "deploy/simulators/pyproject.toml": simulators["version"],
        "deploy/simulators/pyproject.toml, dependency": pinned["talc-gateway"],
        "CITATION.cff": cited[1] if cited else "none",
        "CHANGELOG.md, newest release": released[0] if released else "none",
    }


def headings(root: Path) -> list[str]:
    """The changelog's headings, newest first: Unreleased, or a version with its date."""
    text = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    return re.findall(r"^## \[(Unreleased(?=\]$)|[^\]]+(?=\] - \d{4}-\d\d-\d\d$))", text, re.M)


def faults(root: Path) -> list[str]:
    """What does not agree, in the files and with the tag of the commit, if it has one."""
    places = stated(root)
    version = places["pyproject.toml"]
    found = [f"{place}: {other}, but pyproject.toml: {version}" for place, other in places.items() if other != version]
    for tag in _git(root, "tag", "--points-at", "HEAD", "v*").split():
        if tag != f"v{version}":
            found.append(f"tag {tag}: pyproject.toml has {version}")
        if _git(root, "cat-file", "-t", tag).strip() != "tag":
            found.append(f"tag {tag}: not annotated (git tag --annotate)")
        elif not re.search(r"^Signed-off-by: .+ <.+>$", _git(root, "cat-file", "tag", tag), re.M):
            found.append(f"tag {tag}: its message has no line Signed-off-by")
        if headings(root)[:1] == ["Unreleased"]:
            found.append(f"tag {tag}: CHANGELOG.md begins with Unreleased")
    return found


def _git(root: Path, *arguments: str) -> str:
    """The output of git; empty in a folder without a repository, such as a source archive."""
    if not (root / ".git").exists():
        return ""
    return subprocess.run(["git", "-C", root, *arguments], capture_output=True, text=True, check=True).stdout


def main() -> None:
    found = faults(ROOT)
    print("\n".join(found) or f"all agree: {stated(ROOT)['pyproject.toml']}")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
