"""Starts gateways quickly: everything is imported once, each gateway is a fork of this process.

`python -m tests.benches.gateways_to_kill CONFIG`: each line on standard input starts one gateway; its process id is
printed. When standard input ends the last one is killed.
"""

import os
import signal
import sys
from pathlib import Path

from gateway.cli.running.run import run_service
from gateway.config import load


def main() -> None:
    path, pid = Path(sys.argv[1]), 0
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
    main()
