"""`python -m tests.benches.mutation`: which mutants of the safety-critical modules do the tests kill?

cosmic-ray makes the mutants; it has its own environment, which `make mutation` creates. What differs within
functions is tried by tests.benches.collected_tests; any other mutant runs all of the module's tests in a process forked
from this one, which has loaded the libraries already. The results are in out/mutation/MODULE.jsonl; a run that was
stopped continues, until the module changes. Prints a Markdown table, and each survivor that
tests/surviving_mutants.toml does not explain.
"""

import argparse
import difflib
import hashlib
import importlib
import importlib.machinery
import importlib.util
import json
import math
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import CodeType, ModuleType

import pytest

from tests.benches.collected_tests import LEAST_CPU_S, LEAST_WAIT_S, TIMES, CollectedTests, waited
from tests.benches.mutated_functions import Mutant, is_another

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out" / "mutation"
REASONS = ROOT / "tests" / "surviving_mutants.toml"
_NC = "tests/gateway/nc/"
_LINK = (
    f"{_NC}test_nc_link.py", f"{_NC}test_nc_link_states.py", f"{_NC}test_nc_link_absent.py",
    f"{_NC}test_nc_link_elsewhere.py", f"{_NC}test_late_write.py",
)  # fmt: skip
_STORE = tuple(
    f"tests/gateway/storage/test_{name}.py"
    for name in (
        "store",
        "store_faults",
        "retention",
        "gathering",
        "deleted",
        "linked_file",
        "damage",
        "migration",
        "known_rows",
    )
)
_CONTROLLER = tuple(
    f"tests/talc/{name}.py" for name in ("test_control", "test_control_parts", "test_record", "learner/test_course")
)
MODULES: Mapping[str, Sequence[str]] = {
    "gateway.nc.slew": (f"{_NC}test_slew.py", f"{_NC}test_nine_errors.py"),
    "gateway.nc.target": (f"{_NC}test_target.py",),
    "gateway.nc.motion": (f"{_NC}test_motion.py",),
    "gateway.nc.unmodelled": (f"{_NC}test_unmodelled.py", f"{_NC}test_target.py"),
    "gateway.nc.hold": ("tests/gateway/probing/test_prober.py",),
    "gateway.nc.pace": (f"{_NC}test_pace.py",),
    "gateway.nc.lease": (f"{_NC}test_lease.py", *_LINK),
    "gateway.nc.states": _LINK,
    "gateway.nc.boundary": (f"{_NC}test_boundary.py",),
    "gateway.nc.writer": (*_LINK, f"{_NC}test_nine_errors.py", f"{_NC}test_form_changes.py"),
    "gateway.nc.link": (*_LINK, f"{_NC}test_nine_errors.py", f"{_NC}test_driver_bugs.py"),
    "gateway.storage.store": (*_STORE, "tests/gateway/past/test_earlier_run.py"),
    "gateway.storage.waiting": _STORE,
    "gateway.storage.writer": _STORE,
    "gateway.storage.rows": (*_STORE, "tests/gateway/past/test_restart.py", "tests/gateway/past/test_earlier_run.py"),
    "gateway.storage.readings": _STORE,
    "talc.control": _CONTROLLER,
    "talc.record": _CONTROLLER,
    "talc.stage": _CONTROLLER,
    "talc.learner.course": ("tests/talc/learner/test_course.py", "tests/talc/learner/test_reasons.py"),
}
"""For each module the tests that are to kill its mutants: quick ones, on simulated time."""
LOADED = (
    "numpy", "scipy.linalg", "scipy.optimize", "pytest", "_pytest.assertion.rewrite", "hypothesis", "pydantic",
    "asyncua", "gateway.config", "gateway.acquisition", "simulators.nc", "tests.benches.stepped_clock",
)  # fmt: skip
"""Modules that every mutant needs and that are not mutated."""
_OPTIONS = (
    "-q", "-x", "-m", "not slow and not realtime", "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-seed=0",
    "-W", "ignore::pytest.PytestAssertRewriteWarning",
)  # fmt: skip
_ENUMERATIONS = """
import enum, importlib, sys
print(*(name for name, each in vars(importlib.import_module(sys.argv[1])).items() if isinstance(each, enum.EnumType)))
"""
"""Prints the names that enumerations have in a module."""
_NOT_TRIED = 99
"""Exit code of a process that did not reach its tests."""
KILLED, SURVIVED, ENDLESS = "killed", "survived", "endless"


@dataclass(frozen=True, slots=True)
class MutantResult:
    """What became of a mutant, and which lines differ: text before, text after."""

    operator: str
    occurrence: int
    line: int
    outcome: str
    before: str
    after: str
    tests: str
    """Fingerprint of the tests that it was tried with."""
    by: str = ""
    """The test that killed it; empty: none, or not known."""


@dataclass(frozen=True, slots=True)
class ExplainedSurvivor:
    """One row of tests/surviving_mutants.toml; see there."""

    file: str
    before: str
    after: str
    reason: str


class _Loader(importlib.machinery.SourceFileLoader):
    """Loads a mutant in the place of its module, and leaves no byte code behind."""

    def __init__(self, name: str, path: str, source: str) -> None:
        super().__init__(name, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        return compile(self._source, self.get_filename(fullname), "exec")


class _Finder:
    """A finder of sys.meta_path that knows one module."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        self._name, self._path, self._source = name, path, source

    def find_spec(
        self, name: str, _: Sequence[str] | None = None, __: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name != self._name:
            return None
        return importlib.util.spec_from_file_location(
            name, self._path, loader=_Loader(name, str(self._path), self._source)
        )


def file_of(module: str) -> Path:
    """Where a module of this tree is."""
    return ROOT / Path(*module.split(".")).with_suffix(".py")


def made(module: str, tool: Path) -> list[Mutant]:
    """All mutants of a module that are another program. Raises subprocess.CalledProcessError."""
    program, source = Path(__file__).with_name("mutants_of.py"), file_of(module).read_text(encoding="utf-8")
    kept = OUT / f"{module}-{_mark(source.encode(), program.read_bytes())}.mutants"
    if not kept.exists():
        lines = subprocess.run([tool, program, file_of(module)], check=True, capture_output=True, text=True).stdout
        kept.write_text(lines, encoding="utf-8")
    found = [Mutant(**json.loads(line)) for line in kept.read_text(encoding="utf-8").splitlines()]
    told = subprocess.run([sys.executable, "-c", _ENUMERATIONS, module], check=True, capture_output=True, text=True)
    enumerations = told.stdout.split()
    single = ("Is_Eq", "IsNot_NotEq")
    return [
        mutant
        for mutant in found
        if is_another(source, mutant.source, enumerations if mutant.operator.endswith(single) else ())
    ]


def tested(module: str, source: str, tests: Sequence[str], cpu_s: float, wait_s: float) -> tuple[str, float]:
    """The outcome, and the processor time that it took, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    child = os.fork()
    if child == 0:
        _test(module, source, tests, cpu_s)
    status = waited(child, wait_s)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    took_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if status is None or os.WIFSIGNALED(status):
        return ENDLESS, took_s
    if os.WEXITSTATUS(status) == _NOT_TRIED:
        raise RuntimeError(f"{module}: a mutant could not be tried")
    return SURVIVED if os.WEXITSTATUS(status) == 0 else KILLED, took_s


def _test(module: str, source: str, tests: Sequence[str], cpu_s: float) -> None:
    """In the child; does not return."""
    code = _NOT_TRIED
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (round(cpu_s), round(cpu_s) + 5))
        _silence(0, 1, 2)
        sys.meta_path.insert(0, _Finder(module, file_of(module), source))
        code = int(pytest.main([*_OPTIONS, *tests]))
    finally:
        os._exit(code)


def changed(source: str, mutated: str) -> tuple[str, str]:
    """The lines that differ, each text without indentation."""
    lines = list(difflib.ndiff(source.splitlines(), mutated.splitlines()))
    before, after = ([line[2:].strip() for line in lines if line.startswith(sign)] for sign in ("- ", "+ "))
    return " ".join(before), " ".join(after)


def _mark(*contents: bytes) -> str:
    return hashlib.sha256(b"".join(contents)).hexdigest()[:16]


def _silence(*descriptors: int) -> None:
    silent = os.open(os.devnull, os.O_RDWR)
    for descriptor in descriptors:
        os.dup2(silent, descriptor)


def try_collected(
    module: str, mutants: Sequence[Mutant], end_s: float, told: Callable[[Mutant, str, str], None]
) -> None:
    """Try those that differ within functions, in a process that loads the module; `told` is called there with the
    outcome and the test that killed it. Raises RuntimeError."""
    file = file_of(module)

    def tried(mutant: Mutant, by: str, endless: bool) -> None:
        told(mutant, ENDLESS if endless else KILLED if by else SURVIVED, by)

    child = os.fork()
    if child == 0:
        code = _NOT_TRIED
        try:
            _silence(0, 1)
            plugin = CollectedTests(file, file.read_text(encoding="utf-8"), mutants, end_s, tried)
            with tempfile.TemporaryDirectory(prefix="mutation") as base:
                code = int(pytest.main([*_OPTIONS, "-s", f"--basetemp={base}/t", *MODULES[module]], plugins=[plugin]))
        except BaseException:  # noqa: BLE001 - the fork must not go on as its parent
            traceback.print_exc()
        finally:
            os._exit(code)
    if code := os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
        raise RuntimeError(f"{module}: its tests could not be collected, or a mutant not be tried ({code})")


def results(module: str, tool: Path, end_s: float, most: int | None) -> tuple[list[MutantResult], int]:
    """The results of earlier runs and of this one, which ends at that time; and how many mutants there are. With
    `most`, only of a random sample, the same each time.

    Raises RuntimeError: the tests do not pass, or the module is loaded already.
    """
    source, tests = file_of(module).read_text(encoding="utf-8"), MODULES[module]
    if module in sys.modules:
        raise RuntimeError(f"{module} is loaded already: take what imports it out of LOADED")
    with_tests = _mark(*((ROOT / test).read_bytes() for test in tests))
    file = OUT / f"{module}-{_mark(source.encode())}.jsonl"
    file.touch()

    def known() -> list[MutantResult]:
        # What was killed stays killed; with other tests, survivors are tried again.
        every = (MutantResult(**json.loads(line)) for line in file.read_text(encoding="utf-8").splitlines())
        return [each for each in every if each.outcome != SURVIVED or each.tests == with_tests]

    mutants = made(module, tool)
    asked = mutants if most is None else random.Random(module).sample(mutants, min(most, len(mutants)))

    def due() -> list[Mutant]:
        tried = {(each.operator, each.occurrence) for each in known()}
        return [mutant for mutant in asked if (mutant.operator, mutant.occurrence) not in tried]

    with file.open("a", encoding="utf-8", buffering=1) as out:

        def told(mutant: Mutant, outcome: str, by: str) -> None:
            lines = changed(source, mutant.source)
            result = MutantResult(mutant.operator, mutant.occurrence, mutant.line, outcome, *lines, with_tests, by)
            out.write(json.dumps(asdict(result), ensure_ascii=False) + "\n")

        if left := due():
            try_collected(module, left, end_s, told)
        if (left := due()) and time.monotonic() < end_s:
            began_s = time.monotonic()
            outcome, cpu_s = tested(module, source, tests, 600.0, 1800.0)
            if outcome != SURVIVED:
                raise RuntimeError(f"{module}: its tests do not pass without a mutation")
            cpu_s, wait_s = (TIMES * took for took in (cpu_s, time.monotonic() - began_s))
            for mutant in left:
                if time.monotonic() >= end_s:
                    break
                outcome, _ = tested(module, mutant.source, tests, max(cpu_s, LEAST_CPU_S), max(wait_s, LEAST_WAIT_S))
                told(mutant, outcome, "")
    places = {(mutant.operator, mutant.occurrence) for mutant in asked}
    return [each for each in known() if (each.operator, each.occurrence) in places], len(mutants)


def explained() -> list[ExplainedSurvivor]:
    """Every row of the table. Raises TypeError for a missing or an unknown field."""
    return [ExplainedSurvivor(**row) for row in tomllib.loads(REASONS.read_text(encoding="utf-8"))["survivor"]]


def unexplained(module: str, found: Sequence[MutantResult]) -> Iterator[MutantResult]:
    """Survivors without a reason."""
    file = str(file_of(module).relative_to(ROOT))
    known = {(each.before, each.after) for each in explained() if each.file == file}
    return (each for each in found if each.outcome == SURVIVED and (each.before, each.after) not in known)


def interval(hits: int, tries: int) -> tuple[float, float]:
    """Where a share lies with 95 % confidence, after Wilson (1927)."""
    z2 = 1.959964**2
    middle = (hits + z2 / 2) / (tries + z2)
    reach = math.sqrt(z2 * (hits * (tries - hits) / tries + z2 / 4)) / (tries + z2)
    return middle - reach, middle + reach


def row_of(module: str, found: Sequence[MutantResult], count: int) -> str:
    """One line of the table."""
    outcomes = Counter(each.outcome for each in found)
    killed = len(found) - outcomes[SURVIVED]
    share = f"{100.0 * killed / len(found):.1f} %" if found else "-"
    if 0 < len(found) < count:
        share += " ({:.0f} to {:.0f} %)".format(*(100.0 * bound for bound in interval(killed, len(found))))
    left = outcomes[SURVIVED] - len(list(unexplained(module, found)))
    return f"| `{module}` | {count} | {len(found)} | {killed} | {share} | {outcomes[SURVIVED]} | {left} |"


def main() -> int:
    """Exit code 1: a survivor without a reason, or mutants that were not tried."""
    options = argparse.ArgumentParser(description="Mutants of the safety-critical modules, and who kills them.")
    options.add_argument("modules", nargs="*", help=f"default: {' '.join(MODULES)}")
    options.add_argument("--tool", type=Path, default=OUT / "tool" / "bin" / "python", help="Python with cosmic-ray")
    options.add_argument("--minutes", type=float, default=float("inf"), help="end after this time")
    options.add_argument(
        "--sample", type=int, help="only this many mutants of each module, drawn at random, the same each time"
    )
    given = options.parse_args()
    end_s = time.monotonic() + 60.0 * given.minutes
    OUT.mkdir(parents=True, exist_ok=True)
    os.environ |= {
        "HYPOTHESIS_STORAGE_DIRECTORY": str(OUT / "hypothesis"),
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "",
    }
    os.chdir(ROOT)
    sys.dont_write_bytecode = False
    for name in LOADED:
        importlib.import_module(name)
    rows, left = [], []
    for module in given.modules or MODULES:
        found, count = results(module, given.tool, end_s, given.sample)
        rows.append(row_of(module, found, count))
        print(rows[-1], file=sys.stderr, flush=True)
        left += [f"{module}:{each.line}: {each.before}  →  {each.after}" for each in unexplained(module, found)]
        due = min(count, given.sample or count) - len(found)
        left += [f"{module}: {due} not tried"] if due else []
    heading = "| module | mutants | tried | killed | share | survived | of these with a reason |"
    print("\n".join([heading, "|---|---|---|---|---|---|---|", *rows, "", *left]))
    return bool(left)


if __name__ == "__main__":
    sys.exit(main())
