"""The runs of a study: identified by their parameters, done once, in parallel, and kept as one JSON file each."""

import ast
import hashlib
import io
import json
import os
import sys
import time
import tokenize
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from typing import Any

import simulators
import talc
from studies.page import Origin, Report
from studies.published import write_report

RunParameters = Mapping[str, Any]
"""JSON-able; contains everything that a run depends on, including its seed."""
Only = Mapping[str, Sequence[str]]
"""For each parameter, its values in the wanted runs, as text."""
_DATA = {".json", ".toml"}
_LEARNER = ("learner", "kernel/learner.hpp")
"""The part of talc that only the learner uses."""


@dataclass(frozen=True, slots=True)
class Run:
    """One finished run."""

    parameters: RunParameters
    result: Mapping[str, Any]
    """JSON-able; None stands for a missing figure."""
    seconds: float | None = None
    """Processor time that it took, if that was kept."""


@dataclass(frozen=True, slots=True)
class Study:
    """A question, as independent runs, and a report on them."""

    name: str
    summary: str
    """One line."""
    runs: Callable[[int, bool], list[RunParameters]]
    """Called with a seed, and whether the small version is wanted."""
    run: Callable[[RunParameters], Mapping[str, Any]]
    """A function of a module, so that other processes find it; the same parameters give the same result."""
    report: Callable[[list[Run]], Report]
    then: Callable[[list[Run]], list[RunParameters]] | None = None
    """Runs that depend on the results of the first ones, such as the chosen parameters with other seeds."""
    learns: Callable[[RunParameters], bool] | None = None
    """Whether a run uses the learner; None: any may. The others are not done again when only the learner changed."""


@cache
def code_fingerprint(module: str, learner: bool = True) -> str:
    """SHA-256, hexadecimal, over the code that determines a study's results; not over how they are shown.

    That is the module itself, the control's loop, and what they import of talc, with its kernel, and of the simulated
    physics, with its data; without `learner` all of this except what only the learner uses. Comments, docstrings and
    empty lines of Python files do not count. In other files, such as the kernel's sources, every byte counts.
    """
    science, physics = Path(str(talc.__file__)).parent, Path(str(simulators.__file__)).parent
    beginnings = {Path(str(sys.modules[module].__file__))}
    beginnings |= {Path(__file__).with_name(name) for name in ("loop.py", "lockstep.py")}
    sources, new = set(beginnings), beginnings
    while new := {found for source in new for found in _imported(source, science, physics)} - sources:
        sources |= new
    for folder in {source.parent for source in sources if source.is_relative_to(physics)} - {physics}:
        sources |= {found for found in folder.rglob("*") if found.suffix in _DATA}
    sources |= {*science.glob("kernel/*.cpp"), *science.glob("kernel/*.hpp")}
    digest = hashlib.sha256()
    for source in sorted(sources, key=lambda path: (path.name, path)):
        if learner or not any(source.is_relative_to(science / part) for part in _LEARNER):
            digest.update(_without_prose(source.read_bytes()) if source.suffix == ".py" else source.read_bytes())
    return digest.hexdigest()


def _imported(source: Path, science: Path, physics: Path) -> Iterator[Path]:
    """Modules of talc and of the simulators that a module imports, packages on the way included. What talc offers by
    itself it imports only when it is asked for."""
    if source == science / "__init__.py":
        return
    tree = ast.parse(source.read_bytes())
    for_types = {id(node) for block in ast.walk(tree) if _is_for_types(block) for node in ast.walk(block)}
    for node in ast.walk(tree):
        names: list[str] = []
        if id(node) in for_types:
            continue
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            root, *parts = name.split(".")
            folder = {"talc": science, "simulators": physics}.get(root)
            if folder is None:
                continue
            for part in ("", *parts):
                folder /= part
                yield from (path for path in (folder / "__init__.py", folder.with_suffix(".py")) if path.is_file())


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


@cache
def _without_prose(source: bytes) -> bytes:
    """The lines of Python source without comments and docstrings, those of constants and fields included, and without
    empty lines. Not the syntax tree written out again: its text depends on the version of Python."""
    text = source.decode()
    statements = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Expr))
    strings = [node for node in statements if isinstance(getattr(node.value, "value", None), str)]
    prose = {number for node in strings for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    comments = dict(token.start for token in tokens if token.type == tokenize.COMMENT)
    lines = (line[: comments.get(at)].rstrip() for at, line in enumerate(text.split("\n"), 1) if at not in prose)
    return "\n".join(line for line in lines if line).encode()


def key(study: Study, parameters: RunParameters) -> str:
    """Name of a run's file: another study, parameter or version of the code is another run."""
    learner = study.learns is None or study.learns(parameters)
    code = code_fingerprint(study.run.__module__, learner)
    canonical = json.dumps([study.name, code, parameters], sort_keys=True, allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()[:20]


def carry_out(
    study: Study, folder: Path, seed: int, small: bool, workers: int, only: Only | None = None
) -> Iterator[tuple[int, int]]:
    """Do the missing runs, then write the report. Yields (runs done, all runs), first for the runs already there.

    A study that was stopped continues where it was. ValueError: no worker; `only` names a parameter or a value that no
    run has. An exception of a run ends the study.
    """
    if workers < 1:
        raise ValueError(f"workers = {workers}: expected 1 or more")
    only = only or {}
    wanted = chosen(study.runs(seed, small), only)
    kept = folder / "runs"
    kept.mkdir(parents=True, exist_ok=True)
    runs = yield from _do(study, kept, wanted, workers, 0)
    if study.then is not None:
        runs += yield from _do(study, kept, study.then(runs), workers, len(runs))
    again = f"python -m studies {study.name} --seed {seed}" + (" --small" if small else "")
    again += "".join(f" --only {name}={','.join(values)}" for name, values in only.items())
    write_report(folder, study.summary, study.report(runs), _origin(study, runs, again, workers))


def chosen(runs: list[RunParameters], only: Only) -> list[RunParameters]:
    """The runs that have one of the values of each parameter in `only`, or lack that parameter.

    ValueError: no run has the parameter or the value.
    """
    for name, values in only.items():
        there = list(dict.fromkeys(str(run[name]) for run in runs if name in run))
        unknown = [value for value in values if value not in there]
        if not there:
            raise ValueError(
                f"{name}: no run has it; expected one of {', '.join(dict.fromkeys(n for r in runs for n in r))}"
            )
        if unknown:
            raise ValueError(f"{name}={','.join(unknown)}: expected of {', '.join(there)}")
        runs = [run for run in runs if name not in run or str(run[name]) in values]
    return runs


def _do(
    study: Study, kept: Path, wanted: list[RunParameters], workers: int, before: int
) -> Generator[tuple[int, int], None, list[Run]]:
    """Do the runs that `kept` lacks, in parallel; `before` runs are done already. Returns all wanted runs."""
    files = [kept / f"{key(study, parameters)}.json" for parameters in wanted]
    runs = {file: run for file in files if (run := _stored(file)) is not None}
    yield before + len(runs), before + len(wanted)
    missing = [(file, p) for file, p in zip(files, wanted, strict=True) if file not in runs]
    if missing:
        # Spawned, not forked: the caller's progress bar has threads.
        context = get_context("spawn")
        pool = ProcessPoolExecutor(min(workers, len(missing)), mp_context=context, initializer=_end_with_parent)
        try:
            futures = {pool.submit(_timed, study.run, p): file for file, p in missing}
            for future in as_completed(futures):
                file = futures[future]
                runs[file] = run = future.result()
                content = {"parameters": run.parameters, "result": run.result, "seconds": run.seconds}
                _keep(file, {"study": study.name, **content})
                yield before + len(runs), before + len(wanted)
        finally:
            pool.shutdown(cancel_futures=True)
    return [runs[file] for file in files]


def _timed(run: Callable[[RunParameters], Mapping[str, Any]], parameters: RunParameters) -> Run:
    begin = time.process_time()
    result = run(parameters)
    return Run(parameters, result, round(time.process_time() - begin, 2))


def _end_with_parent() -> None:
    """End this worker with its parent. Otherwise it would continue its run for a minute or two."""
    parent = parent_process()
    if parent is not None:
        Thread(target=_exit_after, args=[parent], daemon=True).start()


def _exit_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _stored(file: Path) -> Run | None:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return Run(content["parameters"], content["result"], content.get("seconds"))
    except (FileNotFoundError, json.JSONDecodeError):
        return None  # cut short by a power failure: done again


def _keep(file: Path, content: Mapping[str, Any]) -> None:
    part = file.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    part.replace(file)


def _origin(study: Study, runs: list[Run], again: str, workers: int) -> Origin:
    packages = ", ".join(f"{p} {version(p)}" for p in ("talc-gateway", "numpy", "scipy", "osqp"))
    return Origin(
        runs=len(runs),
        seed=runs[0].parameters["seed"],
        versions=packages,
        code=code_fingerprint(study.run.__module__)[:8],
        took=_took(runs, workers),
        again=again,
    )


def _took(runs: list[Run], workers: int) -> str:
    """The processor time of all runs divided among the workers, even over several sessions. An idle computer takes as
    long; beside other programs it is longer."""
    known = [run.seconds for run in runs if run.seconds is not None]
    if len(known) < len(runs):
        return "time not kept"
    return f"{sum(known) / workers / 60:.1f} min on {workers} {'core' if workers == 1 else 'cores'}"
