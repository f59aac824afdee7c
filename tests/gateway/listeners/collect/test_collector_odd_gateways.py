"""Gateways whose answers are invalid, late or from an earlier program are reported, and no other machine waits."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from gateway.listeners.collect.folder import SiteFolder
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.telemetry.answers import StoredColumn, StoredRows, StoredTable
from gateway.telemetry.asking import QueryRefusal
from tests.benches.stored_site import StoredSite, catch_up, collector, expected, kept, rows, write


class Liar(StoredSite):
    """A site some of whose gateways answer something else."""

    def __init__(self, folder: Path, answers: Mapping[str, StoredRows | Exception]) -> None:
        super().__init__(folder)
        self.answers: Mapping[str, StoredRows | Exception] = answers

    def running(self) -> list[str]:
        return sorted({*super().running(), *self.answers})

    def ask(self, machine: str, after: Mapping[str, tuple[str, int] | None], limit: int) -> StoredRows:
        answer = self.answers.get(machine)
        if isinstance(answer, Exception):
            raise answer
        return super().ask(machine, after, limit) if answer is None else answer


E = "e" * 32
TIME = StoredColumn("time", "time", [1.7e9, 1.7e9])
ONE = StoredColumn("time", "time", [1.7e9])


def test_rows_that_are_sent_again_are_kept_once_and_an_empty_promise_of_more_is_not_asked_without_end(
    stored_site: StoredSite, tmp_path: Path
) -> None:
    same = StoredRows({"events": StoredTable(E, 2, more=True, numbers=[1, 2], columns=(TIME,))})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(Liar(stored_site.folder, {"lathe": same}), folder)
        assert catch_up(collecting) == 2
        catch_up(collecting, 30.0)
    assert [row["row"] for row in rows(tmp_path / "site", "events", "lathe")] == [1, 2]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (StoredTable(E, 2, numbers=[2, 1], columns=(TIME,)), "rows 2 to 1 do not ascend"),
        (StoredTable(E, 2, numbers=[1, 1], columns=(TIME,)), "rows 1 to 1 do not ascend"),
        (StoredTable(E, 2, numbers=[1, 3], columns=(TIME,)), "rows 1 to 3 do not ascend up to 2"),
        (StoredTable(E, 2**62), f"rows end at -1000000, but the page says that it goes up to {2**62}"),
        (StoredTable(E, 2**62, numbers=[1], columns=(ONE,)), "rows end at 1, but the page says that it goes up to"),
        (
            StoredTable(E, 1, numbers=[1], columns=(StoredColumn("time", "time", [9e12]),)),
            "column time: 9e+12 s is not within the years 1970 to 2200",
        ),
        (
            StoredTable(E, 1, numbers=[1], columns=(StoredColumn("time", "time", [-9e9]),)),
            "column time: -9e+09 s is not within",
        ),
        (StoredTable(E, 2, numbers=[1], columns=(TIME,)), "column time: 2 values for 1 rows"),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("t", "text", [7], ("a",)),)), "column t: "),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("k", "whole", [1.5]), ONE)), "column k: "),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("k", "blob", [1]), ONE)), "kind 'blob' is not known"),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("time", "time", [1e300]),)), "column time: "),
        (StoredTable(E, 1, numbers=[1], columns=(StoredColumn("time", "time", [None]),)), "rows without a time"),
        (StoredTable(E, 1, numbers=[1], columns=(StoredColumn("k", "whole", [1]),)), "rows without a time"),
        (StoredTable(E, 2**70, numbers=[1], columns=(ONE,)), f"row {2**70}: no row has such a number"),
        (StoredTable(E, 2**70, numbers=[2**70], columns=(ONE,)), f"row {2**70}: no row has such a number"),
        (StoredTable(E, 1, numbers=[1], columns=(ONE,), thinned=2**70), f"row {2**70}: no row has such a number"),
        (StoredTable("a,b:3;limit=9", 1, numbers=[1], columns=(ONE,)), "epoch 'a,b:3;limit=9': expected 32"),
        (StoredTable("", 1, numbers=[1], columns=(ONE,)), "epoch '': expected 32 hexadecimal digits"),
        (
            StoredTable(E, 1, numbers=[1], columns=(ONE, *2 * [StoredColumn("a", "number", [1.0])])),
            "column a: occurs twice",
        ),
        (
            StoredTable(E, 1, numbers=[1], columns=(ONE, StoredColumn("epoch", "number", [1.0]))),
            "column epoch: occurs twice",
        ),
        (
            StoredTable(E, 1, numbers=[1], columns=(ONE, StoredColumn("day", "number", [1.0]))),
            "column day: occurs twice",
        ),
        (StoredTable(E, 1, numbers=[1], columns=(ONE, StoredColumn("t", "text", [0.5], ("a",)))), "column t: "),
        (StoredTable(more=True), "events: has no epoch, not even from the beginning"),
        (StoredTable(problem="events cannot be read: a page is damaged"), "events cannot be read"),
    ],
)
def test_an_invalid_answer_is_reported_and_holds_up_no_other_machine(
    table: StoredTable, said: str, stored_site: StoredSite, tmp_path: Path
) -> None:
    write(stored_site, "mill", range(3))
    liar = Liar(stored_site.folder, {"lathe": StoredRows({"events": table})})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(liar, folder)
        catch_up(collecting)
        assert said in collecting.machines["lathe"].problem
        assert collecting.machines["mill"].problem == ""
    assert kept(tmp_path / "site") == expected(range(3))
    assert rows(tmp_path / "site", "events", "lathe") == []


@pytest.mark.parametrize("name", ["..", ".", "a b", "ä", "../../etc", "x" * 65, "machine=mill", "", "mill\n"])
def test_a_name_that_means_something_in_a_path_is_refused(name: str, stored_site: StoredSite, tmp_path: Path) -> None:
    write(stored_site, "mill", range(3))
    answer = StoredRows({"events": StoredTable(E, 1, numbers=[1], columns=(ONE,))})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(Liar(stored_site.folder, {name: answer}), folder)
        catch_up(collecting)
        assert "no gateway has such a name" in collecting.machines[name].problem
    places = {p.name for p in (tmp_path / "site").glob("*/machine=*")}
    assert places == {"machine=mill"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["gateways", "site"]


def test_no_answer_and_a_table_of_a_later_program_are_taken_as_they_are(
    stored_site: StoredSite, tmp_path: Path
) -> None:
    later = StoredRows({"spectra": StoredTable(E, 1, numbers=[1], columns=(ONE,))})
    liar = Liar(stored_site.folder, {"lathe": OSError("no answer"), "saw": later})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(liar, folder)
        catch_up(collecting)
    assert {name: asked.problem for name, asked in collecting.machines.items()} == {"lathe": "no answer", "saw": ""}
    assert not (tmp_path / "site" / "spectra").exists()


class EarlierSite(StoredSite):
    """Gateways of a program that does not have the table `reasons` yet; `renewed`: a program that has it."""

    renewed = False
    refusal = QueryRefusal("reasons: no such table")

    def ask(self, machine: str, after: Mapping[str, tuple[str, int] | None], limit: int) -> StoredRows:
        if "reasons" in after and not self.renewed:
            self.asked.append(machine)
            raise self.refusal
        return super().ask(machine, after, limit)


HAS = ("measurements", "steps", "models", "events", "compensation", "minutes", "readings", "runs", "commands")


@pytest.mark.parametrize(
    "refusal",
    [
        QueryRefusal(Text(NoticeCode.NO_SUCH_TABLE, table="reasons", tables=HAS)),
        QueryRefusal("in words that nobody knows"),
    ],
    ids=["that says which it has", "that has no codes"],
)
def test_a_gateway_of_an_earlier_program_gives_its_tables_and_the_others_after_its_next_start(
    refusal: QueryRefusal, stored_site: StoredSite, tmp_path: Path
) -> None:
    write(stored_site, "mill", range(20))
    earlier = EarlierSite(stored_site.folder)
    earlier.refusal = refusal
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(earlier, folder)
        catch_up(collecting)
        assert kept(tmp_path / "site") == {**expected(range(20)), "reasons": []}
        assert collecting.machines["mill"].problem == ""
        earlier.asked.clear()
        catch_up(collecting, 60.0)
        assert earlier.asked == ["mill"], "it is not asked in vain each time"
        earlier.renewed = True
        write(stored_site, "mill", range(20, 40), "boot-2")
        for now_s in (120.0, 180.0):
            catch_up(collecting, now_s)
        assert kept(tmp_path / "site") == expected(range(40))


def test_a_gateway_that_says_to_have_no_table_at_all_is_asked_for_all_of_them_again(
    stored_site: StoredSite, tmp_path: Path
) -> None:
    write(stored_site, "mill", range(20))
    odd = Liar(
        stored_site.folder,
        {"mill": QueryRefusal(Text(NoticeCode.NO_SUCH_TABLE, table="readings", tables=("spectra",)))},
    )
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(odd, folder)
        catch_up(collecting)
        assert collecting.machines["mill"].problem == "readings: no such table; there are spectra"
        odd.answers = {}
        catch_up(collecting, 60.0)
        assert kept(tmp_path / "site") == expected(range(20))


def test_an_unexpected_exception_is_logged_with_its_traceback_once_for_all_machines_and_turns(
    stored_site: StoredSite, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    machines = [f"m{n}" for n in range(7)]
    liar = Liar(stored_site.folder, {name: RecursionError("too deep") for name in machines})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(liar, folder)
        for now_s in (0.0, 30.0, 60.0):
            catch_up(collecting, now_s)
        assert {collecting.machines[name].problem for name in machines} == {"unexpected RecursionError: too deep"}
    assert [(record.message, record.exc_info is not None) for record in caplog.records] == [
        ("m0: not collected: unexpected RecursionError: too deep", True),
        ("m0, m1, m2, m3, m4 and 2 more: not collected: unexpected RecursionError: too deep", False),
    ]


def test_machines_that_are_often_away_do_not_fill_the_log(
    stored_site: StoredSite, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    machines = [f"m{n}" for n in range(3)]
    liar = Liar(stored_site.folder, {})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(liar, folder)
        for turn in range(200):
            liar.answers = {name: StoredRows({}) if turn % 2 else OSError("no answer") for name in machines}
            catch_up(collecting, 45.0 * turn)
        assert len(caplog.messages) == 7, "three beginnings and ends, and the beginning of what is intermittent"
        assert "300 s" in caplog.messages[-1]
        for turn in range(200, 212):
            catch_up(collecting, 45.0 * turn)
    assert len(caplog.messages) == 8, "it has been steady"
    assert all(line.startswith("m0, m1, m2: ") for line in caplog.messages)


def test_a_problem_of_many_machines_is_reported_in_one_line_when_it_begins_and_when_it_ends(
    stored_site: StoredSite, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    liar = Liar(stored_site.folder, {f"m{n}": OSError("no answer") for n in range(7)})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(liar, folder)
        well = {f"m{n}": StoredRows({}) for n in range(7)}
        lines = []
        for turn, answers in enumerate((liar.answers, liar.answers, well, {}, {}, {"m0": StoredRows({})}, well)):
            liar.answers = answers
            catch_up(collecting, 30.0 * turn)
            lines.append(len(caplog.messages))
    assert lines == [1, 1, 2, 3, 3, 4, 4], "as all of them go, come back, are not even heard, and are heard"
    for line in caplog.messages[:2]:
        assert line.startswith("m0, m1, m2, m3, m4 ")
        assert " 2 " in line, "so many more"
