"""Profiles of the values that a control has and its agent reports: which of them are channels."""

from functools import cached_property
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from drivers.profile import DeviceProfile, LinearValue
from drivers.section import Positive, matching, wrong
from drivers.text import Text

ValueName = Annotated[str, Field(max_length=200), matching(r"[!-~]+", "a_name_ascii")]
"""As the control has it; on LinuxCNC the name of a HAL pin, signal or parameter."""


class AgentValue(LinearValue):
    """One channel: value = number * scale + offset."""

    name: ValueName
    """Name of the value, as the control has it; on LinuxCNC the name of a HAL pin, signal or parameter."""
    valid: ValueName | None = None
    """A value that is TRUE (not 0) while this one is right; otherwise it is a `sensor_fault`."""
    error: ValueName | None = None
    """A value that is FALSE (0) while this one is right; otherwise it is a `sensor_fault`."""
    alive: ValueName | None = None
    """A value that changes as long as the source of this one lives, such as its counter of readings; `max_age_s` after
    its last change this one is `stale`. It may be the value itself."""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Every name that the channel needs, its own first."""
        return (self.name, *(name for name in (self.valid, self.error, self.alive) if name is not None))


class AgentProfile(DeviceProfile):
    """Values of a control with an agent."""

    buses: ClassVar[tuple[str, ...]] = ("agent",)

    protocol: Literal["agent"]
    """`agent`."""
    max_age_s: Positive | None = None
    """How long an `alive` value may stay the same; at least three periods of the bus."""
    values: tuple[AgentValue, ...] = Field(alias="value", min_length=1)

    @model_validator(mode="after")
    def _aged(self) -> Self:
        for i, value in enumerate(self.values):
            if value.alive is not None and self.max_age_s is None:
                raise wrong(Text("agent_alive_alone"), "value", i, "alive")
        return self

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.values)
