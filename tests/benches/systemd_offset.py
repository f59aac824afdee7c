"""Runs in the guest: `begin UM` puts an offset in force on the emulated control, `end` prints as JSON what became of
it."""

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
from asyncua.sync import Client

from gateway.storage.history import History

CONFIG = Path("/etc/talc-gateway/gateway.toml")
OFFSET_OF_X = "ns=2;s=/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u1]"
"""In millimetres."""


def main() -> None:
    config = tomllib.loads(CONFIG.read_text(encoding="utf-8"))
    with Client(config["nc"]["url"]) as control:
        offset = control.get_node(OFFSET_OF_X)
        if sys.argv[1] == "begin":
            offset.write_value(float(sys.argv[2]) * 1e-3)
            return
        left_um = 1e3 * abs(offset.read_value())
    with History(Path(config["storage"]["path"])) as history:
        steps = [step for step in history.compensation() if step.written]
    stopped = [step.source for step in steps].index("stopped")
    sizes_um = np.array([np.abs(step.offsets_um).max() for step in steps])
    print(
        json.dumps(
            {
                "left_um": left_um,
                "before_um": sizes_um[stopped - 1],
                "steps": len(steps) - stopped,
                "largest_step_um": float(np.abs(np.diff(sizes_um)).max()),
                "last_um": sizes_um[-1],
                "slew_um": config["compensation"]["slew_um_per_s"] * config["nc"]["period_s"],
            }
        )
    )


if __name__ == "__main__":
    main()
