"""`python -m tests.benches.mutation`: which mutants of the safety-critical modules do the tests kill?

cosmic-ray makes the mutants; it has an environment of its own, which `make mutation` creates. Each mutant runs the
module's tests in a process forked from this one, which has loaded the libraries already: a second each. The results are
in out/mutation/MODULE.jsonl; a run that was stopped continues, until the module changes. Prints a Markdown table, and
each survivor that tests/surviving_mutants.toml does not explain.
"""

import argparse
import difflib
import hashlib
import importlib
import importlib.machinery
import importlib.util
import json
import os
import resource
import signal
import subprocess
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import CodeType, ModuleType

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out" / "mutation"
REASONS = ROOT / "tests" / "surviving_mutants.toml"
_NC = "tests/gateway/nc/"
_LINK = (
    f"{_NC}test_nc_link.py", f"{_NC}test_nc_link_states.py", f"{_NC}test_nc_link_absent.py",
    f"{_NC}test_nc_link_elsewhere.py", f"{_NC}test_late_write.py",
)  # fmt: skip
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
    "gateway.nc.writer": _LINK,
    "gateway.nc.link": (*_LINK, f"{_NC}test_nine_errors.py", f"{_NC}test_driver_bugs.py"),
}
"""Of each module the tests that are to kill its mutants: quick ones, on simulated time."""
LOADED = (
    "numpy", "scipy.linalg", "scipy.optimize", "pytest", "_pytest.assertion.rewrite", "hypothesis", "pydantic",
    "asyncua", "gateway.config", "gateway.acquisition", "simulators.nc", "tests.benches.stepped_clock",
)  # fmt: skip
"""What every mutant needs and none of them is part of."""
LEAST_CPU_S, LEAST_WAIT_S, TIMES = 20, 120.0, 10
"""A mutant that takes ten times what the module does is one that does not end; and at least so long."""
_OPTIONS = (
    "-q", "-x", "-m", "not slow and not realtime", "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-seed=0",
    "-W", "ignore::pytest.PytestAssertRewriteWarning",
)  # fmt: skip
_NOT_TRIED = 99
"""Exit code of a process that did not come to its tests."""
KILLED, SURVIVED, ENDLESS = "killed", "survived", "endless"


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of a module; line counts from 1."""

    operator: str
    occurrence: int
    line: int
    source: str


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
    """All mutants of a module. Raises subprocess.CalledProcessError."""
    program = Path(__file__).with_name("mutants_of.py")
    lines = subprocess.run([tool, program, file_of(module)], check=True, capture_output=True, text=True).stdout
    return [Mutant(**json.loads(line)) for line in lines.splitlines()]


def tested(module: str, source: str, tests: Sequence[str], cpu_s: float, wait_s: float) -> tuple[str, float]:
    """The outcome, and the processor time that it took, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    child = os.fork()
    if child == 0:
        _test(module, source, tests, cpu_s)
    status = _waited(child, wait_s)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    took_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if status is None or os.WIFSIGNALED(status):
        return ENDLESS, took_s
    if os.WEXITSTATUS(status) == _NOT_TRIED:
        raise RuntimeError(f"{module}: a mutant could not be tried")
    return SURVIVED if os.WEXITSTATUS(status) == 0 else KILLED, took_s


def _waited(child: int, limit_s: float) -> int | None:
    """The exit status; None: ended after this time."""
    end_s, pause_s = time.monotonic() + limit_s, 0.005
    while time.monotonic() < end_s:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return status
        time.sleep(pause_s)
        pause_s = min(0.1, 1.5 * pause_s)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def _test(module: str, source: str, tests: Sequence[str], cpu_s: float) -> None:
    """In the child; does not return."""
    import pytest  # loaded already

    code = _NOT_TRIED
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (round(cpu_s), round(cpu_s) + 5))
        silent = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(silent, descriptor)
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


def results(module: str, tool: Path, end_s: float) -> tuple[list[MutantResult], int]:
    """Those of earlier runs and of this one, which ends at that time; and how many mutants there are.

    Raises RuntimeError: the tests do not pass, or the module is loaded already.
    """
    source, tests = file_of(module).read_text(encoding="utf-8"), MODULES[module]
    if module in sys.modules:
        raise RuntimeError(f"{module} is loaded already: take what imports it out of LOADED")
    with_tests = _mark(*((ROOT / test).read_bytes() for test in tests))
    file = OUT / f"{module}-{_mark(source.encode())}.jsonl"
    file.touch()
    earlier = [MutantResult(**json.loads(line)) for line in file.read_text(encoding="utf-8").splitlines()]
    # What was killed stays killed; with other tests, survivors are tried again.
    found = [each for each in earlier if each.outcome != SURVIVED or each.tests == with_tests]
    known, mutants = {(each.operator, each.occurrence) for each in found}, made(module, tool)
    due = [mutant for mutant in mutants if (mutant.operator, mutant.occurrence) not in known]
    if due and time.monotonic() < end_s:
        began_s = time.monotonic()
        outcome, cpu_s = tested(module, source, tests, 600.0, 1800.0)
        if outcome != SURVIVED:
            raise RuntimeError(f"{module}: its tests do not pass without a mutation")
        cpu_s, wait_s = (TIMES * took for took in (cpu_s, time.monotonic() - began_s))
        with file.open("a", encoding="utf-8", buffering=1) as out:
            for mutant in due:
                if time.monotonic() >= end_s:
                    break
                outcome, _ = tested(module, mutant.source, tests, max(cpu_s, LEAST_CPU_S), max(wait_s, LEAST_WAIT_S))
                result = MutantResult(
                    mutant.operator,
                    mutant.occurrence,
                    mutant.line,
                    outcome,
                    *changed(source, mutant.source),
                    with_tests,
                )
                out.write(json.dumps(asdict(result), ensure_ascii=False) + "\n")
                found.append(result)
    return found, len(mutants)


def explained() -> list[ExplainedSurvivor]:
    """Every row of the table. Raises TypeError for a missing or an unknown field."""
    return [ExplainedSurvivor(**row) for row in tomllib.loads(REASONS.read_text(encoding="utf-8"))["survivor"]]


def unexplained(module: str, found: Sequence[MutantResult]) -> Iterator[MutantResult]:
    """Survivors without a reason."""
    file = str(file_of(module).relative_to(ROOT))
    known = {(each.before, each.after) for each in explained() if each.file == file}
    return (each for each in found if each.outcome == SURVIVED and (each.before, each.after) not in known)


def row_of(module: str, found: Sequence[MutantResult], count: int) -> str:
    """One line of the table."""
    outcomes = Counter(each.outcome for each in found)
    killed = len(found) - outcomes[SURVIVED]
    share = f"{100.0 * killed / len(found):.1f} %" if found else "-"
    left = outcomes[SURVIVED] - len(list(unexplained(module, found)))
    return f"| `{module}` | {count} | {len(found)} | {killed} | {share} | {outcomes[SURVIVED]} | {left} |"


def main() -> int:
    """Exit code 1: a survivor without a reason, or mutants that were not tried."""
    options = argparse.ArgumentParser(description="Mutants of the safety-critical modules, and who kills them.")
    options.add_argument("modules", nargs="*", help=f"default: {' '.join(MODULES)}")
    options.add_argument("--tool", type=Path, default=OUT / "tool" / "bin" / "python", help="Python with cosmic-ray")
    options.add_argument("--minutes", type=float, default=float("inf"), help="end after this time")
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
        found, count = results(module, given.tool, end_s)
        rows.append(row_of(module, found, count))
        print(rows[-1], file=sys.stderr, flush=True)
        left += [f"{module}:{each.line}: {each.before}  →  {each.after}" for each in unexplained(module, found)]
        left += [f"{module}: {count - len(found)} not tried"] if len(found) < count else []
    heading = "| module | mutants | tried | killed | share | survived | of these with a reason |"
    print("\n".join([heading, "|---|---|---|---|---|---|---|", *rows, "", *left]))
    return bool(left)


if __name__ == "__main__":
    sys.exit(main())
