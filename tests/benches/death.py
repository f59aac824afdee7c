"""The moment at which a process kills itself: the n-th within a phase of its life (`tests.benches.kills`)."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

PROBING = "probing"
PHASES = ("start", "rebuild", "learning", PROBING, "stop")
_ROOT = Path(__file__).parents[2]
_COUNTED = tuple(str(_ROOT / name) for name in ("gateway", "talc", "drivers"))
"""Code whose calls and returns are moments of death. What a library does in between leaves nothing behind except on the
disk, where the phase `writing` kills."""


class Death:
    """Kills this process within a phase, or counts what could be a moment of death.

    phase: where; None: it only counts
    at: number of the moment
    """

    def __init__(self, phase: str | None, at: int) -> None:
        self._phase, self._at = phase, at
        self.counts = dict.fromkeys(PHASES, 0)
        self._now = list[str]()
        self._counted = dict[str, bool]()

    def begin(self, phase: str) -> None:
        self._now.append(phase)
        if phase != PROBING and self._phase in (None, phase):
            sys.setprofile(self._look)

    def end(self, phase: str) -> None:
        if phase in self._now:
            self._now.remove(phase)
        if not self._now or phase == self._phase:
            sys.setprofile(None)

    @contextmanager
    def within(self, phase: str) -> Iterator[None]:
        self.begin(phase)
        try:
            yield
        finally:
            self.end(phase)

    def asks_control(self) -> None:
        """A moment of the phase `probing`, whose main thread mostly waits for time to pass."""
        if PROBING in self._now:
            self._count(PROBING)

    def _look(self, frame: FrameType, event: str, arg: object) -> None:
        del event, arg
        name = frame.f_code.co_filename
        if name not in self._counted:
            self._counted[name] = name.startswith(_COUNTED)
        for phase in self._now if self._counted[name] else ():
            if phase != PROBING:
                self._count(phase)

    def _count(self, phase: str) -> None:
        self.counts[phase] += 1
        if phase == self._phase and self.counts[phase] == self._at:
            os.kill(os.getpid(), signal.SIGKILL)
