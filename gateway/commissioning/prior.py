"""`talc-gateway prior make`: makes a file for `[talc] prior` from databases of gateways, or a collected site."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click
import numpy as np

from gateway.control.restart.rebuild import rebuilt, start_of
from gateway.runtime.extras import need_extra
from gateway.runtime.whole_file import write_whole
from gateway.storage.configurations import stored_config
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from talc.control import Controller
from talc.learner import LearnerState, make_prior
from talc.names import THERMAL_ERRORS

if TYPE_CHECKING:
    from gateway.listeners.collect.machines import CollectedMachine


class _LearntMachine(NamedTuple):
    """One machine, and how its learner is rebuilt."""

    name: str
    kind: str | None
    where: str
    rebuild: Callable[[], Controller]


def make(given: Sequence[Path | str], kind: str | None, output: Path, password_file: Path | None = None) -> None:
    """Rebuild each learner, print what it knows, and write the file.

    given: databases of gateways, and folders or addresses of PostgreSQL databases of `talc-gateway collect`
    kind: of the machines that count; None: there is only one
    password_file: holds the password of the addresses' user

    Raises StoreError if nothing was learnt, CollectError for a site that cannot be read, click.UsageError.
    """
    _check_given(given, output)
    sources = [source for place in given for source in _sources(place, password_file)]
    learnt, machines = [], dict[str, str]()
    for source in _of_kind(sources, kind):
        if source.name in machines:
            click.echo(
                f"warning: {source.where}: [machine] name '{source.name}' is also the name of {machines[source.name]}; "
                "a machine that counts twice makes the prior too sure",
                err=True,
            )
        machines.setdefault(source.name, source.where)
        learnt.append(_learnt(source))
    try:
        prior = make_prior(learnt)
    except ValueError as error:
        raise StoreError(f"{', '.join(map(str, given))}: {error}; let the gateways measure longer") from None
    write_whole(output, json.dumps(prior.to_dict(), separators=(",", ":")) + "\n")
    told = ", ".join(
        f"{name} from {int(many)}" for name, many in zip(THERMAL_ERRORS, prior.machines, strict=True) if many
    )
    click.echo(f'{output}: {len(prior.inputs)} inputs; {told}. In the next machine\'s file: [talc] prior = "{output}"')


def _check_given(given: Sequence[Path | str], output: Path) -> None:
    for i, place in enumerate(given):
        if any(_same(place, other) for other in given[:i]):
            raise click.UsageError(f"{place} is given twice")
        if isinstance(place, Path) and output.exists() and output.samefile(place):
            raise click.UsageError(f"-o {output} would overwrite a {'folder' if place.is_dir() else 'database'}")


def _same(one: Path | str, other: Path | str) -> bool:
    return one.samefile(other) if isinstance(one, Path) and isinstance(other, Path) else one == other


def _sources(path: Path | str, password_file: Path | None) -> list[_LearntMachine]:
    if isinstance(path, str):
        return _of_address(path, password_file)
    if not path.is_dir():
        with History(path) as history:
            machine = stored_config(history).machine
        return [_LearntMachine(machine.name, machine.kind, str(path), partial(_of_database, path))]
    need_extra("parquet")
    from gateway.listeners.collect.machines import machines_in

    return _collected(str(path), machines_in(path))


def _of_address(url: str, password_file: Path | None) -> list[_LearntMachine]:
    need_extra("postgres")
    from gateway.listeners.collect.database_machines import machines_in_database

    try:
        return _collected(url, machines_in_database(url, password_file))
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def _collected(where: str, machines: "Sequence[CollectedMachine]") -> list[_LearntMachine]:
    return [
        _LearntMachine(found.name, found.kind, f"{where}: {found.name}", partial(_of_collected, found))
        for found in machines
    ]


def _of_kind(sources: Sequence[_LearntMachine], kind: str | None) -> Sequence[_LearntMachine]:
    """Those that count. Raises click.UsageError if there is none, or if it is not said which of several kinds."""
    kinds = dict[str | None, list[str]]()
    for source in sources:
        kinds.setdefault(source.kind, []).append(source.name)
    told = "; ".join(f"{one or 'no kind'}: {', '.join(names)}" for one, names in kinds.items())
    if kind is None:
        if len(kinds) > 1:
            raise click.UsageError(f"the machines have different [machine] kind ({told}); choose one with --kind")
        return sources
    if kind not in kinds:
        raise click.UsageError(f"--kind {kind}: no machine has this [machine] kind ({told})")
    return [source for source in sources if source.kind == kind]


def _learnt(source: _LearntMachine) -> tuple[tuple[str, ...], LearnerState]:
    """What its learner knows after the whole record."""
    state = source.rebuild().state()
    if state.course is None:
        raise RuntimeError("the learner has no state")
    counts = state.course.learner.mixture.count
    click.echo(
        f"{source.where}: {source.name}, {len(state.input_names)} inputs, "
        f"{int(np.max(counts))} measurements of the error that was measured most, {int(np.min(counts))} of the least"
    )
    return state.input_names, state.course.learner


def _of_database(path: Path) -> Controller:
    with History(path) as history:
        config = stored_config(history).with_prior(None)
        config = config.model_copy(update={"talc": replace(config.talc, method="learner")})
        start = start_of(config, history)
        return rebuilt(history.steps(start.after_k, config.input_names), config, start).controller


def _of_collected(machine: "CollectedMachine") -> Controller:
    controller = Controller(machine.inputs, replace(machine.talc, method="learner"), machine.step_s)
    for frame in machine.frames():
        controller.step(frame)
    return controller
