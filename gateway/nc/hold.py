"""Holds the offsets while the control probes."""

import asyncio

import numpy as np

from gateway.model.codes import NoticeCode
from gateway.model.probing import InForce
from gateway.model.text import Text
from gateway.nc.probing.cycle import Rejected
from gateway.nc.probing.uninterrupted import to_its_end
from gateway.nc.routes import Form, differ, offsets_text
from gateway.runtime.clocks import ServiceClock
from talc.frame import FloatArray


class HeldOffsets:
    """The offsets in force when the hold began. Implements gateway.nc.probing.cycle.Held."""

    def __init__(self, form: Form, clock: ServiceClock, coefficients: FloatArray) -> None:
        self._form, self._clock, self.coefficients = form, clock, coefficients
        self.watched = True
        """Whether the control has heard this gateway all the time."""

    @property
    def any(self) -> bool:
        """Whether any offset is in force."""
        return differ(self.coefficients, np.zeros_like(self.coefficients))

    def at(self, centres_mm: FloatArray | None) -> InForce:
        return self._form.during(self.coefficients, centres_mm)

    async def still(self) -> None:
        with self._clock.hold():
            now = await to_its_end(self._form.read())
        if differ(now, self.coefficients):
            before = offsets_text(self.coefficients)
            raise Rejected(Text(NoticeCode.OFFSETS_MOVED, before=before, now=offsets_text(now)))
        if self._form.together and self.any and not self.watched:  # it let the shift follow the position meanwhile
            raise Rejected(Text(NoticeCode.OFFSETS_UNWATCHED))


class Hold:
    """Keeps writes and this gateway's own probing cycles apart."""

    def __init__(self, form: Form, clock: ServiceClock) -> None:
        self._form, self._clock = form, clock
        self._on = False
        self._held: HeldOffsets | None = None
        self.writing = asyncio.Lock()
        """Locked by a step while it is decided and written."""

    @property
    def on(self) -> bool:
        """Whether a cycle of this gateway holds the offsets."""
        return self._on

    def unheard(self) -> None:
        """The control has not heard this gateway for a while."""
        if self._held is not None:
            self._held.watched = False

    async def begin(self) -> HeldOffsets:
        """From now on no step begins until `end`. Raises DriverError."""
        async with self.writing:  # wait for a write in progress, or the read would not return what stays in force
            self._on = True
            with self._clock.hold():
                self._held = HeldOffsets(self._form, self._clock, await to_its_end(self._form.read()))
        return self._held

    def end(self) -> None:
        """Steps continue."""
        self._on, self._held = False, None
