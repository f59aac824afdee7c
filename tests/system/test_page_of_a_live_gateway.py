"""The page for operators beside a gateway that runs: service, wires, control, store and page are the real programs.

The machine is emulated: once in fast motion, so that something is learnt, and once at this computer's own speed, so
that wires break, the control goes and a person gives orders.
"""

import os
import re
import signal
from pathlib import Path

import pytest
from playwright.sync_api import expect

from gateway.runtime.passwords import make_hash
from gateway.storage.history import History
from tests.benches.page_rig import LIMIT_MS, ChildProgram, page_rig
from tests.benches.soak import config

pytestmark = [pytest.mark.peer, pytest.mark.slow]

PATH = "/machine/bench"
OPERATOR = """
[[telemetry.operator]]
name = "anna"
key_file = "anna.key"
may = ["pause", "resume"]
"""

expect.set_options(timeout=LIMIT_MS)


def tell(machine: ChildProgram, what: str) -> None:
    machine.say(what)
    assert machine.hear() == "done"


@pytest.mark.waits(60)
def test_faults_orders_and_a_power_cut_of_a_gateway_that_runs(tmp_path: Path) -> None:
    (tmp_path / "anna.key").write_text("anna" * 10, encoding="utf-8")
    (tmp_path / "anna.key").chmod(0o600)
    users = f'[users]\nanna = "{make_hash("secret")}"\n[operators]\nanna = "anna.key"\n'
    (tmp_path / "web.toml").write_text(users, encoding="utf-8")
    file = tmp_path / "gateway.toml"
    with page_rig() as rig:
        machine, places = rig.live_machine(tmp_path)
        settings = config(tmp_path, places, real=True)
        file.write_text(file.read_text("utf-8") + OPERATOR, encoding="utf-8")
        gateway = rig.live_gateway(file)
        rig.serve([int(settings.telemetry.listen[0].rsplit(":", 1)[1])], tmp_path / "web.toml")
        with rig.page(PATH, user=("anna", "secret")) as page:
            health, in_doubt = page.locator("#health"), page.locator("#channels li.not-good")
            expect(health).to_contain_text("30 of 30 good")
            expect(health).to_contain_text("ready")
            expect(in_doubt).to_have_count(0)

            tell(machine, "begin a wire is broken")
            expect(in_doubt).to_have_count(1)
            expect(in_doubt).to_contain_text("spindle_rear")
            expect(page.locator("#doubts")).to_contain_text("spindle_rear")
            tell(machine, "end a wire is broken")
            expect(in_doubt).to_have_count(0)

            tell(machine, "begin the RTU adapter is pulled out")
            for where in ("#failed", "#notices"):
                expect(page.locator(where)).to_contain_text("rtu1")
            tell(machine, "end the RTU adapter is pulled out")
            # Whether this computer keeps its clock by a server is told there too, as an open problem.
            expect(page.locator("#failed")).not_to_contain_text("rtu1")
            of_bus = page.locator("#events tbody tr").filter(has_text="bus rtu1").locator(".when")
            expect(of_bus.first).to_be_attached()
            expect(of_bus.filter(has_not_text="–")).to_have_count(0)

            tell(machine, "begin the control is off")
            expect(health).to_contain_text("does not answer")
            tell(machine, "end the control is off")
            expect(health).not_to_contain_text("does not answer")

            page.click("#command-pause")
            page.click("#confirm-yes")
            expect(page.locator("#command-answer")).to_contain_text("Accepted")
            expect(page.locator("#notices")).to_contain_text("The compensation is paused by anna")
            os.kill(gateway.pid, signal.SIGSTOP)
            expect(page.locator("#word")).to_have_text(re.compile("^(Gone|Silent)$"))
            expect(page.locator("#notices")).to_be_empty()
            os.kill(gateway.pid, signal.SIGCONT)
            expect(page.locator("#word")).not_to_have_text(re.compile("^(Gone|Silent)$"))
            expect(page.locator("#notices")).to_contain_text("The compensation is paused by anna")
            gateway.kill()
            expect(page.locator("#word")).to_have_text("Gone")
            rig.live_gateway(file)
            expect(page.locator("#word")).not_to_have_text("Gone")
            expect(health).to_contain_text("30 of 30 good")
            expect(page.locator("#notices")).to_contain_text("The compensation is paused by anna")
    with History(settings.storage.path) as history:
        assert [(o.command.name, o.command.by, o.accepted) for o in history.commands()] == [("pause", "anna", True)]
