"""Settings of the connection to LinuxCNC's agent: address and shared key. No network."""

from typing import Self

from pydantic import model_validator

from drivers.base import SetupError
from drivers.section import FilePath, NotEmpty, NotNegative, Port, Positive, Section

DEFAULT_PORT = 7621
SHORTEST_KEY = 32
POSES = 6
"""Number of poses in talc_poses.ngc."""
LARGEST_UM = 500.0


class LinuxCncAgent(Section):
    """Where to find the agent of deploy/nc/linuxcnc."""

    host: NotEmpty = "127.0.0.1"
    """Host of the agent. If it is another computer, use a tunnel: lines are signed but not encrypted."""
    port: Port = DEFAULT_PORT
    """The agent's port."""
    key_file: FilePath
    """File with the key shared with the agent: a copy of its talc.key."""
    timeout_s: Positive = 2.0
    """How long one answer may take."""


class LinuxCncSettings(LinuxCncAgent):
    """Settings of one LinuxCNC control."""

    poses: int = POSES
    """Number of poses that one probing cycle touches."""
    request_valid_for_s: NotNegative = 900.0
    """A request that reaches no safe point within this time is refused; 0: never."""
    largest_um: Positive = LARGEST_UM
    """Larger offsets are never sent; the agent also has its own bound."""
    device: str = "nc"
    """Name in messages."""

    @model_validator(mode="after")
    def _as_on_the_control(self) -> Self:
        if self.poses != POSES:
            raise SetupError(
                f"poses = {self.poses!r}: the probing program on the control has {POSES}",
                hint="use the poses of talc_poses.ngc",
            )
        return self

    def key(self) -> bytes:
        """Raises SetupError when the file cannot be read or is too short to be a key."""
        try:
            key = self.key_file.read_bytes().strip()
        except OSError as error:
            raise SetupError(f"key_file = {str(self.key_file)!r}: {error.strerror}", device=self.device) from error
        if len(key) < SHORTEST_KEY:
            raise SetupError(
                f"key_file = {str(self.key_file)!r} holds {len(key)} characters: expected at least {SHORTEST_KEY}",
                device=self.device,
                hint="copy talc.key from the control",
            )
        return key
