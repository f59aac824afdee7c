"""`talc-gateway db export-learnt` and `import-learnt`: what was learnt, to a file and into another database."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import click

from drivers.bounded_file import bytes_of
from drivers.error_words import in_words
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import past_of
from gateway.control.restart.rebuild import continued
from gateway.runtime.whole_file import write_whole
from gateway.storage.answers import answered
from gateway.storage.configurations import stored_config
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.imported import import_learnt
from gateway.storage.learnt import Learnt, Reference, learnt_text, parse_learnt
from talc.names import THERMAL_ERRORS

_MB = 1e6
_MOST_BYTES = 2**27


def export_learnt(database: Path, output: Path) -> str:
    """Write the file; returns what it holds, in words. Raises StoreError."""
    if output.exists() and output.samefile(database):
        raise click.UsageError(f"-o {output} would overwrite the database")
    with History(database) as history:
        config = stored_config(history)
        state = past_of(history, config).controller.state()
        first = history.reference()
    reference = None
    if first is not None and first.centres_mm is not None and first.errors is not None:
        reference = Reference(first.ended, first.centres_mm, first.in_force_um, first.errors)
    learnt = Learnt(config.machine.name, config.talc.method, config.grid.step_s, state, reference)
    write_whole(output, learnt_text(learnt))
    return f"{output}: {output.stat().st_size / _MB:.1f} MB; {learnt.machine}, {'; '.join(_contents(learnt))}"


def take(config: GatewayConfig, file: Path, *, replace: bool) -> Iterator[str]:
    """Import the file into the database of a configuration; says what was taken and what was not. Raises StoreError."""
    try:
        text = bytes_of(file, _MOST_BYTES).decode()
        learnt = parse_learnt(text)
        continued(learnt, config)
    except OSError as error:
        raise StoreError(f"{file}: {in_words(error)}") from None
    except ValueError as error:
        raise StoreError(f"{file}: {error}") from None
    path, now = config.storage.path, datetime.now(UTC)
    aside = answered(path, lambda: import_learnt(path, learnt, text, now, replace=replace))
    if aside is not None:
        yield f"{config.storage.path}: had a record; it is kept as {aside.name}"
    yield f"{config.storage.path}: taken from {learnt.machine}: {'; '.join(_contents(learnt))}"
    theirs, here = set(learnt.state.input_names), set(config.input_names)
    for label, names in (("not here, left out", theirs - here), ("new here, nothing is known of them", here - theirs)):
        if names:
            yield f"inputs {label}: {', '.join(sorted(names))}"
    lost = [m.error for m in learnt.state.models if m is not None and not set(m.inputs) <= here]
    if lost:
        yield f"models left out, because they use inputs that are not here: {', '.join(lost)}"
    yield "not imported: the record, and the times at which errors were measured; a measurement is wanted at once"


def _contents(learnt: Learnt) -> Iterator[str]:
    state = learnt.state
    yield f"{len(state.input_names)} inputs"
    if state.course is not None:
        counts = state.course.learner.mixture.count
        known = [f"{name} from {many}" for name, many in zip(THERMAL_ERRORS, counts, strict=True) if many]
        yield f"measurements of {', '.join(known)}" if known else "nothing was measured"
    else:
        models = [model.error for model in state.models if model is not None]
        yield f"models of {', '.join(models)}" if models else "no models"
    yield "no reference" if learnt.reference is None else f"reference of {learnt.reference.ended:%Y-%m-%d %H:%M} UTC"
