"""What every study shares: runs keyed by their parameters, done once, in parallel, kept as one JSON file each."""

import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from typing import Any

import simulators
import talc
from simulators.studies.page import Origin, Report, write
from talc import _kernel

Parameters = Mapping[str, Any]
"""JSON-able; says all that a run depends on, its seed included."""
_PHYSICS = ("plant", "cases", "three_body")
"""Packages of the simulators that studies rest on."""


@dataclass(frozen=True, slots=True)
class Run:
    """One finished run."""

    parameters: Parameters
    result: Mapping[str, Any]
    """JSON-able; None stands for a figure that does not exist."""


@dataclass(frozen=True, slots=True)
class Study:
    """A question, as runs that do not depend on each other, and a report on them."""

    name: str
    summary: str
    """One line."""
    runs: Callable[[int, bool], list[Parameters]]
    """From a seed, and whether the small version is wanted."""
    run: Callable[[Parameters], Mapping[str, Any]]
    """A function of a module, so that other processes find it; the same parameters give the same result."""
    report: Callable[[list[Run]], Report]


@cache
def code_fingerprint(module: str) -> str:
    """SHA-256 over the code that the results of a study's module rest on, in hexadecimal; not over how they are shown.

    That is talc with its compiled kernel, the simulated physics, the module itself and the control's loop.
    """
    digest = hashlib.sha256()
    own = Path(str(simulators.__file__)).parent
    roots = [Path(str(talc.__file__)).parent, *(own / name for name in _PHYSICS)]
    sources = [Path(str(_kernel.__file__)), own / "studies" / "loop.py", Path(str(sys.modules[module].__file__))]
    for root in roots:
        sources += sorted(p for p in root.rglob("*") if p.suffix in {".py", ".json", ".toml"})
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()


def key(study: Study, parameters: Parameters) -> str:
    """Name of a run's file: another study, parameter or version of the code is another run."""
    code = code_fingerprint(study.run.__module__)
    canonical = json.dumps([study.name, code, parameters], sort_keys=True, allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()[:20]


def carry_out(study: Study, folder: Path, seed: int, small: bool, workers: int) -> Iterator[tuple[int, int]]:
    """Do what is not done yet, then write the report. Yields (runs done, runs in all), first with what was there.

    A study that was stopped goes on where it was. ValueError: no worker. An exception of a run ends the study.
    """
    if workers < 1:
        raise ValueError(f"workers = {workers}: expected 1 or more")
    wanted = study.runs(seed, small)
    kept = folder / "runs"
    kept.mkdir(parents=True, exist_ok=True)
    files = [kept / f"{key(study, parameters)}.json" for parameters in wanted]
    results = {file: result for file in files if (result := _stored(file)) is not None}
    yield len(results), len(wanted)
    missing = [(file, p) for file, p in zip(files, wanted, strict=True) if file not in results]
    if missing:
        # Spawned, not forked: the caller's progress bar has threads.
        context = get_context("spawn")
        pool = ProcessPoolExecutor(min(workers, len(missing)), mp_context=context, initializer=_end_with_parent)
        try:
            futures = {pool.submit(study.run, p): (file, p) for file, p in missing}
            for future in as_completed(futures):
                file, parameters = futures[future]
                results[file] = future.result()
                _keep(file, {"study": study.name, "parameters": parameters, "result": results[file]})
                yield len(results), len(wanted)
        finally:
            pool.shutdown(cancel_futures=True)
    runs = [Run(p, results[file]) for file, p in zip(files, wanted, strict=True)]
    write(folder, study.summary, study.report(runs), _origin(study, len(runs), seed, small))


def _end_with_parent() -> None:
    """A worker whose study was terminated would else go on with its run, for a minute or two."""
    parent = parent_process()
    if parent is not None:
        Thread(target=_exit_after, args=[parent], daemon=True).start()


def _exit_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _stored(file: Path) -> Mapping[str, Any] | None:
    try:
        result: Mapping[str, Any] = json.loads(file.read_text(encoding="utf-8"))["result"]
    except (FileNotFoundError, json.JSONDecodeError):
        return None  # cut short by a power failure: done again
    return result


def _keep(file: Path, content: Mapping[str, Any]) -> None:
    part = file.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    part.replace(file)


def _origin(study: Study, runs: int, seed: int, small: bool) -> Origin:
    packages = ", ".join(f"{p} {version(p)}" for p in ("talc-gateway", "numpy", "scipy", "osqp"))
    return Origin(
        runs=runs,
        seed=seed,
        versions=f"{packages}; code {code_fingerprint(study.run.__module__)[:16]}",
        again=f"talc-gateway study {study.name} --seed {seed}" + (" --small" if small else ""),
        date=f"{datetime.now(UTC):%Y-%m-%d}",
    )
