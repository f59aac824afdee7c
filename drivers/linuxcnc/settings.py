"""Settings of the connection to LinuxCNC's agent: address and shared key. No network."""

from dataclasses import dataclass
from pathlib import Path

from drivers.base import SetupError

DEFAULT_PORT = 7621
SHORTEST_KEY = 32
POSES = 6
"""As many as talc_poses.ngc has."""
LARGEST_UM = 500.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LinuxCncSettings:
    """One LinuxCNC. Raises SetupError naming the field that cannot be."""

    key_file: Path
    """Holds the key alone, the same as the agent's talc.key; readable by the service only."""
    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    timeout_s: float = 2.0
    """Longest wait for one answer."""
    poses: int = POSES
    request_valid_for_s: float = 900.0
    """A request that found no safe point within this time is refused; 0: never."""
    largest_um: float = LARGEST_UM
    """Offsets beyond are never sent; the agent has its own bound."""
    device: str = "nc"

    def __post_init__(self) -> None:
        if not self.host:
            raise SetupError("host is empty: expected a name or an address", device=self.device)
        if not 1 <= self.port <= 65535:
            raise SetupError(f"port = {self.port!r}: expected 1 to 65535", device=self.device)
        if not self.timeout_s > 0:
            raise SetupError(f"timeout_s = {self.timeout_s!r}: expected more than 0", device=self.device)
        if self.poses != POSES:
            raise SetupError(
                f"poses = {self.poses!r}: the probing program on the control has {POSES}",
                device=self.device,
                hint="ask for the poses of talc_poses.ngc",
            )

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
                hint="copy talc.key of the control",
            )
        return key
