"""Runs trainings outside the gateway's process, and returns an empty model set for one that failed."""

from gateway.apart import apart
from talc.frame import TrainingJob
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS
from talc.training import train

_FAILED = "the training failed: "


async def train_apart(job: TrainingJob) -> ModelSet:
    """The models of a job, trained in a separate process. Raises WorkError."""
    return await apart(train, job)


def models_of_failure(job: TrainingJob, error: Exception) -> ModelSet:
    """An empty model set, adopted instead of a failed training's models: the former ones stay."""
    note = f"{_FAILED}{error}; the models stay as they were"
    nothing = (None,) * len(THERMAL_ERRORS)
    return ModelSet(k=job.k, why=job.why.value, input_names=job.input_names, models=nothing, notes=(note,))


def has_failed(models: ModelSet) -> bool:
    """Whether these stand for a training that failed."""
    return any(note.startswith(_FAILED) for note in models.notes)
