"""Learns the model of the sensors in the process of the test, and notes what it was given."""

from collections.abc import Callable, Sequence

from talc.frame import BoolArray, FloatArray
from talc.sensor_model import SensorModel, learn
from talc.settings import SensorCheckSettings

SensorLearning = Callable[
    [Sequence[str], FloatArray, BoolArray, SensorCheckSettings, Sequence[str], float], SensorModel | None
]


class SensorTeacher:
    """In place of the separate process that learns.

    learning: what makes the model, `talc.sensor_model.learn` or a defect of it
    """

    def __init__(self, learning: SensorLearning = learn) -> None:
        self._learning = learning
        self.names: list[tuple[str, ...]] = []
        self.rows: list[int] = []
        self.steps_s: list[float] = []

    async def __call__(
        self,
        names: Sequence[str],
        inputs: FloatArray,
        valid: BoolArray,
        settings: SensorCheckSettings,
        loads: Sequence[str],
        step_s: float,
    ) -> SensorModel | None:
        self.names.append(tuple(names))
        self.rows.append(len(inputs))
        self.steps_s.append(step_s)
        return self._learning(names, inputs, valid, settings, loads, step_s)


def nothing_learnt(*_: object) -> None:
    """As if the rows were not enough for a model."""
