"""Places stored values among the inputs of another configuration, matched by name."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gateway.storage.stored import StoredStep
from talc.frame import BoolArray, FloatArray, Frames
from talc.models import ModelSet


def placed_frames(frames: Frames, own: Sequence[str] | None, names: Sequence[str]) -> Frames:
    """Frames among the inputs `names`, from `own`. An input that they do not have has no value.

    own: None or empty if it is not known; the inputs are then taken for those wanted
    """
    if not own or tuple(own) == tuple(names):
        return frames
    inputs, valid = _placed(frames.inputs, frames.valid, own, names)
    return replace(frames, inputs=inputs, valid=valid)


def placed_step(step: StoredStep, own: Sequence[str] | None, names: Sequence[str]) -> StoredStep:
    """The same of a step. A model whose inputs are not all among `names` is left out."""
    if not own or tuple(own) == tuple(names):
        return step
    frame = step.frame
    inputs, valid = _placed(frame.inputs, frame.valid, own, names)
    models = tuple(_placed_models(adopted, names) for adopted in step.adopted)
    return replace(step, frame=replace(frame, inputs=inputs, valid=valid), adopted=models)


def _placed(
    inputs: FloatArray, valid: BoolArray, own: Sequence[str], names: Sequence[str]
) -> tuple[FloatArray, BoolArray]:
    """(..., n) values and mask among other names."""
    to = [i for i, name in enumerate(names) if name in own]
    here = [own.index(names[i]) for i in to]
    shape = (*inputs.shape[:-1], len(names))
    placed, mask = np.full(shape, np.nan), np.zeros(shape, dtype=np.bool_)
    placed[..., to], mask[..., to] = inputs[..., here], valid[..., here]
    return placed, mask


def _placed_models(models: ModelSet, names: Sequence[str]) -> ModelSet:
    kept = tuple(None if m is None or not set(m.inputs) <= set(names) else m for m in models.models)
    return replace(models, input_names=tuple(names), models=kept)
