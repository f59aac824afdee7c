"""Starts gateways quickly: each is a fork of this process, which has loaded the drivers' libraries already.

`python -m tests.benches.gateways_to_kill CONFIG`: each line on standard input starts one gateway; its process id is
printed. When standard input ends the last one is killed.
"""

import os
import signal
import sys
from pathlib import Path

from gateway.acquisition.build import lines_of
from gateway.config.file import load
from gateway.nc.build import control_of
from gateway.runtime.clocks import RealClock
from gateway.runtime.garbage import freeze_gc
from gateway.service.run import run_service
from tests.benches.broken import broken_by_environment


def main() -> None:
    path, pid = Path(sys.argv[1]), 0
    config, clock = load(path), RealClock()
    assert config.nc is not None
    # Drivers that nobody uses: making them loads their modules, which happens on first use.
    lines_of(config, clock)
    control_of(config.nc, config, clock)
    freeze_gc()
    for _ in sys.stdin:
        if pid:
            os.waitpid(pid, 0)  # the previous one was killed
        pid = os.fork()
        if not pid:
            code = 1
            try:
                run_service(load(path), path)
                code = 0
            finally:
                os._exit(code)
        print(pid, flush=True)
    if pid:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


if __name__ == "__main__":
    with broken_by_environment():
        main()
