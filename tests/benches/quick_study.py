"""A study whose runs cost nothing, for tests of what keeps, resumes and shows runs, in other processes too."""

from collections.abc import Mapping
from itertools import product
from typing import Any

from studies.frame import Run, RunParameters, Study
from studies.page import Report, Table


def runs(seed: int, small: bool) -> list[RunParameters]:
    """Two pairs with each of two sensors, clean or noisy; thirty in full."""
    every = product(range(2 if small else 30), ("near", "far"), (False, True))
    return [{"seed": seed, "pair": pair, "sensors": place, "noise": noise} for pair, place, noise in every]


def run(parameters: RunParameters) -> Mapping[str, Any]:
    """A figure of its parameters."""
    return {"figure": parameters["pair"] + 10.0 * parameters["noise"] + (0.1 if parameters["sensors"] == "far" else 0)}


def report(done: list[Run]) -> Report:
    """Without pictures."""
    return Report("?", Table(("pair",), ()), (), (), [["pair"], *([r.parameters["pair"]] for r in done)])


STUDY = Study("quick", "Runs that cost nothing", runs, run, report)
