"""The process: receives the work on standard input, answers on standard output, and frees its memory by ending.

It ends at once when the gateway ends.
"""

import os
import pickle
import resource
import signal
import sys
import threading
import traceback

from gateway.runtime.bounded_memory import data_bytes
from gateway.runtime.workers.control_group import join_learning

_NICENESS = 10
_STDIN = 0
_STDOUT = 1


def main() -> int:
    """The exit status is 0 with an answer on standard output, or 1 with a traceback on standard error."""
    os.nice(_NICENESS)
    join_learning()
    answer = os.dup(_STDOUT)
    os.dup2(sys.stderr.fileno(), _STDOUT)  # what a library prints must not become part of the answer
    try:
        work, given, named, processor_s, more_bytes = pickle.load(sys.stdin.buffer)
        threading.Thread(target=_end_with_the_gateway, daemon=True).start()
        if more_bytes:
            most = data_bytes() + more_bytes
            resource.setrlimit(resource.RLIMIT_DATA, (most, most))
        signal.setitimer(signal.ITIMER_PROF, processor_s)  # its signal ends the process
        found = pickle.dumps(work(*given, **named))
    except Exception:  # noqa: BLE001 - the gateway reports any error
        traceback.print_exc()
        return 1
    with os.fdopen(answer, "wb") as out:
        out.write(found)
    return 0


def _end_with_the_gateway() -> None:
    """The gateway keeps the other end of standard input open for as long as it wants the answer."""
    os.read(_STDIN, 1)
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
