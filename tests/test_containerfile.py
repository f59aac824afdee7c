"""The time that a stop may need is within that of the Containerfile."""

import re
from pathlib import Path

from gateway.config.extended import validate
from gateway.service.run import stop_s

TEXT = (Path(__file__).parents[1] / "deploy/container/Containerfile").read_text(encoding="utf-8")


def test_a_stop_has_the_time_for_the_ramp_from_the_default_bounds_at_the_default_slew() -> None:
    """podman kills it after that time, and the offsets stay until the control's watchdog takes them back."""
    config = validate({
        "machine": {"name": "mill"},
        "nc": {"kind": "sinumerik", "url": "opc.tcp://nowhere:4840", "security": "none"},
        "compensation": {"mode": "compensate"},
    })  # fmt: skip
    (waits_s,) = re.findall(r"--stop-timeout (\d+)", TEXT)
    assert float(waits_s) >= stop_s(config) > 60.0
