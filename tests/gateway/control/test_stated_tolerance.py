"""The tolerance that a part program states: from the control's state to the frame, the record and the replay."""

from pathlib import Path

import numpy as np
import pytest

from gateway.config.file import parse
from gateway.config.problems import ConfigError
from gateway.control.grid import GridSampler, Instant
from gateway.control.replay.stored import replay
from gateway.control.restart.rebuild import controller_of
from gateway.service.report_data import Reader, collect
from gateway.storage.history import History
from gateway.storage.store import Store
from talc.frame import EventKind
from tests.benches.restarted import restarted
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stored_steps import record_step

BOUNDS = "[talc.learner]\nleast_limit_um = 2.0\nmost_limit_um = 20.0\n"
STATE = '[[state]]\nname = "tolerance_um"\nuse = "tolerance"\n'
NC = (
    '[nc]\nkind = "sinumerik"\nurl = "opc.tcp://127.0.0.1:4840"\nsecurity = "none"\n'
    '[nc.states.tolerance_um]\npath = "/Channel/Parameter/R[u1,100]"\n'
)
FILE = MACHINE + '[storage]\npath = "a.sqlite"\n' + adam6015("a = 0")


def test_a_stated_tolerance_is_followed_stored_and_replayed_bit_for_bit(tmp_path: Path) -> None:
    config = parse(FILE + STATE + NC + BOUNDS, tmp_path / "gateway.toml")
    assert (config.input_names, config.tolerance_state) == (("a",), "tolerance_um")
    sampler = GridSampler(config.input_names, config.grid.step_s, config.tolerance_state)
    controller, limits = controller_of(config), []
    with Store(config.storage.path, "boot", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k, stated in enumerate([None, 3.0, 3.0, None, 0.1, 0.0, 7.3]):
            now = 300.0 * (k + 1)
            sampler.add_states({"a": 20.0} | ({} if stated is None else {"tolerance_um": stated}), now - 1.0)
            frame = sampler.frame(Instant(k, now))
            assert np.isfinite(frame.inputs).all()
            decision, _ = record_step(store, controller, frame)
            told = [event for event in decision.events if event.kind is EventKind.TOLERANCE_STATED]
            limits.append((float(decision.limits[0]), bool(told)))
    assert limits == [(5.0, False), (3.0, True), (3.0, False), (3.0, False), (2.0, True), (5.0, True), (7.3, True)]
    with History(config.storage.path) as history:
        result = replay(history)
        latest = list(history.steps())[-1]
    assert result.identical, result.first
    assert latest.frame.tolerance_um == 7.3
    assert restarted(config).controller.state().course.tolerance_um == 7.3  # type: ignore[union-attr]
    assert [collect(config.storage.path, reader=Reader(tolerance_um=um)).tolerance_um for um in (None, 2.0)] == [
        7.3,
        2.0,
    ]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (STATE + NC, "least_limit_um and most_limit_um"),
        (STATE + STATE.replace("tolerance_um", "spindle_speed") + NC + BOUNDS, "is the tolerance already"),
        (STATE + NC + "[talc.learner]\nleast_limit_um = 2.0\n", "most_limit_um"),
    ],
)
def test_what_cannot_be_followed_is_refused(text: str, what: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=what):
        parse(FILE + text, tmp_path / "gateway.toml")
