"""Messages about invalid settings: every mistake, its place, its value and what is expected."""

from types import MappingProxyType
from typing import Literal

import pytest
from pydantic import Field

from drivers.base import SetupError
from drivers.problems import read_settings
from drivers.section import FilePath, Section, wrong
from drivers.text import Text
from tests.benches.refusals import refusing


class Inner(Section):
    """A table in a table."""

    size: int = Field(ge=1)


class Outer(Section):
    """A table."""

    length: float
    inner: Inner | None = None
    rules: tuple[Inner, ...] = Field(default=(), alias="rule")
    mode: Literal["fast", "slow"] = "slow"
    file: FilePath | None = None


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"lenght": 1.0}, "length: missing_misspelt other=lenght"),
        ({"other": 1.0}, "missing_no_default unknown_key possible"),
        ({"length": "1.0", "mode": "fats"}, "expected value='1.0' a_number invalid value='fats' mean"),
        ({"length": 1, "rule": [{"size": 1}, {"size": 0}]}, "rule[1].size: expected value=0 at_least limit=1"),
        ({"length": 1, "inner": {"size": 1, "sice": 2}}, "inner.sice: unknown_key mean name=size"),
        ({"length": True}, "length: expected value=true a_number"),
        ({"length": float("nan")}, "length: expected value=nan a_finite_number"),
    ],
)  # fmt: skip
def test_every_mistake_is_named_with_place_value_and_what_would_be_right(data: dict[str, object], said: str) -> None:
    with refusing(SetupError, said):
        read_settings(Outer, data, file="own.toml")


def test_bus_and_device_stand_before_the_mistake() -> None:
    with refusing(SetupError, "length: missing_no_default") as caught:
        read_settings(Outer, {}, bus="b", device="d")
    assert (caught.value.bus, caught.value.device) == ("b", "d")


def test_any_mapping_is_a_table_and_paths_start_at_the_folder() -> None:
    data = MappingProxyType({"length": 2, "inner": MappingProxyType({"size": 3}), "file": "a.dbc"})
    found = read_settings(Outer, data, {"folder": "/etc/talc"})
    assert (found.length, found.inner, str(found.file)) == (2.0, Inner(size=3), "/etc/talc/a.dbc")


def test_a_validator_can_name_a_field_below_its_own() -> None:
    class Pair(Section):
        low: Inner
        high: Inner

        def model_post_init(self, _context: object) -> None:
            if self.low.size >= self.high.size:
                raise wrong(Text("at_most", limit=self.high.size), "low", "size")

    with refusing(SetupError, "low.size: at_most limit=2"):
        read_settings(Pair, {"low": {"size": 3}, "high": {"size": 2}})
