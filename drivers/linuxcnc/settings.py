"""The settings that are specific to LinuxCNC: the poses of its probing program. No network."""

from typing import Self

from pydantic import model_validator

from drivers.agent.settings import AgentSettings
from drivers.base import SetupError

POSES = 6
"""Number of poses in talc_poses.ngc."""


class LinuxCncSettings(AgentSettings):
    """Settings of one LinuxCNC control, with the agent of deploy/nc/linuxcnc."""

    @model_validator(mode="after")
    def _as_on_the_control(self) -> Self:
        if self.poses != POSES:
            raise SetupError(
                f"poses = {self.poses!r}: the probing program on the control has {POSES}",
                hint="use the poses of talc_poses.ngc",
            )
        return self
