"""The chosen sets of the study parameters on other series, and more comparisons on the series of their choice."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from studies.frame import Run
from studies.page import Table, TableRow, rounded_text
from studies.parameters_points import TARGET_UM, Key, StudyPoint, name_of

_PEERS = {
    "models": "P99",
    "the last measurement held": "hold P99",
    "regression on all inputs": "regression P99",
    "the same, gains renewed with the models": "regression at updates P99",
    "models, inputs chosen again": "inputs again P99",
}
SeedMachine = tuple[int, str]
"""Seed and machine."""


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """Points of the chosen sets by name, for each place and load case."""

    sets: tuple[Key, ...]
    points: Mapping[tuple[SeedMachine, str], Mapping[str, StudyPoint]]

    @property
    def models(self) -> tuple[Key, ...]:
        """Sets that are not the regression's own."""
        found = next(iter(self.points.values()), {})
        return tuple(key for key in self.sets if "hold P99" in found[name_of(key)])

    @property
    def places(self) -> list[SeedMachine]:
        """All places; first the one on which the sets were chosen."""
        return list(dict.fromkeys(place for place, _ in self.points))

    def at(self, place: SeedMachine, key: Key) -> list[StudyPoint]:
        """The set's points on every load case."""
        return [points[name_of(key)] for (where, _), points in self.points.items() if where == place]

    def here(self, cases: list[str], key: Key, name: str) -> list[float]:
        """A figure by load case where the set was chosen."""
        return [float(self.points[self.places[0], case][name_of(key)][name]) for case in cases]

    def seeds(self) -> list[SeedMachine]:
        """Other seeds."""
        return [place for place in self.places[1:] if place[0] != self.places[0][0]]

    def machines(self) -> list[SeedMachine]:
        """Other machines, same seed."""
        return [place for place in self.places[1:] if place[0] == self.places[0][0]]

    def worst(self, case: str, key: Key, seeds: bool) -> float:
        """Largest P99 of the other seeds, or of the other machines, µm; NaN if the set was not run there."""
        places = self.seeds() if seeds else self.machines()
        if key not in self.sets or not places:
            return float("nan")
        return max(float(self.points[place, case][name_of(key)]["P99"]) for place in places)


def elsewhere(runs: list[Run]) -> Elsewhere:
    """From the runs of chosen sets; empty without any."""
    found: dict[tuple[SeedMachine, str], Mapping[str, StudyPoint]] = {}
    sets: tuple[Key, ...] = ()
    for run in runs:
        p = run.parameters
        if "sets" in p:
            sets = tuple(tuple(key) for key in p["sets"])
            found[(p["seed"], p["machine"]), str(p["case"])] = {point["set"]: point for point in run.result["sets"]}
    return Elsewhere(sets, found)


def near_table(chosen: Elsewhere, cases: list[str], key: Key) -> Table:
    """Other methods with a set's measurements."""
    rows = [TableRow((title, *map(rounded_text, chosen.here(cases, key, name)))) for title, name in _PEERS.items()]
    made, updates, again = (
        [f"{n:.0f}" for n in chosen.here(cases, key, name)]
        for name in ("measurements", "updates", "inputs again measurements")
    )
    rows.append(TableRow(("measurements", *made)))
    rows.append(TableRow(("model updates", *updates)))
    rows.append(TableRow(("measurements with inputs chosen again", *again)))
    return Table((f"P99, µm, at {name_of(key)}", *cases), tuple(rows))


def elsewhere_table(chosen: Elsewhere) -> Table:
    """A line per set, a column per place."""
    rows = []
    for key in chosen.sets:
        cells = []
        for place in chosen.places:
            points = chosen.at(place, key)
            largest, kept = max(p["P99"] for p in points), sum(p["P99"] < TARGET_UM for p in points)
            made = float(np.mean([p["measurements"] for p in points]))
            cells.append(f"{rounded_text(largest)} ({kept} of {len(points)}), {made:.0f}")
        rows.append(TableRow((name_of(key), *cells)))
    head = [f"seed {seed}" if machine == "base" else f"{machine}, seed {seed}" for seed, machine in chosen.places]
    return Table(("P99, µm (load cases below 5 µm), measurements", *head), tuple(rows))
