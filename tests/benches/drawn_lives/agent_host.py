"""An emulated control behind its agent's protocol (docs/agent.md), on a wire that drops, delays and halves."""

import json
import random
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import dataclass
from typing import Any

from drivers.base import Refused
from drivers.nc import NotSendable, WatchdogTerms
from drivers.signature import is_signed, session_key, signature
from simulators.nc import Nck
from simulators.nc.watchdog import R_OWNER
from tests.benches.in_process_nc import WithoutDryRun
from tests.benches.strangers.driven_loop import DrivenLoop, Line, LoopClock

KEY = b"0123456789abcdef0123456789abcdef"
_WIRE_S = 0.001


@dataclass
class Disturbances:
    """Shares of the messages, in both directions, to which something happens now."""

    drops: float = 0.0
    late: float = 0.0
    late_s: float = 0.0
    halves: float = 0.0
    """They arrive in half, and the other half never does."""
    hangs_up: float = 0.0
    """With them the connection ends."""
    refuses: bool = False
    """No new connection is accepted."""


class AgentHost:
    """One agent; only its newest client is obeyed."""

    def __init__(self, loop: DrivenLoop, nck: Nck, draw: random.Random) -> None:
        self._loop, self._nck, self._draw = loop, nck, draw
        self._nc = WithoutDryRun(nck, LoopClock(loop))
        _at_once(self._nc.connect())
        self.now = Disturbances()
        self.looks_s: list[float] = []
        """When it was asked for its state."""
        self._client: Line | None = None
        self._rest: dict[Line, bytes] = {}
        self._challenge: dict[Line, str] = {}
        self._last_s: dict[tuple[Line, str], float] = {}
        self._session: dict[Line, tuple[bytes, int]] = {}

    @property
    def refuses(self) -> bool:
        return self.now.refuses

    def connected(self, line: Line) -> None:
        self._rest[line], self._challenge[line] = b"", str(self._draw.getrandbits(64))
        self._send(line, json.dumps({"challenge": self._challenge[line]}).encode())

    def left(self, line: Line) -> None:
        """What it sent before may still arrive."""

    def heard(self, line: Line, data: bytes) -> None:
        for part, at_s in self._arrives(line, data, "in"):
            self._loop.call_at(at_s, self._take, line, part)

    def _send(self, line: Line, data: bytes) -> None:
        for part, at_s in self._arrives(line, data + b"\n", "out"):
            line.send(part, at_s)

    def _arrives(self, line: Line, data: bytes, way: str) -> Iterator[tuple[bytes, float]]:
        """What arrives of it, and when: in order, on one connection."""
        now, draw = self.now, self._draw
        if draw.random() < now.hangs_up:
            line.hang_up()
        if draw.random() < now.drops:
            return
        late_s = draw.random() * now.late_s if draw.random() < now.late else 0.0
        at_s = self._last_s[line, way] = max(
            self._last_s.get((line, way), 0.0) + 1e-6, self._loop.time() + _WIRE_S + late_s
        )
        yield (data[: len(data) // 2] if draw.random() < now.halves else data), at_s

    def _take(self, line: Line, data: bytes) -> None:
        *texts, self._rest[line] = (self._rest[line] + data).split(b"\n")
        for text in texts:
            self._obey(line, text)

    def _obey(self, line: Line, text: bytes) -> None:
        mac, _, said = text.partition(b" ")
        if line not in self._session:
            try:
                nonce = json.loads(said)["nonce"]
            except (ValueError, KeyError):
                return
            self._session[line], self._client = (session_key(KEY, self._challenge[line], nonce), 0), line
        session, count = self._session[line]
        if line is not self._client or not is_signed(session, "client", count, said, mac):
            return
        answer = {"version": 2, "capabilities": ["probe", "shift"]} if count == 0 else None
        told: dict[str, Any] = {"answer": answer}
        if count:
            try:
                told = {"answer": self._done(json.loads(said))}
            except (Refused, NotSendable) as error:
                told = {"error": str(error)}
        out = json.dumps(told).encode()
        self._session[line] = session, count + 1
        self._send(line, signature(session, "agent", count, out) + b" " + out)

    def _done(self, it: dict[str, Any]) -> Any:
        """What the control says. Raises Refused, NotSendable."""
        nc, do = self._nc, it.pop("do")
        if do == "status":
            return self._status()
        if do == "claim":
            terms = WatchdogTerms(it["silence_s"], it["ramp_um_per_s"])
            return _at_once(nc.claim(it["owner"], terms, it.get("predecessor")))
        if do == "write":
            self._nck.advance(self._loop.time())
            if self._nck.r[R_OWNER] != it["owner"]:
                raise Refused("another gateway writes", device="nc")
            return _at_once(nc.write_compensation(tuple(it["um"])))
        if do == "probing":
            status = _at_once(nc.probing_status(it["number"]))
            return {"state": status.state, "reason": status.reason, "centres": status.centres_mm, "spread": 0.0}
        asked: dict[str, Callable[..., Coroutine[Any, Any, Any]]] = {
            "read": nc.read_compensation, "heartbeat": nc.heartbeat, "release": nc.release,
            "probe": nc.request_probing, "withdraw": nc.withdraw_probing,
        }  # fmt: skip
        return _at_once(asked[do](*(it[name] for name in ("owner", "number") if name in it)))

    def _status(self) -> dict[str, Any]:
        self.looks_s.append(self._loop.time())
        now = _at_once(self._nc.snapshot())
        return {
            "positions": now.positions, "states": now.states, "mode": now.mode, "program": now.program,
            "tool": now.tool, "probe": False, "estop": False, "on": True, "homed": True, "probing": now.probing,
            "alarms": list(now.alarms),
        }  # fmt: skip

    def in_force_um(self) -> tuple[float, float, float]:
        """The offsets now."""
        self._nck.advance(self._loop.time())
        x, y, z = (round(-1e3 * value, 6) + 0.0 for value in self._nck.k0_mm)
        return x, y, z


def _at_once(work: Coroutine[Any, Any, Any]) -> Any:
    """What it returns; it waits for nothing."""
    try:
        work.send(None)
    except StopIteration as done:
        return done.value
    raise AssertionError("it waits")
