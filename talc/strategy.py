"""The interface of everything that learns and corrects: the learner, the papers' models, measure-and-hold."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from talc.explanation import Explanation, Reasons, Weights
from talc.forecast import Forecast, PlannedForecast
from talc.frame import BoolArray, Decision, Event, FloatArray, Frame, Phase
from talc.models import ModelSet


class Strategy(ABC):
    """How thermal errors are learnt and corrected; a pure function of the frames that it has taken.

    `Controller` checks the frames and keeps the record; whatever is decided is decided here. Only `phase`, `step` and
    the state are needed. The other methods answer that a strategy has nothing of the kind.
    """

    method: ClassVar[str]
    """Its name, in messages and in `[talc] method`."""
    state_class: ClassVar[type]
    """Of what `state` returns."""

    @property
    @abstractmethod
    def phase(self) -> Phase:
        """The present one."""

    @abstractmethod
    def step(self, frame: Frame, measured: FloatArray) -> Decision:
        """Take one frame; measured: (9,) its errors without impossible ones, NaN where nothing was measured."""

    @abstractmethod
    def state(self) -> Any:
        """All that is known, as a frozen value, copied: later steps do not change it."""

    @abstractmethod
    def restore(self, state: Any) -> None:
        """Continue from a state as if nothing had happened. ValueError: it is not of this strategy or these inputs."""

    def miss(self, inputs: FloatArray) -> None:  # noqa: B027 - most keep nothing that runs between frames
        """A step without a frame, between two frames; inputs: (n,) the last ones, held."""

    @property
    def learning(self) -> bool:
        """Whether a training was requested, and nothing has been adopted since."""
        return False

    def adopt(self, models: ModelSet) -> tuple[Event, ...]:  # noqa: ARG002
        """Adopt what a training has found. ValueError: the models do not fit, or are not wanted."""
        raise ValueError(f"method = {self.method!r}: it takes no models")

    def between(self, inputs: FloatArray, valid: BoolArray, steps: float) -> FloatArray | None:  # noqa: ARG002
        """(9,) the correction this many steps after the last frame, > 0, with the (n,) inputs of that moment: means
        over one step, as a frame has them. Changes nothing. None: only defined on the grid, or no frame yet."""
        return None

    def explain(self) -> Explanation | None:
        """Why the present estimates are what they are."""
        return None

    def weights(self) -> Weights | None:
        """What is known of how the errors follow the inputs."""
        return None

    def reasons(self) -> Reasons | None:
        """The same for people, with what is expected at the next measurement. Takes as long as a few steps."""
        return None

    def forecast(self, steps: Sequence[int]) -> Forecast | None:  # noqa: ARG002
        """The estimates for each of these numbers of steps ahead. Takes as long as a few steps."""
        return None

    def along(self, changes: FloatArray, steps: Sequence[int]) -> PlannedForecast:  # noqa: ARG002
        """The estimates for each of these numbers of steps ahead, if the inputs differ from the last frame's by (T, n)
        at each of the next T steps. ValueError: there are no forecasts."""
        raise ValueError(f"the method {self.method} makes no forecasts")
