"""What was stored with other inputs is matched by name, and a model stays only while it has all of its inputs."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.storage.placing import placed_step
from gateway.storage.stored import StoredStep
from talc.frame import Decision, Frame, Phase
from tests.benches.control_models import INPUTS, models


@pytest.mark.parametrize(("names", "stays"), [(("new", "warm"), True), (("new", "idle"), False)])
def test_a_model_without_one_of_its_inputs_is_left_out_and_values_keep_their_names(
    names: tuple[str, ...], stays: bool
) -> None:
    nine, adopted = np.zeros(9), models(7)
    decision = Decision(7, Phase.CALIBRATION, nine, nine, nine, nine, None, None, ())
    step = StoredStep(Frame(7, np.array([21.0, 22.0]), np.ones(2, np.bool_)), decision, None, (adopted,))
    placed = placed_step(step, INPUTS, names)
    (found,) = placed.adopted
    assert found.input_names == names
    assert [model is not None for model in found.models] == [stays] * 9
    assert placed.frame.inputs[1] == (22.0 if names[1] == "idle" else 21.0)
    assert np.isnan(placed.frame.inputs[0])
    assert list(placed.frame.valid) == [False, True]
    assert placed_step(replace(step, adopted=()), INPUTS, INPUTS).frame is step.frame
