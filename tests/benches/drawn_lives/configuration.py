"""The configuration of a drawn life."""

from pathlib import Path

from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from tests.benches.drawn_lives.plan import Plan
from tests.benches.strangers.modbus_trial import blocks_of, profile_of

STEP_S, BOUND_UM, SLEW_UM_PER_S = 300.0, 50.0, 1.0
_WATCHDOG_S = 60.0


def configuration(plan: Plan, path: Path, key_file: Path) -> GatewayConfig:
    """A gateway of that plan's devices and control."""
    buses, devices = list[object](), list[object]()
    for name, nature in plan.devices.items():
        kind = "modbus_tcp" if nature.wire == "tcp" else "modbus_rtu_tcp"
        buses.append(
            {
                "name": name, "kind": kind, "host": name, "port": 502, "timeout_s": nature.timeout_s,
                "period_s": nature.period_s,
            }
        )  # fmt: skip
        blocks = tuple(blocks_of(nature))
        for unit in range(1, nature.units + 1):
            channels = {f"{name}_{unit}_{i}": i for i in range(sum(block[2] for block in blocks))}
            devices.append(
                {
                    "name": f"{name}_{unit}", "bus": name, "profile": profile_of(blocks), "unit": unit,
                    "channels": channels,
                }
            )  # fmt: skip
    return validate(
        {
            "machine": {"name": "mill"},
            "telemetry": {"enabled": False},
            "storage": {
                "path": str(path), "compensate_unstored": plan.continues, "unstored_after_s": 1e-6,
                "warn_free_mb": 0.0,
            },
            "bus": buses,
            "device": devices,
            "nc": {"kind": "agent", "host": "control", "key_file": str(key_file), "period_s": plan.period_s},
            "grid": {"step_s": STEP_S},
            "probing": {
                "armed": True, "lead_s": 200.0, "poll_s": 10.0, "reference_cycles": 1, "prefer_idle_s": 0.0,
                "dry_run": "not offered",
            },
            "compensation": {
                "mode": "compensate", "watchdog_s": _WATCHDOG_S, "when_stale": plan.when_stale,
                "bound_um": [BOUND_UM] * 3, "slew_um_per_s": SLEW_UM_PER_S,
            },
            "sensor_check": {"enabled": False},
            "talc": {"learner": {"shortest_interval_steps": 1, "longest_interval_steps": 2}},
        }
    )  # fmt: skip
