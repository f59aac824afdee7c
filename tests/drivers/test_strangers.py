"""Devices that nobody here wrote, drawn from seeds: no wrong value, and read whenever a plain client can read them.

The seeds are the first ones, not selected; `python -m tests.benches.strangers --seeds 200000` tries more of them.
"""

import logging
from collections.abc import Iterator

import pytest

from tests.benches.strangers import can_trial, me_trial, mqtt_trial, opcua_trial
from tests.benches.strangers.modbus_nature import Nature
from tests.benches.strangers.modbus_trial import Trial, tried

FIRST = 200
TOGETHER = 20
KEPT = (
    329, 399, 413, 454, 493, 542, 577, 722, 734, 758, 808, 825, 868, 1916, 3290, 3367, 3483, 4915, 6467, 6699, 6721,
    20462, 301559, 302092, 302354, 304339, 305102, 310461, 310883, 311427, 314777, 331882, 331949, 401240, 401953,
    403124, 404538, 500300,
)  # fmt: skip
"""Each showed another register, or an old value, or was never read, once."""


@pytest.fixture(autouse=True)
def no_log() -> Iterator[None]:
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


SLOW = tuple(Nature(wire, period_s=0.5, timeout_s=0.5, took_s=0.6) for wire in ("tcp", "rtu"))
"""Slower than their timeout and their period."""


@pytest.mark.parametrize("begin", range(0, FIRST, TOGETHER))
def test_the_first_ones(begin: int) -> None:
    problems = {seed: found for seed in range(begin, begin + TOGETHER) if (found := list(tried(seed).problems()))}
    assert not problems


@pytest.mark.parametrize("seed", KEPT)
def test_those_that_were_read_wrongly_once(seed: int) -> None:
    trial = tried(seed)
    assert not list(trial.problems()), trial.nature


@pytest.mark.parametrize("seed", [*range(24), 328])
def test_micro_epsilon_controllers(seed: int) -> None:
    """The first ones, and one that showed a frozen value on a new connection; `--of me` tries more of them."""
    trial = me_trial.tried(seed)
    assert not list(trial.problems()), trial.nature


@pytest.mark.parametrize("seed", [*range(5), 17, 53, 57, 99, 118, 146, 165, 309, 338, 820])
def test_canopen_nodes(seed: int) -> None:
    """The first ones, and some that need a rest, lose requests or are slow; `--of can` tries more of them."""
    trial = can_trial.tried(seed)
    assert not list(trial.problems()), trial.nature


@pytest.mark.parametrize("behind", [1, -1])
def test_one_that_keeps_an_answer_for_longer_than_any_is_late(behind: int) -> None:
    """It comes at the next request, half a minute later, and looks like the answer to that."""
    trial = Trial(Nature("rtu", blocks=2, behind=behind, period_s=30.0, timeout_s=1.2), 1)
    trial.run()
    assert not trial.ours.wrong


@pytest.mark.parametrize("seed", [*range(24), 39, 98, 115, 194, 244])
def test_opc_ua_servers(seed: int) -> None:
    """The first ones, and some that are slow, lose requests or hang up; `--of opcua` tries more of them."""
    trial = opcua_trial.tried(seed)
    assert not list(trial.problems()), trial.nature


@pytest.mark.parametrize("seed", [*range(8), 84, 105])
def test_mqtt_brokers(seed: int) -> None:
    """The first ones, and two whose messages overtake each other; `--of mqtt` tries more of them."""
    trial = mqtt_trial.tried(seed)
    assert not list(trial.problems()), trial.nature


@pytest.mark.parametrize("nature", SLOW, ids=str)
def test_those_that_are_slower_than_they_may_be(nature: Nature) -> None:
    trial = Trial(nature, 1)
    trial.run()
    assert not list(trial.problems())
