"""The settings that are specific to LinuxCNC: the poses of its probing program. No network."""

from typing import Final, Self

from pydantic import model_validator

from drivers.agent.settings import AgentSettings
from drivers.base import SetupError
from drivers.text import Text

POSES = 6
"""Number of poses in talc_poses.ngc."""
ANALOG_OUTPUTS: Final = tuple(f"analog_output_{n}" for n in range(4))
"""States that a part program sets: M68 E0 Q3 makes the first one 3."""


class LinuxCncSettings(AgentSettings):
    """Settings of one LinuxCNC control, with the agent of deploy/nc/linuxcnc."""

    @model_validator(mode="after")
    def _as_on_the_control(self) -> Self:
        if self.poses != POSES:
            raise SetupError(
                Text("linuxcnc_poses", poses=self.poses, known=POSES),
                field=("poses",),
                hint=Text("linuxcnc_use_poses"),
            )
        return self
