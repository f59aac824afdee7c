"""Runs trainings outside the gateway's process, and makes an empty model set of one that failed."""

from gateway.apart import apart
from talc.frame import TrainingJob
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS
from talc.training import train

_FAILED = "the training failed: "


async def train_apart(job: TrainingJob) -> ModelSet:
    """The models of a job, from a process of its own. Raises WorkError."""
    return await apart(train, job)


def failed(job: TrainingJob, error: Exception) -> ModelSet:
    """What is adopted instead of the models of a training that failed: none, so that the former ones stay."""
    note = f"{_FAILED}{error}; the models stay as they were"
    nothing = (None,) * len(THERMAL_ERRORS)
    return ModelSet(k=job.k, why=job.why.value, input_names=job.input_names, models=nothing, notes=(note,))


def has_failed(models: ModelSet) -> bool:
    """Whether these are not a training's answer but stand for one that failed."""
    return any(note.startswith(_FAILED) for note in models.notes)
