"""The promises of docs/safety.md and the table of mutations that break them."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "tests" / "safety_mutations.toml"


_NAMED = re.compile(r"`([\w/]+)`(?: in `([\w/]+)`)?: ((?:`\w+`, )*`\w+`)")


@dataclass(frozen=True, slots=True)
class NamedTests:
    """Functions of one file, as a row names them: `file` in `folder`: `function`, `function`."""

    file: str
    """Without suffix, perhaps with folders before it."""
    folder: str
    """From the root; empty: anywhere in tests."""
    functions: frozenset[str]
    """Without `test_`."""

    @property
    def paths(self) -> list[Path]:
        """Those that it can mean; several files may have one name."""
        within, last = ROOT / (self.folder or "tests"), self.file.rpartition("/")[2]
        return [
            path for path in within.rglob(f"{last}.py") if path.with_suffix("").as_posix().endswith(f"/{self.file}")
        ]


def named_in(column: str) -> tuple[NamedTests, ...]:
    """What a row's last column names. Raises ValueError for anything but functions with their file."""
    parts = [(part, _NAMED.fullmatch(part)) for part in column.split("; ")]
    if wrong := [part for part, named in parts if named is None]:
        raise ValueError(f"{wrong[0]!r}: expected `file`: `function`, or `file` in `folder`: `function`")
    groups = [named.groups(default="") for _, named in parts if named is not None]
    return tuple(NamedTests(file, folder, frozenset(re.findall(r"\w+", names))) for file, folder, names in groups)


@dataclass(frozen=True, slots=True)
class Promise:
    """One row of the page's tables."""

    text: str
    """Without backticks."""
    named: tuple[NamedTests, ...]

    @property
    def tests(self) -> frozenset[str]:
        """Test functions in its last column, without `test_`."""
        return frozenset(name for named in self.named for name in named.functions)


@dataclass(frozen=True, slots=True)
class Mutation:
    """One row of tests/safety_mutations.toml; see there."""

    promise: str
    file: str
    text: str
    broken: str
    test: str

    @property
    def function(self) -> str:
        """Name of the test function without `test_`."""
        return self.test.split("::")[1].split("[")[0].removeprefix("test_")

    def applied(self, root: Path = ROOT) -> str:
        """The file's text with the guarded code broken. Raises ValueError unless it occurs exactly once."""
        source = (root / self.file).read_text(encoding="utf-8")
        if (count := source.count(self.text)) != 1:
            raise ValueError(f"{self.file}: {self.text!r} occurs {count} times, expected once")
        return source.replace(self.text, self.broken)


def promises() -> list[Promise]:
    """Every row of the page's tables of promises, in the page's order; a table of figures has no column `test`.

    Raises ValueError for a row that names anything but functions with their file.
    """
    lines = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8").splitlines()
    found, inside, promising = [], False, False
    for line in lines:
        if not line.startswith("|"):
            inside = False
        elif not inside:
            inside, promising = True, line.endswith("| test |")
        elif promising and not set(line) <= set("|- "):
            text, tests = line.strip("| ").rsplit(" | ", 1)
            found.append(Promise(text.replace("`", "").strip(), named_in(tests)))
    return found


def mutations() -> list[Mutation]:
    """Every row of the table. Raises TypeError for a missing or an unknown field."""
    return [Mutation(**row) for row in tomllib.loads(TABLE.read_text(encoding="utf-8"))["mutation"]]
