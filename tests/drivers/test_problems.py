"""Messages about invalid settings: every mistake, its place, its value and what is expected."""

from types import MappingProxyType
from typing import Literal

import pytest
from pydantic import Field

from drivers.base import SetupError
from drivers.problems import read_settings
from drivers.section import FilePath, Section, wrong


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
        ({"lenght": 1.0}, "length: missing; is 'lenght' meant to be it?"),
        ({"other": 1.0}, "length: missing; it has no default; other: unknown key; possible: file, inner, length"),
        ({"length": "1.0", "mode": "fats"}, "length: '1.0': expected a number; mode: 'fats' is invalid; "),
        ({"length": 1, "rule": [{"size": 1}, {"size": 0}]}, r"rule\[1\].size: 0: expected at least 1$"),
        ({"length": 1, "inner": {"size": 1, "sice": 2}}, "inner.sice: unknown key; did you mean 'size'?"),
        ({"length": True}, "length: true: expected a number"),
        ({"length": float("nan")}, "length: nan: expected a finite number"),
    ],
)  # fmt: skip
def test_every_mistake_is_named_with_place_value_and_what_would_be_right(data: dict[str, object], said: str) -> None:
    with pytest.raises(SetupError, match=rf"^own\.toml: {said}"):
        read_settings(Outer, data, file="own.toml")


def test_bus_and_device_stand_before_the_mistake() -> None:
    with pytest.raises(SetupError, match=r"^bus b, device d: length: missing") as caught:
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
                raise wrong(f"{self.low.size} is not below {self.high.size}", "low", "size")

    with pytest.raises(SetupError, match=r"^low\.size: 3 is not below 2$"):
        read_settings(Pair, {"low": {"size": 3}, "high": {"size": 2}})
