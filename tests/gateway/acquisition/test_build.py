"""The schedule of a configuration's buses, and what judges their values."""

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition.build import lines_of
from gateway.acquisition.plausibility import Check
from gateway.config.extended import validate
from gateway.config.sections import Limits
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from tests.benches.stepped_clock import EPOCH, SteppedClock


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


def test_every_limit_of_the_file_judges_what_is_read() -> None:
    """Each limit in turn: one that has no way from the file to the judgement would go unnoticed otherwise."""
    judged: dict[str, object] = {}
    stated = {
        "min": (30.0, [20.0]),
        "max": (10.0, [20.0]),
        "max_jump": (1.0, [20.0, 25.0]),
        "max_rate_per_min": (1.0, [20.0, 25.0]),
        "stuck_after_s": (1.0, [20.0, 20.0]),
    }
    assert set(stated) == set(Limits.model_fields)
    for name, (limit, values) in stated.items():
        config = validate(
            {
                "machine": {"name": "mill"},
                "bus": [{"name": "tcp1", "kind": "modbus_tcp", "host": "nowhere"}],
                "device": [
                    {"name": "adam", "bus": "tcp1", "profile": "advantech_adam6015", "channels": {"bed": 0, "oil": 1}}
                ],
                "limits": {"bed": {name: limit}},
            }
        )
        (line,) = lines_of(config, SteppedClock())
        assert set(line.plausible) == {"bed"}
        check = Check(line.plausible["bed"])
        found = [
            check.judge(Reading("bed", value, "degC", Quality.GOOD, EPOCH, 2.0 * second))
            for second, value in enumerate(values)
        ]
        detail = found[-1].detail
        judged[name] = (found[-1].quality.value, detail.code, detail.values) if isinstance(detail, Text) else None
    assert judged == {
        "min": ("out_of_range", NoticeCode.BELOW_MINIMUM, {"value": 20.0, "min": 30.0}),
        "max": ("out_of_range", NoticeCode.ABOVE_MAXIMUM, {"value": 20.0, "max": 10.0}),
        "max_jump": ("out_of_range", NoticeCode.JUMPED, {"by": 5.0, "most": 1.0}),
        "max_rate_per_min": ("out_of_range", NoticeCode.CHANGED_FAST, {"by": 5.0, "within_s": 60.0, "most": 1.0}),
        "stuck_after_s": ("stale", NoticeCode.FROZEN, {"value": 20.0, "for_s": 2.0}),
    }
