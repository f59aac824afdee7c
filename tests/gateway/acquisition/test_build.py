"""The schedule of a configuration's buses."""

import pytest

from gateway.acquisition import lines_of
from gateway.config import validate
from tests.benches.stepped_clock import SteppedClock


@pytest.mark.parametrize(
    ("period_s", "phases_s"),
    [(2.0, [0.0, 0.01, 0.02, 0.03]), (0.02, [0.0, 0.005, 0.01, 0.015])],
)
def test_polls_of_several_buses_begin_shortly_after_each_other_within_the_period(
    period_s: float, phases_s: list[float]
) -> None:
    names = [f"tcp{number}" for number in range(4)]
    config = validate(
        {
            "machine": {"name": "mill"},
            "bus": [
                {"name": name, "kind": "modbus_tcp", "host": "nowhere", "timeout_s": 0.01, "period_s": period_s}
                for name in names
            ],
            "device": [
                {"name": f"of_{name}", "bus": name, "profile": "advantech_adam6015", "channels": {f"{name}_a": 0}}
                for name in names
            ],
        }
    )
    assert [line.phase_s for line in lines_of(config, SteppedClock())] == phases_s
