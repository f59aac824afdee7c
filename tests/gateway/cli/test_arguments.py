"""What every command refuses before it begins: texts that are not numbers, and what no option can mean."""

from collections.abc import Iterator

import click
import pytest

from gateway.cli.main import main
from tests.benches.command import here


def options(command: click.Command, name: str = "") -> Iterator[tuple[str, click.Parameter]]:
    """Every parameter of a command and of those below it, with the command's words."""
    yield from ((name, parameter) for parameter in command.params)
    if isinstance(command, click.Group):
        context = click.Context(command)
        for word in command.list_commands(context):  # also those whose modules are imported when they are called
            if (below := command.get_command(context, word)) is not None:
                yield from options(below, f"{name} {word}")


NUMBERS = [
    pytest.param(parameter, id=f"{name} {parameter.opts[0]}".strip())
    for name, parameter in options(main)
    if isinstance(parameter.type, click.types.FloatParamType)
]


@pytest.mark.parametrize("text", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("parameter", NUMBERS)
def test_no_number_of_a_command_is_nan_or_infinite(parameter: click.Parameter, text: str) -> None:
    with pytest.raises(click.BadParameter):
        parameter.type.convert(text, parameter, None)


@pytest.mark.parametrize("parameter", NUMBERS)
def test_a_number_of_a_command_is_read(parameter: click.Parameter) -> None:
    least = max(getattr(parameter.type, "min", None) or 1.0, 1.0)
    assert parameter.type.convert(f"{least:.1f}", parameter, None) == least


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("demo", "--hours", "nan"), "'nan': expected a finite number"),
        (("demo", "--hours", "1e9"), "1000000000.0 is not in the range 1<=x<=10000"),
        (("demo", "--seed", "-1"), "-1 is not in the range x>=0"),
        (("scan", "can", "can0", "--udp-port", "99999"), "99999 is not in the range 1<=x<=65535"),
    ],
)
def test_impossible_values_are_refused_in_words(arguments: tuple[str, ...], said: str) -> None:
    done = here(*arguments)
    assert done.code == 2
    assert said in done.err


def test_a_prefix_that_no_key_can_have_is_refused_by_every_command_that_takes_one() -> None:
    commands = [name.split() for name, parameter in options(main) if "--prefix" in parameter.opts]
    assert sorted(words[0] for words in commands) == ["collect", "command", "opcua", "watch", "web"]
    for words in commands:
        for prefix in ("a//b", "talc/*", "a b", ""):
            done = here(*words, "--prefix", prefix)
            assert done.code == 2
            said = f"Invalid value for '--prefix': {prefix!r}: expected letters, digits, _ and -, parts separated by /"
            assert said in " ".join(done.err.split()), done.err
