"""The lines of a configuration: their schedule."""

from gateway.acquisition import lines_of
from gateway.config import validate
from tests.benches.stepped_clock import SteppedClock


def test_polls_of_several_buses_are_spread_over_the_period() -> None:
    names = [f"tcp{number}" for number in range(4)]
    config = validate(
        {
            "machine": {"name": "mill"},
            "bus": [{"name": name, "kind": "modbus_tcp", "host": "nowhere", "period_s": 2.0} for name in names],
            "device": [
                {"name": f"of_{name}", "bus": name, "profile": "advantech_adam6015", "channels": {f"{name}_a": 0}}
                for name in names
            ],
        }
    )
    assert [line.phase_s for line in lines_of(config, SteppedClock())] == [0.0, 0.5, 1.0, 1.5]
