"""Every figure that the papers print, cell by cell, and how ours stand beside them.

A: the ARX / FIR / static comparison. B19: Blaser et al. 2019. Z22: Zimmermann et al. 2022. The pages' rows of a paper
are made from here; none of these figures is ever shown as ours.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from studies.page import Table, TableRow, rounded_text
from talc.names import ERROR_UNITS, THERMAL_ERRORS

POINTS: Final = 10.0
"""Percentages this many points apart or closer are reproduced."""
FACTOR: Final = 1.5
"""Other figures whose ratio is at most this, either way, are reproduced."""

A_TABLE_2: Final[Mapping[str, Mapping[str, Mapping[str, float]]]] = {
    "Y": {
        "static": {"PV": 39.4, "RMSE": 2.3, "P99": 5.1, "SMAPE": 9.1},
        "FIR": {"PV": 41.8, "RMSE": 1.6, "P99": 4.1, "SMAPE": 6.9},
        "ARX": {"PV": 13.0, "RMSE": 1.0, "P99": 2.0, "SMAPE": 4.3},
    },
    "Z": {
        "static": {"PV": 101.8, "RMSE": 4.3, "P99": 10.8, "SMAPE": 48.4},
        "FIR": {"PV": 160.0, "RMSE": 4.5, "P99": 13.2, "SMAPE": 49.8},
        "ARX": {"PV": 62.3, "RMSE": 3.5, "P99": 7.4, "SMAPE": 41.9},
    },
}
"""Validation; direction, model, indicator."""
A_UNITS: Final = {"PV": "%", "RMSE": "µm", "P99": "µm", "SMAPE": "%"}

B19_COLUMNS_2: Final = ("calibration, h", "interval, h", "NG measurements", "NG interval, min", "P99, µm", "Pd, %")
B19_TABLE_2: Final[Mapping[str, tuple[float, ...]]] = {
    "A": (6.5, 3, 6, 25, 4.77, 97.25),
    "B": (6.5, 4, 12, 30, 4.98, 96.99),
    "C": (6.5, 2, 12, 10, 4.91, 95.87),
    "D": (16, 6, 6, 20, 4.98, 96.70),
}
"""Each load case's best set: P99 of the mean of the linear errors below 5 µm, and most Pd. C's is the common one."""
B19_COLUMNS_3: Final = ("SMAPE, %", "RMSE, µm", "PV, %", "P99, µm", "Pd, %")
B19_TABLE_3: Final[Mapping[str, tuple[float, ...]]] = {
    "A": (18.37, 1.57, 54.79, 4.46, 96.42),
    "B": (18.41, 1.90, 63.08, 4.62, 96.17),
    "C": (23.88, 1.85, 70.58, 4.91, 95.87),
    "D": (34.95, 2.42, 69.09, 5.29, 96.29),
}
"""The common set on each load case: 6.5 h, then 2 h, no good 12 × 10 min."""

_Z22_3 = {
    "E_PV": (
        (8.8, 10.7, -22.3), (44.1, 15.0, 65.9), (72.7, 20.4, 71.9), (8.8, 9.5, -8.3), (22.5, 7.0, 68.8),
        (12.4, 4.0, 67.8), (23.8, 13.5, 43.3), (62.1, 36.8, 40.8), (22.1, 13.9, 37.3),
    ),
    "E_RMS": (
        (1.3, 1.5, -11.1), (15.9, 2.0, 87.4), (20.3, 2.5, 87.6), (1.4, 1.6, -15.3), (4.9, 1.0, 79.3),
        (2.5, 0.6, 76.6), (4.2, 2.2, 48.2), (11.7, 5.1, 56.6), (5.5, 2.0, 63.0),
    ),
}  # fmt: skip
Z22_COLUMNS_3: Final = ("uncompensated", "compensated", "reduction, %")
Z22_TABLE_3: Final = {name: dict(zip(THERMAL_ERRORS, rows, strict=True)) for name, rows in _Z22_3.items()}
"""By figure and error, µm or µm/m, and %."""
_Z22_4 = {
    "E_PV": ((3, -1), (62, 65), (58, 73), (3, 0), (68, 69), (68, 68), (41, 40), (26, 37), (27, 34)),
    "E_RMS": ((1, 3), (84, 86), (74, 86), (11, 15), (76, 79), (78, 79), (38, 45), (50, 60), (57, 63)),
}
Z22_COLUMNS_4: Final = ("static", "adaptive")
Z22_TABLE_4: Final = {name: dict(zip(THERMAL_ERRORS, rows, strict=True)) for name, rows in _Z22_4.items()}
"""Reduction against no compensation, %; by figure and error."""

REMARKS: Final = {
    "Z22, Table 3, EY0A, E_PV, reduction, %": "from the printed 8.8 and 10.7 it is -21.6",
    "B19, text, productivity while each 5 min is measured, %": "by eq. 7 with a cycle of 95 s it is 68",
}
"""On printed figures that differ from what the paper's others give."""

Z22_TEXT: Final = {
    "mean E_PV of six, static, µm": 12.6,
    "mean E_PV of six, adaptive, µm": 10.6,
    "mean E_PV of six, TCK, µm": 13.8,
    "mean deviation (k = 2) of E_PV of six, static, µm": 4.1,
    "mean deviation (k = 2) of E_PV of six, adaptive, µm": 2.4,
    "deviation of E_PV of six, adaptive against static, % less": 40.0,
    "deviation of E_PV of three rotations, adaptive against static, % less": 52.0,
    "deviation of E_RMS of six, adaptive against static, % less": 52.0,
    "deviation of E_RMS of three rotations, adaptive against static, % less": 73.0,
    "E_PV of EX0C, static, µm": 30.6,
    "E_PV of EX0C, adaptive, µm": 19.7,
    "E_PV of EX0C, adaptive against static, % less": 36.0,
    "deviation of E_PV of EX0C, adaptive against static, % less": 58.0,
    "E_RMS of EX0C, static, µm": 5.2,
    "E_RMS of EX0C, adaptive, µm": 2.9,
    "reduction of E_PV of six, Group-LASSO over TCK, % higher": 12.0,
    "reduction of E_PV of three rotations, Group-LASSO over TCK, % higher": 27.0,
    "reduction of E_RMS of six, Group-LASSO over TCK, % higher": 6.0,
    "reduction of E_RMS of three rotations, Group-LASSO over TCK, % higher": 19.0,
    "deviation of E_PV of six, Group-LASSO against TCK, % less": 57.0,
    "deviation of E_PV of ER0T, Group-LASSO against TCK, % less": 86.0,
    "model updates, static": 12.7,
    "deviation (k = 2) of model updates, static": 4.8,
    "model updates, adaptive": 13.0,
    "deviation (k = 2) of model updates, adaptive": 3.5,
    "model updates of the single run, static": 9.0,
    "model updates of the single run, adaptive": 12.0,
    "limit of EX0C in the single run, static, µm": 15.0,
    "least limit of EX0C in the single run, adaptive, µm": 5.0,
    "largest limit of EX0C in the single run, adaptive, µm": 9.0,
}
"""Section 5, 25 repetitions unless it says otherwise."""
B19_TEXT: Final = {
    "settings": 2191.0,
    "runs": 8764.0,
    "productivity while each 5 min is measured, %": 77.0,
}


@dataclass(frozen=True, slots=True)
class Cell:
    """A printed figure."""

    paper: str
    place: str
    """Table, or `text`."""
    name: str
    value: float
    percent: bool

    @property
    def key(self) -> str:
        return f"{self.paper}, {self.place}, {self.name}"


def cells(paper: str) -> list[Cell]:
    """All printed figures of `A`, `B19` or `Z22`, in the paper's order. KeyError: another paper."""
    return list({"A": _a, "B19": _b19, "Z22": _z22}[paper]())


def _a() -> Iterator[Cell]:
    for direction, models in A_TABLE_2.items():
        for model, figures in models.items():
            for name, value in figures.items():
                yield _cell("A", "Table 2", f"{direction}, {model}, {name}, {A_UNITS[name]}", value)


def _b19() -> Iterator[Cell]:
    for table, heads, rows in (("Table 2", B19_COLUMNS_2, B19_TABLE_2), ("Table 3", B19_COLUMNS_3, B19_TABLE_3)):
        for case, values in rows.items():
            for head, value in zip(heads, values, strict=True):
                yield _cell("B19", table, f"{case}, {head}", value)
    yield from (_cell("B19", "text", name, value) for name, value in B19_TEXT.items())


def _z22() -> Iterator[Cell]:
    for figure, of_errors in Z22_TABLE_3.items():
        for error, values in of_errors.items():
            for head, value in zip(Z22_COLUMNS_3, values, strict=True):
                unit = "" if head.endswith("%") else f", {ERROR_UNITS[error]}"
                yield _cell("Z22", "Table 3", f"{error}, {figure}, {head}{unit}", value)
    for figure, pairs in Z22_TABLE_4.items():
        for error, pair in pairs.items():
            for head, value in zip(Z22_COLUMNS_4, pair, strict=True):
                yield _cell("Z22", "Table 4", f"{error}, {figure}, reduction, {head}, %", value)
    yield from (_cell("Z22", "text", name, value) for name, value in Z22_TEXT.items())


def _cell(paper: str, place: str, name: str, value: float) -> Cell:
    return Cell(paper, place, name, float(value), "%" in name)


def reproduced(cell: Cell, ours: float) -> bool:
    """Percentages within 10 points, other figures of one sign, and the time spent probing, within a factor of 1.5."""
    theirs = cell.value
    if "Pd" in cell.name or "productivity" in cell.name:
        ours, theirs = 100.0 - ours, 100.0 - theirs
    elif cell.percent:
        return abs(ours - cell.value) <= POINTS
    return ours * theirs > 0 and 1 / FACTOR <= ours / theirs <= FACTOR


CRITERION: Final = (
    f"Reproduced: percentages at most {POINTS:g} points apart, other figures at most a factor of {FACTOR:g} (of "
    "a productivity, the time spent probing). Sizes depend on the machine, and ours is simulated; reductions say more."
)


def cell_table(paper: str, ours: Mapping[str, float], why: Mapping[str, str], missing: str) -> Table:
    """A line for each printed figure: theirs, ours, reproduced or not, why.

    ours: by `place, name` without the paper; why: reason by place and name, or by its beginning (the longest counts);
    missing: the reason where there is no figure of ours. ValueError: ours has a figure that the paper does not print.
    """
    found = cells(paper)
    strange = sorted(set(ours) - {f"{cell.place}, {cell.name}" for cell in found})
    if strange:
        raise ValueError(f"{paper} does not print {strange[0]!r}")
    rows = []
    for cell in found:
        at = f"{cell.place}, {cell.name}"
        value = ours.get(at, float("nan"))
        begins = [begin for begin in why if at.startswith(begin)]
        reason = why[max(begins, key=len)] if begins else ""
        if value != value:
            verdict, reason = "not compared", why.get(at, missing)
        elif reproduced(cell, value):
            verdict, reason = "yes", ""
        else:
            verdict, reason = "no", reason or "another machine"
        told = "; ".join(text for text in (reason, REMARKS.get(cell.key, "")) if text)
        rows.append(TableRow((at, f"{cell.value:g}", rounded_text(value), verdict, told)))
    return Table((f"{paper}: every printed figure", "theirs", "ours", "reproduced", "why not"), tuple(rows))


def counted(table: Table) -> str:
    """How many of a table's figures were reproduced."""
    verdicts = [row.cells[3] for row in table.rows]
    return f"{verdicts.count('yes')} of {len(verdicts)} printed figures reproduced, {verdicts.count('no')} not, " + (
        f"{verdicts.count('not compared')} not compared"
    )
