"""The part of a control's interface that writes, for a control that is only read: each request is refused."""

from drivers.base import Refused
from drivers.nc import ProbingState, RequestStatus, Triple, WatchdogTerms
from drivers.text import Text

ONLY_READ = Text("nc_only_read")


class OnlyRead:
    """Base of controls that offer neither probing nor offsets. They report nothing in force, and never had a claim."""

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:  # noqa: ARG002
        raise Refused(ONLY_READ, device="nc")

    async def probing_status(self, number: int) -> RequestStatus:
        """Always idle: no cycle can begin."""
        return RequestStatus(number, ProbingState.IDLE)

    async def withdraw_probing(self, number: int) -> None:
        """There is no request."""

    async def write_compensation(self, offsets_um: Triple) -> None:  # noqa: ARG002
        raise Refused(ONLY_READ, device="nc")

    async def read_compensation(self) -> Triple:
        """Nothing is in force."""
        return 0.0, 0.0, 0.0

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:  # noqa: ARG002
        raise Refused(ONLY_READ, device="nc", hint=Text("mode_works"))

    async def heartbeat(self, owner: int) -> bool:  # noqa: ARG002
        raise Refused(ONLY_READ, device="nc")

    async def release(self, owner: int) -> None:
        """Nothing was claimed."""
