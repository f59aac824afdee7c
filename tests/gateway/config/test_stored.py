"""A stored configuration: the whole and what is read of it without its kinds agree, whichever program stored it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gateway.config.extended import stored_configuration
from gateway.config.file import parse
from gateway.config.outline import inputs_if_known, inputs_of_config, outlined, step_s_of
from gateway.storage.configurations import from_stored
from tests.benches.service_file import MACHINE, adam6015

FILE = Path("gateway.toml")
TEXT = f'{MACHINE}\n[grid]\nstep_s = 600\n[[state]]\nname = "spindle_speed"\n' + adam6015("bed = 0, column = 1")
NC = '[nc]\nkind = "sinumerik"\nurl = "opc.tcp://192.168.214.1:4840"\nsecurity = "none"\n'


def stored(change: Callable[[dict[str, Any]], object] = lambda _: None) -> str:
    data = json.loads(parse(TEXT + NC, FILE).canonical())
    change(data)
    return json.dumps(data)


@pytest.mark.parametrize(
    ("change", "method", "step_s"),
    [
        (lambda _: None, "learner", 600.0),
        (lambda data: [data["talc"].pop(name) for name in ("method", "learner", "preset")], "models", 600.0),
        (lambda data: data.pop("talc"), "models", 600.0),
        (lambda data: data.pop("grid"), "learner", 300.0),
    ],
    ids=["today", "before the learner", "without talc", "without a grid"],
)
def test_every_reader_of_a_stored_configuration_understands_the_same(
    change: Callable[[dict[str, Any]], object], method: str, step_s: float
) -> None:
    text = stored(change)
    whole = stored_configuration(text)
    assert (whole.talc.method, whole.grid.step_s) == (method, step_s)
    assert whole.input_names == ("bed", "column", "spindle_speed")
    assert from_stored(text) == whole
    assert outlined(text)["talc"]["method"] == method
    assert step_s_of(text) == step_s
    assert inputs_of_config(text) == inputs_if_known(text) == whole.input_names


@pytest.mark.parametrize("text", ["[1]", "null", '"bed"', "{", ""])
def test_what_is_no_configuration_is_refused_or_says_nothing(text: str) -> None:
    with pytest.raises(ValueError, match=r"valid dictionary|Expecting|property name"):
        stored_configuration(text)
    assert outlined(text) == {}
    assert inputs_if_known(text) == ()
    assert step_s_of(text) == 300.0


def test_a_kind_that_is_gone_is_refused_and_its_inputs_are_still_known() -> None:
    text = stored(lambda data: data["bus"][0].update(kind="gone"))
    with pytest.raises(ValueError, match="gone"):
        stored_configuration(text)
    assert inputs_of_config(text) == ("bed", "column", "spindle_speed")
