"""Machines for the reference agent that take the nine errors or slopes; each can be wrong in one way."""

import math
from typing import Any

import numpy as np

from talc import kinematics
from tests.benches.reference_agent import REFERENCE

TIP_MM, A_DEG, RADIUS_MM = (100.0, 50.0, 30.0), 20.0, 120.0


def errors_machine(wrong: str = "") -> Any:
    """Takes the nine errors at its radius. wrong: `sign`, `radius` or `bound`."""

    class ErrorsMachine(REFERENCE.Machine):  # type: ignore[misc]
        verbs = (*REFERENCE.Machine.verbs, "errors", "write_errors")

        def __init__(self) -> None:
            super().__init__()
            self.greeting |= {"capabilities": ["shift", "errors"], "reach_mm": [300.0, 400.0]}
            self.um, self.wanted, self.bound = [0.0] * 9, [0.0] * 9, [200.0] * 3

        def status(self, it: object) -> Any:
            told = super().status(it)
            told["positions"]["A"] = A_DEG
            return told

        def read(self, _: object) -> list[float]:
            errors = np.array(self.um)
            if wrong == "sign":
                errors[7] = -errors[7]
            at = np.array([*TIP_MM, math.radians(A_DEG), 0.0])
            shift = kinematics.tcp_offsets(errors, at, RADIUS_MM * 1e-3)
            return [
                float(v) for v in (shift if wrong == "bound" else np.clip(shift, -np.array(self.bound), self.bound))
            ]

        def write(self, it: dict[str, Any]) -> None:
            super().write(it)
            x, y, z = self.wanted
            self.wanted, self.bound = [y, z, x] + [0.0] * 6, [200.0] * 3

        def errors(self, it: dict[str, Any]) -> list[float]:
            share = 1.0 if wrong == "radius" else it["radius_mm"] / RADIUS_MM
            return [v * share if i == 5 else v for i, v in enumerate(self.um)]

        def write_errors(self, it: dict[str, Any]) -> None:
            super().write(it | {"um": it["bound_um"]})
            wanted = [REFERENCE.number({"v": v}, "v", -1e3, 1e3) for v in it["errors"]]
            if len(wanted) != 9:
                raise REFERENCE.Refusal("errors: expected nine")
            wanted[5] *= RADIUS_MM / it["radius_mm"]
            self.wanted, self.bound = wanted, it["bound_um"]

    return ErrorsMachine()


def slopes_machine(wrong: str = "") -> Any:
    """Takes the slopes of X by X and Y by X. wrong: `axis`."""
    reference, reach = np.array([10.0, 0.0, 0.0]), np.array([300.0, 200.0, 100.0])

    class SlopesMachine(REFERENCE.Machine):  # type: ignore[misc]
        verbs = (*REFERENCE.Machine.verbs, "slopes", "write_slopes")

        def __init__(self) -> None:
            super().__init__()
            travel = {"pairs": ["XX", "YX"], "reference_mm": list(reference), "reach_mm": list(reach)}
            self.greeting |= {"capabilities": ["slopes"], "travel": travel}
            self.um, self.wanted = [0.0] * 12, [0.0] * 12

        def read(self, _: object) -> list[float]:
            k0, slopes = np.array(self.um[:3]), np.array(self.um[3:]).reshape(3, 3)
            if wrong == "axis":
                slopes = slopes.T
            return [float(v) for v in k0 + slopes @ (np.array(TIP_MM) - reference)]

        def slopes(self, _: object) -> dict[str, Any]:
            return {"um": self.um[:3], "um_per_mm": [self.um[3:6], self.um[6:9], self.um[9:]]}

        def write_slopes(self, it: dict[str, Any]) -> None:
            super().write(it)
            self.wanted = [*self.wanted, *(float(v) for row in it["um_per_mm"] for v in row)]

    return SlopesMachine()
