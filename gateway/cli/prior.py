"""`talc-gateway prior make`: from databases of gateways to a file for `[talc] prior`."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from gateway.past import stored_config
from gateway.rebuild import Rebuilt, rebuilt, start_of
from gateway.storage import History, StoreError
from talc.learner import LearnerState, make_prior
from talc.names import THERMAL_ERRORS

_Learnt = tuple[tuple[str, ...], LearnerState]


def make(databases: Sequence[Path], output: Path) -> None:
    """Rebuild each learner, print what it knows, and write the file. Raises StoreError if nothing was learnt."""
    _check_files(databases, output)
    learnt, machines = [], dict[str, Path]()
    for database in databases:
        name, found = _learnt(database)
        if name in machines:
            click.echo(
                f"warning: {database}: [machine] name '{name}' is that of {machines[name]} too; a machine that counts "
                "twice makes the prior too sure",
                err=True,
            )
        machines.setdefault(name, database)
        learnt.append(found)
    try:
        prior = make_prior(learnt)
    except ValueError as error:
        raise StoreError(f"{', '.join(map(str, databases))}: {error}; let the gateways measure longer") from None
    part = output.with_name(output.name + ".part")
    try:
        part.write_text(json.dumps(prior.to_dict(), separators=(",", ":")) + "\n", encoding="utf-8")
        part.replace(output)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    told = ", ".join(
        f"{name} from {int(many)}" for name, many in zip(THERMAL_ERRORS, prior.machines, strict=True) if many
    )
    click.echo(f'{output}: {len(prior.inputs)} inputs; {told}. In the next machine\'s file: [talc] prior = "{output}"')


def _check_files(databases: Sequence[Path], output: Path) -> None:
    for i, database in enumerate(databases):
        for other in databases[:i]:
            if database.samefile(other):
                raise click.UsageError(f"{database} is given twice")
        if output.exists() and output.samefile(database):
            raise click.UsageError(f"-o {output} would overwrite a database")


def _learnt(database: Path) -> tuple[str, _Learnt]:
    """Name of the machine, and what its learner knows after the whole record."""
    with History(database) as history:
        config = stored_config(history).with_prior(None)
        config = config.model_copy(update={"talc": replace(config.talc, method="learner")})
        controller = rebuilt(history.steps(), config, Rebuilt(start_of(config, history.learnt()))).controller
    state = controller.state()
    if state.course is None:
        raise RuntimeError("the learner has no state")
    counts = state.course.learner.mixture.count
    click.echo(
        f"{database}: {config.machine.name}, {len(state.input_names)} inputs, "
        f"{int(np.max(counts))} measurements of the error that was measured most, {int(np.min(counts))} of the least"
    )
    return config.machine.name, (state.input_names, state.course.learner)
