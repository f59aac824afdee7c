"""What the process of `run` does with its memory; tests/system/test_memory.py checks how much it uses."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.service_file import TEXT

LIMIT_S = 120.0
COUNTED = """\
import atexit, gc, runpy, sys
atexit.register(lambda: print("spared", gc.get_freeze_count(), "of", len(gc.get_objects()), file=sys.stderr))
sys.argv = ["talc-gateway", "run", sys.argv[1]]
runpy.run_module("gateway", run_name="__main__")
"""


@pytest.mark.slow
def test_garbage_collections_spare_what_the_service_has_loaded(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(TEXT + "[telemetry]\nenabled = false\n", encoding="utf-8")
    service = subprocess.Popen([sys.executable, "-c", COUNTED, str(file)], stderr=subprocess.PIPE, text=True)
    assert service.stderr is not None
    try:
        for line in service.stderr:
            if "store: " in line:  # it has begun
                service.send_signal(signal.SIGTERM)
                break
        said = service.communicate(timeout=LIMIT_S)[1].splitlines()
    finally:
        service.kill()
        service.wait()
    word, spared, _, left = said[-1].split()
    assert word == "spared"
    assert int(spared) > 5 * int(left), "a full collection looks only through the rest"
