"""Time that the core of the component talc_errors takes by itself, whatever else the computer does.

`python -m tests.benches.linuxcnc_core [SITUATIONS]` calls it in as many random situations: any errors, anywhere in the
travel, slewing or not, homed or not, with steps to bridge. Each is repeated, and the least of its times counts, so that
interruptions do not. A tenth of them are then called with nothing in any cache: not the core, nor its data, nor the
mathematical library. In a servo period of LinuxCNC, a part of that is in a cache. Compiled with the options of
LinuxCNC's Makefile.modinc that matter here.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from simulators.linuxcnc.machine import FILES
from talc.frame import FloatArray
from tests.benches.linuxcnc_period import clocks_per_us

_REPEATED = 25
_AS_A_MODULE = "-Os", "-fPIC", "-fno-builtin-sin", "-fno-builtin-cos", "-fno-builtin-sincos", "-fno-fast-math"
_SOURCE = """#define _GNU_SOURCE
#include <link.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <x86intrin.h>
#include "talc_errors.h"
static double any(double most) { return most * (2.0 * rand() / RAND_MAX - 1.0); }
static int now_and_then(void) { return rand() % 8 == 0; }
__attribute__((noinline)) static void step(TalcState *s, const TalcInput *in) { talc_step(s, in); }
static void uncache(const void *from, size_t length) {
    const uintptr_t end = (uintptr_t)from + length;
    for (uintptr_t line = (uintptr_t)from & ~(uintptr_t)63; line < end; line += 64) _mm_clflush((const void *)line);
}
static int uncache_loaded(struct dl_phdr_info *object, size_t size, void *unused) {
    (void)size, (void)unused;
    for (int i = 0; i < object->dlpi_phnum; i++) {
        const ElfW(Phdr) *part = &object->dlpi_phdr[i];
        const int ours = !*object->dlpi_name || strstr(object->dlpi_name, "/libm.");
        if (ours && part->p_type == PT_LOAD) uncache((char *)object->dlpi_addr + part->p_vaddr, part->p_memsz);
    }
    return 0;
}
int main(int argc, char **argv) {
    TalcState state = {0};
    const int cold = argc > 2;
    srand(1);
    for (long i = 0; argc > 1 && i < atol(argv[1]); i++) {
        TalcInput in = {.limit = 200, .radius = 120, .reach = {300, 400}, .dt = 1e-3};
        for (int j = 0; j < TALC_ERRORS; j++) in.wanted[j] = any(100);
        for (int j = 0; j < 3; j++) in.tip[j] = any(400), in.bound[j] = now_and_then() ? 20 : 200;
        in.a = any(3.2);
        in.tool[2] = now_and_then() ? 100 : 0;
        in.slew = in.rate = now_and_then() ? 1e6 : 10;
        in.homed = !now_and_then();
        in.hold = now_and_then();
        unsigned long long least = -1ULL;
        TalcState after = state;
        for (int k = 0; k < REPEATED; k++) {
            unsigned int core;
            after = state;
            if (cold) {
                dl_iterate_phdr(uncache_loaded, NULL);
                uncache(&in, sizeof in);
                uncache(&after, sizeof after);
                _mm_mfence();
            }
            _mm_lfence();
            const unsigned long long began = __rdtsc();
            _mm_lfence();
            step(&after, &in);
            const unsigned long long took = __rdtscp(&core) - began;
            if (took < least) least = took;
        }
        state = after;
        printf("%llu\\n", least);
    }
    return 0;
}
"""


def core_us(situations: int, *, cold: bool = False) -> FloatArray:
    """(situations,) the least time of each, µs. cold: nothing is in a cache. Raises subprocess.CalledProcessError."""
    with TemporaryDirectory() as folder:
        program = Path(folder) / "core"
        strict = ["-std=gnu11", *_AS_A_MODULE, "-Wall", "-Wextra", "-Werror", f"-DREPEATED={_REPEATED}"]
        command = ["gcc", *strict, f"-I{FILES}", "-x", "c", "-", "-o", str(program), "-lm"]
        subprocess.run(command, input=_SOURCE, text=True, check=True)
        run = [str(program), str(situations), *(["cold"] if cold else [])]
        said = subprocess.run(run, check=True, capture_output=True, text=True).stdout
    return np.array(said.split(), dtype=np.float64) / clocks_per_us()


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    for name, took in ("in the cache", core_us(count)), ("in no cache", core_us(count // 10, cold=True)):
        print(f"{name}: {took.size} situations, median {np.median(took):.2f} µs, largest {took.max():.2f} µs")
