"""Deletes each statement of the programs for a SINUMERIK in turn: `python -m tests.benches.nc_deleted`.

The cases of tests/benches/nc_cases.py have to notice, those of tests/benches/watchdog_programs.py for TALC_START,
TALC_SLOPES and TALC_ERRORS. Prints each statement that nothing misses, and how many there were.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from simulators.nc import statements as b
from simulators.nc.blocks import read_program
from simulators.nc.synchronised import ProgramAlarm
from tests.benches.nc_cases import CASES
from tests.benches.probing_programs import program_texts
from tests.benches.watchdog_programs import WATCHDOG_CASES, watchdog_texts

Case = Callable[[Mapping[str, str]], list[str]]


@dataclass(frozen=True)
class Deleted:
    """One program without one of its statements; a structure goes with everything in it."""

    program: str
    first: int
    last: int
    block: str

    def texts(self, texts: Mapping[str, str]) -> dict[str, str]:
        lines = texts[self.program].splitlines()
        lines[self.first - 1 : self.last] = [""] * (self.last - self.first + 1)
        return {**texts, self.program: "\n".join(lines) + "\n"}


def statements(texts: Mapping[str, str]) -> Iterator[Deleted]:
    """Every statement but the last of a program, which is its end."""
    for name, text in texts.items():
        lines = text.splitlines()
        for statement in _all(read_program(text).body[:-1]):
            last = statement.last if isinstance(statement, b.If | b.For) else statement.line
            yield Deleted(name, statement.line, last, lines[statement.line - 1].split(";")[0].strip())


def _all(body: Sequence[b.Statement]) -> Iterator[b.Statement]:
    for statement in body:
        yield statement
        if isinstance(statement, b.If):
            yield from _all([*statement.then, *statement.otherwise])
        elif isinstance(statement, b.For):
            yield from _all(statement.body)


def missed_by(
    deleted: Deleted, texts: Mapping[str, str], order: list[str], cases: Mapping[str, Case] = CASES
) -> str | None:
    """The case that notices; None: none does. order: which case to try first, and how it is best next time."""
    without = deleted.texts(texts)
    for name in list(order):
        try:
            noticed = bool(cases[name](without))
        except (ProgramAlarm, RecursionError):
            noticed = True
        if noticed:
            order.remove(name)
            order.insert(0, name)
            return name
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("programs", nargs="*", help="without TALC_; all of them")
    chosen, orders = parser.parse_args().programs, dict[bool, list[str]]()
    count = kept = 0
    for texts in (program_texts(), watchdog_texts()):
        for deleted in statements(texts):
            if chosen and deleted.program not in chosen:
                continue
            cases = WATCHDOG_CASES.get(deleted.program, CASES)
            order, count = orders.setdefault(deleted.program in WATCHDOG_CASES, list(cases)), count + 1
            if missed_by(deleted, texts, order, cases) is None:
                kept += 1
                print(f"TALC_{deleted.program} line {deleted.first}: nothing misses {deleted.block}", flush=True)
    print(f"{count} statements, {kept} of them missed by nothing")
    sys.exit(bool(kept))


if __name__ == "__main__":
    main()
