#!/usr/bin/python3
"""The person at LinuxCNC: started by it as its screen, does what standard input asks, answers on standard output.

One JSON object per line. Runs under the system's Python, which has LinuxCNC's modules; its end shuts LinuxCNC down.
"""

import json
import subprocess
import sys
import time
from typing import Any

import linuxcnc

LIMIT_S = 20.0


class Control:
    def __init__(self) -> None:
        self.command, self.stat, self.errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()

    def until(self, what: str, condition: Any) -> None:
        """Wait for a state: an acknowledged command has not yet been carried out."""
        deadline = time.monotonic() + LIMIT_S
        while True:
            self.stat.poll()
            if condition(self.stat):
                return
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what}; the control says {self.errors.poll()}")
            time.sleep(0.005)

    def switch_on(self) -> None:
        self.command.state(linuxcnc.STATE_ESTOP_RESET)
        self.until("emergency stop reset", lambda s: s.task_state == linuxcnc.STATE_ESTOP_RESET)
        self.command.state(linuxcnc.STATE_ON)
        self.until("machine on", lambda s: s.task_state == linuxcnc.STATE_ON)

    def home(self) -> None:
        self.command.mode(linuxcnc.MODE_MANUAL)
        self.until("manual mode", lambda s: s.task_mode == linuxcnc.MODE_MANUAL)
        self.command.home(-1)
        self.until("all joints homed", lambda s: all(s.homed[:5]))

    def mdi(self, block: str) -> None:
        self.command.mode(linuxcnc.MODE_MDI)
        self.until("MDI mode", lambda s: s.task_mode == linuxcnc.MODE_MDI)
        self.command.mdi(block)
        if self.command.wait_complete(LIMIT_S) != linuxcnc.RCS_DONE:
            raise RuntimeError(f"{block}: {self.errors.poll()}")

    def estop(self) -> None:
        self.command.state(linuxcnc.STATE_ESTOP)
        self.until("emergency stop", lambda s: s.task_state == linuxcnc.STATE_ESTOP)

    def state(self) -> dict[str, Any]:
        self.stat.poll()
        return {
            "on": self.stat.task_state == linuxcnc.STATE_ON,
            "homed": list(self.stat.homed[:5]),
            "position": list(self.stat.joint_actual_position[:5]),
        }

    def hal(self, *words: str) -> str:
        done = subprocess.run(["halcmd", *words], capture_output=True, text=True, timeout=LIMIT_S, check=False)
        if done.returncode:
            raise RuntimeError(f"halcmd {' '.join(words)}: {done.stderr.strip()}")
        return done.stdout.strip()


def main() -> None:
    control = Control()
    verbs = {name: getattr(control, name) for name in ("switch_on", "home", "mdi", "estop", "state", "hal")}
    print(json.dumps({"ready": linuxcnc.version}), flush=True)
    for line in sys.stdin:
        verb, *arguments = json.loads(line)
        try:
            answer = {"answer": verbs[verb](*arguments)}
        except (KeyError, RuntimeError, TimeoutError, linuxcnc.error) as error:
            answer = {"error": repr(error)}
        print(json.dumps(answer), flush=True)


main()
