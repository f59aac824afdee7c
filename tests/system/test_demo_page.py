"""The demo serves the page of its machine itself, until it ends."""

import json
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.benches.free_port import free_port

pytestmark = pytest.mark.slow

LIMIT_S = 120.0
JUDGED = {"word.ready", "word.unsure", "word.not_ready"}


@contextmanager
def demo(folder: Path) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """A demo that does not end by itself, and the address that it prints before anything else."""
    command = (sys.executable, "-m", "gateway", "demo", "--hours", "1000", "--folder", str(folder))
    with subprocess.Popen(
        [*command, "--zenoh-port", str(free_port()), "--plain"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    ) as process:  # fmt: skip
        try:
            assert process.stdout is not None
            words = process.stdout.readline().split()
            assert words[:2] == ["its", "page:"], words
            yield process, words[2]
        finally:
            process.kill()


def states(address: str) -> Iterator[dict[str, Any]]:
    """What a browser is sent about the demo's machine."""
    with urllib.request.urlopen(f"{address}stream/bench", timeout=LIMIT_S) as stream:
        kind = ""
        for line in stream:
            name, _, data = line.decode().rstrip("\n").partition(": ")
            if name == "event":
                kind = data
            elif name == "data" and kind == "view":
                yield json.loads(data)


def test_the_demo_serves_the_page_of_its_machine_until_it_is_killed(tmp_path: Path) -> None:
    with demo(tmp_path) as (process, address):
        with urllib.request.urlopen(address, timeout=LIMIT_S) as page:  # the only machine's, without a list
            assert page.url.endswith("/machine/bench")
            assert "<title>bench" in page.read().decode()
        shown = states(address)
        # In fast motion the clock that counts is the machine's: an estimate of simulated minutes ago is not old.
        judged = next(s for s in shown if s["verdict"]["word"] in JUDGED)
        assert (judged["alive"], judged["simulated"]) == (True, True)
        assert len(judged["channels"]) == 30
        assert [axis["axis"] for axis in judged["axes"]] == ["X", "Y", "Z"]
        process.kill()
        process.communicate(timeout=LIMIT_S)
        for _ in shown:  # until the stream is closed
            pass
        with pytest.raises(urllib.error.URLError):
            urllib.request.urlopen(address, timeout=LIMIT_S)
