"""The agent's claims and beats, on pins in memory whose component runs or does not."""

import time
from types import SimpleNamespace
from typing import Any

import pytest

from simulators.linuxcnc.machine import FILES
from tests.benches.linuxcnc_module import linuxcnc_module

CLAIM = {"owner": 7, "silence_s": 4.0, "ramp_um_per_s": 1.0}
WRITE = {"owner": 7, "um": [1.0, 2.0, 3.0]}


@pytest.fixture
def offsets(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The agent's commands and `pass_time`; the component runs while `runs`."""
    monkeypatch.syspath_prepend(str(FILES))
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    pins: dict[str, Any] = {"beat": False, "beat-seen": False, "watching": False, "lapse": 0}
    machine = SimpleNamespace(mm=1.0, bound_um=500.0, radius=120.0, elsewhere=lambda _: "")
    module = linuxcnc_module("talc_offsets")
    bench = SimpleNamespace(at=module.Offsets(machine, pins, lambda _: 0.0), refusal=module.Refusal, runs=True)

    def pass_time(seconds: float) -> None:
        now[0] += seconds
        if bench.runs:
            pins["beat-seen"], pins["watching"] = pins["beat"], True

    bench.pass_time = pass_time
    return bench


def test_a_component_that_has_stopped_hears_no_beat_and_nothing_is_written(offsets: Any) -> None:
    offsets.at.claim(CLAIM)
    offsets.pass_time(1.0)
    assert offsets.at.heartbeat({"owner": 7}) is True
    offsets.at.write(WRITE)
    offsets.pass_time(1.0)
    offsets.runs = False  # its thread stands still; the pins stay as they are
    heard = []
    for _ in range(8):
        heard.append(offsets.at.heartbeat({"owner": 7}))
        offsets.pass_time(1.0)
    assert heard == [True] * 4 + [False] * 4, "for the silence it may just be late"
    with pytest.raises(offsets.refusal) as refused:
        offsets.at.write(WRITE)
    assert refused.value.code == "no_heartbeat"
    offsets.runs = True
    offsets.pass_time(0.1)
    assert offsets.at.heartbeat({"owner": 7}) is True
