"""Time that the component talc_errors takes in each servo period of a real LinuxCNC whose axes move.

`python -m tests.benches.linuxcnc_period [SECONDS]` prints the figures of docs/linuxcnc.md. LinuxCNC counts processor
clocks; a period in which the computer did something else meanwhile counts in full. LinuxCNC's own motion controller,
counted in the same periods, shows how often that happens. `python -m tests.benches.real_time_kernel` runs this command
on a real-time kernel; `python -m tests.benches.linuxcnc_core` measures the component's core alone.
"""

import asyncio
import ctypes
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from talc.frame import FloatArray
from tests.benches.linuxcnc_motion import by_errors, in_motion, machine

_CLOCKS = "#include <x86intrin.h>\nunsigned long long clocks(void) { return __rdtsc(); }\n"
_CALIBRATION_S = 1.0
_LATE_US = 4.0
"""A function that takes this much more than its median was interrupted."""
MOTION = "circle of 120 mm, C at 60°/s"


def clocks_per_us() -> float:
    """The rate of the counter that LinuxCNC reads, on a processor of our kind."""
    with TemporaryDirectory() as folder:
        library = Path(folder) / "clocks.so"
        command = ["gcc", "-O2", "-shared", "-fPIC", "-x", "c", "-", "-o", str(library)]
        subprocess.run(command, input=_CLOCKS, text=True, check=True)
        clocks = ctypes.CDLL(str(library)).clocks
        clocks.restype = ctypes.c_ulonglong
        began, first = time.perf_counter(), clocks()
        time.sleep(_CALIBRATION_S)
        passed, last = time.perf_counter() - began, clocks()
    return float(last - first) / (passed * 1e6)


async def periods_us(seconds: float) -> FloatArray:
    """(n, 2) time that the component, and LinuxCNC's motion controller, took in each servo period, with nine errors in
    force and in motion, µs."""
    with TemporaryDirectory() as folder:
        async with machine(Path(folder)) as bench:
            for command in (
                "loadrt conv_s32_float names=talc-took,talc-beside",
                "addf talc-took servo-thread",
                "addf talc-beside servo-thread",
                "net talc-clocks talc-errors.time => talc-took.in",
                "net talc-clocks-float talc-took.out",
                "net talc-beside-clocks motion-controller.time => talc-beside.in",
                "net talc-beside-float talc-beside.out",
            ):
                await bench.operator.ask("hal", *command.split())
            await by_errors(bench)
            async with in_motion(bench, Path(folder) / "machine" / "nc", MOTION):
                signals = "talc-clocks-float", "talc-beside-float"
                rows = await bench.operator.ask("sample", round(seconds * 1000), *signals)
    return np.array(rows, dtype=np.float64) / clocks_per_us()


def figures(took_us: FloatArray) -> str:
    """In words."""
    said = []
    for name, took in zip(("component", "LinuxCNC's motion controller"), took_us.T, strict=True):
        median, p99, p999 = np.percentile(took, [50.0, 99.0, 99.9])
        late = int((took > median + _LATE_US).sum())
        said.append(
            f"{name}: median {median:.2f} µs, 99 % {p99:.2f}, 99.9 % {p999:.2f}, largest {took.max():.2f} µs; "
            f"of {took.size} periods, {(took > 5.0).sum()} beyond 5 µs, {late} by {_LATE_US:g} µs above the median"
        )
    return "\n".join(said)


if __name__ == "__main__":
    print(figures(asyncio.run(periods_us(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0))))
