"""A whole agent (docs/agent.md) on an emulated machine, standard library only: `python agent.py KEY_FILE [PORT]`.

Replace Machine by your control. Its watchdog must then run in the control, so that it goes on when this program dies.
"""

import asyncio
import hmac
import json
import math
import secrets
import sys
import time
from pathlib import Path

POSES = ((0, 0), (0, 90), (0, 180), (0, 270), (90, 0), (-90, 0))
CENTRES = ((120, 0, 80), (0, 120, 80), (-120, 0, 80), (0, -120, 80), (120, -80, 0), (120, 80, 0))
BOUND_UM, SLEW_UM_PER_S, TICK_S, POSE_S = 200.0, 20.0, 0.02, 0.1
LOGIN_S, QUIET_S, LONGEST_LINE, CAN = 2.0, 3.0, 4096, ("probe", "dry_run", "shift")
NEXT = {"requested": "accepted", "accepted": "running", "running": "running"}


class Refusal(Exception):
    """The message says what is wrong; it is the answer."""


class Machine:
    """Stands still; `um` is the shift of X, Y, Z in force, which follows `wanted`."""

    verbs = ("status", "read", "write", "claim", "heartbeat", "release", "probe", "probing", "withdraw")

    def __init__(self):
        self.greeting = {"version": 3, "capabilities": CAN, "poses": POSES, "bound_um": BOUND_UM}
        self.wanted, self.um, self.held = [0.0] * 3, [0.0] * 3, [0.0] * 3
        self.owner, self.silence, self.ramp, self.beat_s = 0, 0.0, 0.0, -math.inf
        self.number, self.state, self.reason, self.since_s, self.expires_s, self.touched = 0, "idle", "", 0.0, 0.0, 0

    def tick(self):
        """Each TICK_S: the cycle; otherwise the slew, and the watchdog, which takes the shift to zero."""
        now = time.monotonic()
        if self.state == "requested" and now > self.expires_s:
            self.state, self.reason = "refused", "no safe point before the request expired"
        elif self.state in NEXT and now - self.since_s > POSE_S:
            self.held = self.read({})
            self.touched, self.since_s = self.touched + (self.state == "running"), now
            self.state = "done" if self.touched == len(POSES) else NEXT[self.state]
        if self.state not in ("accepted", "running"):  # nothing moves while it probes
            rate, to = SLEW_UM_PER_S, self.wanted
            if not self.watching():
                rate, to = min(self.ramp, rate), [0.0] * len(to)
            self.um = [v + max(-rate * TICK_S, min(rate * TICK_S, w - v)) for v, w in zip(self.um, to, strict=True)]

    def watching(self):
        return self.owner != 0 and time.monotonic() - self.beat_s < self.silence

    def status(self, _):
        return {"positions": {"X": 100.0, "Y": 50.0, "Z": 30.0, "A": 0.0, "C": 0.0},
                "states": {"spindle_speed": 0.0, "coolant": 0.0, **{f"speed_{axis}": 0.0 for axis in "XYZAC"}},
                "estop": False, "on": True, "homed": True, "mode": "auto", "program": "stopped", "tool": 1,
                "probe": False, "cannot_probe": "", "probing": self.state in ("accepted", "running")}  # fmt: skip

    def read(self, _):
        return self.um

    def write(self, it):
        um = [number({"um": v}, "um", -BOUND_UM, BOUND_UM) for v in it.get("um", ())]
        if len(um) != 3 or not self.watching() or it.get("owner") != self.owner:
            raise Refusal("expected um: X, Y, Z, of the gateway that has claimed the control and keeps it alive")
        self.wanted = um

    def claim(self, it):
        owner, silence, ramp = number(it, "owner"), number(it, "silence_s", 0.05, 86400), number(it, "ramp_um_per_s", 0)
        if self.watching() and self.owner not in (owner, it.get("predecessor")):
            raise Refusal(f"the compensation belongs to gateway {self.owner}")
        self.beat()  # by the terms of the claim before, whose offsets must not come back
        self.owner, self.silence, self.ramp = owner, silence, ramp

    def heartbeat(self, it):
        if number(it, "owner") != self.owner:
            raise Refusal(f"the compensation belongs to gateway {self.owner}")
        return self.beat()

    def beat(self):
        if not (was := self.watching()):
            self.wanted = list(self.um)  # a ramp ends here
        self.beat_s = time.monotonic()
        return was

    def release(self, it):
        self.owner = 0 if number(it, "owner") == self.owner else self.owner

    def probe(self, it):
        asked, valid_s = number(it, "number"), number(it, "valid_for_s", 0)
        raised_mm = number({"dry_run_mm": 0, **it}, "dry_run_mm", 0, 1000)
        if self.state in NEXT or asked == self.number:
            raise Refusal(f"request number {self.number} waits or is under way, or was the last one")
        self.number, self.state, self.reason, self.touched, self.raised_mm = asked, "requested", "", 0, raised_mm
        self.since_s, self.expires_s = time.monotonic(), time.monotonic() + (valid_s or math.inf)

    def probing(self, it):
        if number(it, "number") != self.number:
            return {"state": "idle", "reason": ""}
        centres = [(x, y, z + self.raised_mm) for x, y, z in CENTRES] if self.state == "done" else []
        result = {"centres": centres, "spread": 0.0, "in_force": self.held} if centres else {}
        return {"state": self.state, "reason": self.reason, **result}

    def withdraw(self, it):
        if number(it, "number") == self.number and self.state in NEXT:
            self.state, self.reason = "refused" if self.state == "requested" else "failed", "withdrawn"


def number(it, name, low=1, high=2**31 - 1):
    """A number of the command. An owner's or a request's is whole; a number with its own limits may be any."""
    value = it.get(name)
    if type(value) not in ((int,) if low == 1 else (int, float)) or not low <= value <= high:  # neither true nor NaN
        raise Refusal(f"{name} = {value!r}: expected {low} to {high}")
    return value


class Agent:
    """One client at a time, which has proved that it holds the key."""

    def __init__(self, key, machine):
        self.key, self.machine, self.client, self.heard_s = key, machine, None, -math.inf

    async def serve(self, reader, writer):
        """One connection, to its end."""
        challenge, session, n = secrets.token_hex(32), b"", 0
        writer.write(json.dumps({"challenge": challenge}).encode() + b"\n")
        try:
            while True:
                async with asyncio.timeout(None if session else LOGIN_S):
                    line = await reader.readuntil(b"\n")  # raises when it is longer than LONGEST_LINE
                mac, _, text = line[:-1].partition(b" ")
                key = session or self.session(challenge, text)
                if not hmac.compare_digest(signed(key, "client", n, text), mac):
                    if not session:
                        writer.write(b'{"error": "the proof does not fit: is it the same key on both sides?"}\n')
                    return
                if not session and self.client is not None and not self.client.is_closing():
                    if time.monotonic() - self.heard_s < QUIET_S:
                        writer.write(b'{"error": "another client is connected"}\n')
                        return
                    self.client.close()  # perhaps its computer lost power
                said = self.answer(text) if session else {"answer": self.machine.greeting}
                session, self.client, self.heard_s = key, writer, time.monotonic()
                out = json.dumps(said).encode()
                writer.write(signed(session, "agent", n, out) + b" " + out + b"\n")
                n += 1
        except (TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, ConnectionError):
            pass  # silent before its proof, gone, or too long a line
        finally:
            writer.close()

    def session(self, challenge, text):
        """The key of this connection; nobody can play an earlier one again."""
        try:
            nonce = json.loads(text)["nonce"]
            return hmac.digest(self.key, f"{challenge} {nonce}".encode(), "sha256")
        except (ValueError, LookupError, TypeError, RecursionError):
            return secrets.token_bytes(32)  # nothing fits it

    def answer(self, text):
        try:
            it = json.loads(text)
            if not isinstance(it, dict) or it.get("do") not in self.machine.verbs:
                raise Refusal(f"expected an object with do, one of {', '.join(self.machine.verbs)}")
            return {"answer": getattr(self.machine, it["do"])(it)}
        except (Refusal, ValueError, TypeError, RecursionError) as error:
            return {"error": str(error)}


def signed(session, who, n, text):
    return hmac.new(session, f"{who} {n} ".encode() + text, "sha256").hexdigest().encode()


async def main(key, port=7621):
    agent = Agent(key, Machine())
    async with await asyncio.start_server(agent.serve, "127.0.0.1", int(port), limit=LONGEST_LINE):
        while True:
            agent.machine.tick()
            await asyncio.sleep(TICK_S)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]).read_bytes().strip(), *sys.argv[2:]))
