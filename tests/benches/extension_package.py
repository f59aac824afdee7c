"""Third-party packages as pip leaves them in a folder: modules, and a dist-info with entry points."""

import tomllib
import zipfile
from collections.abc import Mapping
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "extension"
_WHEEL = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"


def files_of(
    name: str, entry_points: Mapping[str, Mapping[str, str]], modules: Mapping[str, str], version: str = "0.1.0"
) -> dict[str, str]:
    """Path to text of each file of an installed package."""
    info = f"{name.replace('-', '_')}-{version}.dist-info"
    sections = (
        f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in rows.items()) for group, rows in entry_points.items()
    )
    files = {
        **modules,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        f"{info}/WHEEL": _WHEEL,
        f"{info}/entry_points.txt": "\n".join(sections),
    }
    return files | {f"{info}/RECORD": "".join(f"{path},,\n" for path in (*files, f"{info}/RECORD"))}


def example_files(example: Path = EXAMPLE) -> dict[str, str]:
    """The package in this folder of examples."""
    declared = tomllib.loads((example / "pyproject.toml").read_text(encoding="utf-8"))
    project, (package,) = declared["project"], declared["tool"]["setuptools"]["packages"]
    modules = {
        file.relative_to(example).as_posix(): file.read_text(encoding="utf-8")
        for file in (example / package).glob("*.py")
    }
    return files_of(project["name"], project["entry-points"], modules, project["version"])


def install(files: Mapping[str, str], folder: Path) -> None:
    """Install a package without pip."""
    for path, text in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")


def example_wheel(folder: Path) -> Path:
    """The example's wheel, for pip."""
    wheel = folder / "talc_example-0.1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for path, text in example_files().items():
            archive.writestr(path, text)
    return wheel
