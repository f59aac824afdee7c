"""The papers' printed figures: complete, consistent with each other, and judged as stated."""

import pytest

from studies.printed import (
    REMARKS,
    Z22_TABLE_3,
    Cell,
    cell_table,
    cells,
    counted,
    reproduced,
)
from talc.indicators import productivity


def test_every_cell_of_the_five_tables_is_there_once() -> None:
    found = [cell for paper in ("A", "B19", "Z22") for cell in cells(paper)]
    places = [f"{cell.paper} {cell.place}" for cell in found if cell.place != "text"]
    wanted = {"A Table 2": 24, "B19 Table 2": 24, "B19 Table 3": 20, "Z22 Table 3": 54, "Z22 Table 4": 36}
    assert {place: places.count(place) for place in places} == wanted
    assert len({cell.key for cell in found}) == len(found)
    assert set(REMARKS) <= {cell.key for cell in found}


def test_printed_reductions_follow_from_the_printed_sizes_within_their_rounding() -> None:
    for figure, errors in Z22_TABLE_3.items():
        for error, (before, after, printed) in errors.items():
            # Both sizes are rounded to 0.1, the reduction too.
            low = 100 * (1 - (after + 0.05) / (before - 0.05)) - 0.05
            high = 100 * (1 - (after - 0.05) / (before + 0.05)) + 0.05
            assert low <= printed <= high, (figure, error)
    before, after, printed = Z22_TABLE_3["E_PV"]["EY0A"]
    assert (printed, round(100 * (1 - after / before), 1)) == (-22.3, -21.6)
    assert round(productivity(1, 95.0, 300.0)) == 68


@pytest.mark.parametrize(
    ("name", "theirs", "ours", "yes"),
    [
        ("EX0C, E_PV, reduction, %", 70.0, 61.0, True),
        ("EX0C, E_PV, reduction, %", 70.0, 59.0, False),
        ("EX0C, E_PV, compensated, µm", 20.0, 13.4, True),
        ("EX0C, E_PV, compensated, µm", 20.0, 13.2, False),
        ("A, Pd, %", 96.0, 94.1, True),
        ("A, Pd, %", 96.0, 93.9, False),
        ("model updates", 12.0, -12.0, False),
    ],
)
def test_a_figure_is_reproduced_within_points_or_a_factor(name: str, theirs: float, ours: float, yes: bool) -> None:
    assert reproduced(Cell("Z22", "Table 3", name, theirs, "%" in name), ours) is yes


def test_each_line_says_theirs_ours_whether_and_why() -> None:
    why = {"Table 2": "any", "Table 2, Z": "of Z"}
    ours = {"Table 2, Y, ARX, RMSE, µm": 1.1, "Table 2, Y, FIR, RMSE, µm": 9.0, "Table 2, Z, ARX, RMSE, µm": 0.1}
    table = cell_table("A", ours, why, "not run")
    lines = {row.cells[0]: row.cells[1:] for row in table.rows}
    assert len(lines) == 24
    assert lines["Table 2, Y, ARX, RMSE, µm"] == ("1", "1.1", "yes", "")
    assert lines["Table 2, Y, FIR, RMSE, µm"] == ("1.6", "9", "no", "any")
    assert lines["Table 2, Z, ARX, RMSE, µm"] == ("3.5", "0.1", "no", "of Z")
    assert lines["Table 2, Z, FIR, P99, µm"] == ("13.2", "–", "not compared", "not run")
    assert counted(table) == "1 of 24 printed figures reproduced, 2 not, 21 not compared"
    with pytest.raises(ValueError, match="does not print 'Table 9'"):
        cell_table("A", {"Table 9": 1.0}, why, "")
