"""Commands that look at a wire by hand have the defaults and bounds of a bus's settings."""

from collections.abc import Iterator
from typing import Literal

import click
import pytest
from click.testing import CliRunner
from pydantic import Field

from drivers.base import SetupError
from drivers.bus_settings import BusSettings
from drivers.micro_epsilon.settings import MeEthernetSettings
from drivers.modbus.settings import ModbusTcpSettings
from drivers.section import LONGEST_ANSWER_S, Section
from gateway.cli.arguments import field_option
from gateway.cli.main import main
from gateway.commissioning.scan.serial import plan
from tests.benches.command import here
from tests.benches.refusals import refusing


def commands() -> Iterator[tuple[str, click.Command]]:
    """Those that look at a wire by hand."""
    for group in ("scan", "inspect"):
        found = main.get_command(click.Context(main), group)
        assert isinstance(found, click.Group)
        context = click.Context(found)
        for name in found.list_commands(context):
            command = found.get_command(context, name)
            assert command is not None
            yield f"{group} {name}", command


def test_each_waits_for_an_answer_as_long_as_a_bus_may() -> None:
    longest = {
        name: option.type.max
        for name, command in commands()
        for option in command.params
        if option.name == "timeout_s" and isinstance(option.type, click.FloatRange)
    }
    assert set(longest) >= {"scan serial", "scan tcp", "scan can", "inspect registers", "inspect objects"}
    assert set(longest.values()) == {LONGEST_ANSWER_S}


@pytest.mark.parametrize("settings", [ModbusTcpSettings, MeEthernetSettings])
def test_the_help_names_the_ports_that_are_tried(settings: type[BusSettings]) -> None:
    assert f"{settings.model_fields['port'].default} (" in here("scan", "tcp", "--help").out


class OtherSettings(Section):
    """With other defaults and bounds than any bus."""

    baud: int = Field(default=77, ge=70, le=80)
    parity: Literal["M", "S"] = "S"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ((), 0, "77 S"),
        (("--baud", "80", "--parity", "M"), 0, "80 M"),
        (("--baud", "69"), 2, "70<=x<=80"),
        (("--baud", "81"), 2, "70<=x<=80"),
        (("--parity", "N"), 2, "'M', 'S'"),
        (("--help",), 0, "default: 77; 70<=x<=80"),
    ],
)
def test_an_option_of_a_field_has_its_default_and_its_bounds(words: tuple[str, ...], code: int, said: str) -> None:
    @click.command()
    @field_option("--baud", OtherSettings, "baud")
    @field_option("--parity", OtherSettings, "parity", "As on the line.")
    def command(baud: int, parity: str) -> None:
        click.echo(f"{baud} {parity}")

    done = CliRunner(env={"COLUMNS": "120"}).invoke(command, words)
    assert done.exit_code == code
    assert said in done.output


@pytest.mark.parametrize(
    ("field", "timeout_s"), [("port: path_no_file value='/'", 1.0), ("timeout_s: expected at_most", 61.0)]
)
def test_a_plan_of_what_no_bus_could_have_names_the_field(field: str, timeout_s: float) -> None:
    with refusing(SetupError, field):
        plan("/" if "port" in field else "/dev/null", bauds=(9600,), parities=("N",), units=(1,), me_bauds=(),
             me_addresses=(), timeout_s=timeout_s)  # fmt: skip
