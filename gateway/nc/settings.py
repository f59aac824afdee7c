"""The input of a link to one control: its settings, what an earlier run left, and its listeners."""

import zlib
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field

from drivers.nc import LARGEST_NUMBER
from gateway.config.controls import LinuxCncNc, SinumerikNc
from gateway.config.model import GatewayConfig
from gateway.config.sections import Compensation, Probing
from gateway.model.commands import Disarmed, Pause
from gateway.model.compensation import Write
from gateway.model.notice import Notify
from gateway.nc.probing.foreign import CyclePath
from talc.frame import FloatArray


@dataclass(frozen=True, slots=True)
class Identity:
    """Who claims a control. Each run has its own number, so that a copy of this computer is another gateway.

    After a crash the control may still believe the run before this one to be alive. The database tells a gateway which
    run that was, if it ran on this computer since the computer was switched on: in a copy, it may run elsewhere.
    """

    owner: int = 1
    """Number of this run on the control; 1 .. 2**31 - 1."""
    predecessor: int | None = None
    """Number of the previous run; None: there is none, or it may still be running."""

    @classmethod
    def of(cls, boot: str, predecessor: str | None) -> "Identity":
        """From the names of the runs, which are random (gateway.storage.store.boot_id)."""
        return cls(_number_of_boot(boot), None if predecessor is None else _number_of_boot(predecessor))


def _number_of_boot(boot: str) -> int:
    return zlib.crc32(boot.encode()) % LARGEST_NUMBER + 1


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Settings of one link."""

    period_s: float
    """Time between two reads, and between two writes."""
    compensation: Compensation
    probing: Probing
    identity: Identity
    path: CyclePath | None = None
    """Where the control's cycle goes; None: its program is not ours."""

    @classmethod
    def of(cls, config: GatewayConfig, identity: Identity) -> "LinkSettings":
        """From the sections nc, compensation and probing. Raises ValueError without a section nc."""
        if config.nc is None:
            raise ValueError("config has no [nc] section")
        probing, path = config.probing, None
        if isinstance(config.nc, SinumerikNc | LinuxCncNc):
            path = CyclePath(probing.poses_deg, probing.sphere_radius_mm, probing.sphere_height_mm)
        return cls(config.nc.period_s, config.compensation, probing, identity, path)


@dataclass(frozen=True, slots=True)
class Earlier:
    """What an earlier run left."""

    first_number: int
    """Number of the first probing request; must differ from every earlier one."""
    abandoned: int | None = None
    """Number of a request that may still wait on the control: it is withdrawn."""
    reference_mm: FloatArray | None = None
    """(poses, 3) centres that deviations are measured from; None: the first measurement sets them, from the mean of
    `probing.reference_cycles` cycles."""
    measured_s: Sequence[float] | None = None
    """(9,) monotonic seconds of each error's last measurement, -inf for none or an unknown time; None: all now."""
    missing_s: Mapping[str, float] = field(default_factory=dict)
    """Inputs of live models without a good value, and the monotonic seconds since when."""
    paused: Pause | None = None
    """The compensation's pause; None: it is not paused."""
    disarmed: Disarmed | None = None
    """Who has disarmed the gateway; None: nobody."""
    proven: bool = True
    """Whether a dry run has gone well, or a cycle has measured, with this control, poses and sphere: without, no cycle
    is requested."""
    paths: frozenset[str] | None = None
    """Marks of the control's path with which dry runs have gone well; None: any."""


@dataclass(frozen=True, slots=True)
class Listeners:
    """Functions that the link calls, all in the event loop's thread."""

    states: Callable[[Mapping[str, float], float], None] = lambda _, __: None
    """The machine states of every good snapshot, and the monotonic seconds at which they were read."""
    written: Callable[[Write], None] = lambda _: None
    """Every step of the compensation."""
    notify: Notify = lambda _: None
    """Every problem as it begins and as it ends."""
    requested: Callable[[int], Awaitable[None]] | None = None
    """The number of a probing request. It is sent when this returns, or not at all if this raises NotBegun."""
