"""The promises of docs/safety.md and the table of mutations that break them."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "tests" / "safety_mutations.toml"


@dataclass(frozen=True, slots=True)
class Promise:
    """One row of the page's tables."""

    text: str
    """Without backticks."""
    tests: frozenset[str]
    """Names in its last column: test functions without `test_`, test files without suffix, or their paths."""


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
    """Every row of the page's tables of promises, in the page's order; a table of figures has no column `test`."""
    lines = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8").splitlines()
    found, inside, promising = [], False, False
    for line in lines:
        if not line.startswith("|"):
            inside = False
        elif not inside:
            inside, promising = True, line.endswith("| test |")
        elif promising and not set(line) <= set("|- "):
            text, tests = line.strip("| ").rsplit(" | ", 1)
            found.append(Promise(text.replace("`", "").strip(), frozenset(re.findall(r"`([^`]+)`", tests))))
    return found


def mutations() -> list[Mutation]:
    """Every row of the table. Raises TypeError for a missing or an unknown field."""
    return [Mutation(**row) for row in tomllib.loads(TABLE.read_text(encoding="utf-8"))["mutation"]]
