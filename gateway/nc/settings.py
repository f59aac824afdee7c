"""The input of a link to one control: its settings, what an earlier run left, and its listeners."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from gateway.config import Compensation, GatewayConfig, Probing
from gateway.nc.slew import Write
from gateway.polling import Notify
from talc.frame import FloatArray


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Settings of one link."""

    period_s: float
    """Time between two reads, and between two writes."""
    compensation: Compensation
    probing: Probing
    owner: int = 1
    """Number of this gateway on the control, the same after every restart; 1 .. 2**31 - 1."""

    @classmethod
    def of(cls, config: GatewayConfig, owner: int = 1) -> "LinkSettings":
        """From the sections nc, compensation and probing. Raises ValueError without a section nc."""
        if config.nc is None:
            raise ValueError("config has no [nc] section")
        return cls(config.nc.period_s, config.compensation, config.probing, owner)


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
    """(9,) monotonic seconds of each error's last measurement, -inf for none; None: all of them now."""
    missing_s: Mapping[str, float] = field(default_factory=dict)
    """Inputs of live models without a good value, and the monotonic seconds since when."""


@dataclass(frozen=True, slots=True)
class Listeners:
    """Functions that the link calls, all in the event loop's thread."""

    states: Callable[[Mapping[str, float], float], None] = lambda _, __: None
    """The machine states of every good snapshot, and the monotonic seconds at which they were read."""
    written: Callable[[Write], None] = lambda _: None
    """Every step of the compensation."""
    notify: Notify = lambda _: None
    """Every problem as it begins and as it ends."""
    requested: Callable[[int], None] = lambda _: None
    """The number of a probing request, before it is sent."""
