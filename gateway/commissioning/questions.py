"""What `talc-gateway init` asks at a terminal: what a scan cannot find out."""

import re
import socket
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, cast

import click

from drivers.base import SetupError
from drivers.problems import read_settings
from drivers.section import Section
from gateway.commissioning.scan.first import (
    Answers,
    ControlAnswers,
    LinuxCncAnswers,
    MtConnectAnswers,
    SinumerikAnswers,
    answers_text,
)
from gateway.commissioning.scan.found import Found, Place
from gateway.commissioning.scan.ports import ScanPort
from gateway.commissioning.scan.unknown import key_of, own_profile
from gateway.runtime.whole_file import write_whole

_CONTROLS: Final[Mapping[str, tuple[type[ControlAnswers], Mapping[str, str]]]] = {
    "sinumerik": (
        SinumerikAnswers,
        {
            "url": "Address of its OPC UA server",
            "user": "OPC UA user",
            "folder": "Folder of password, certificates and key",
        },
    ),
    "linuxcnc": (LinuxCncAnswers, {"host": "Host of its agent", "key_file": "Copy of the agent's key"}),
    "agent": (LinuxCncAnswers, {"host": "Host of the agent", "key_file": "Copy of the agent's key"}),
    "mtconnect": (
        MtConnectAnswers,
        {"url": "Address of its MTConnect agent", "machine": "Its machine's name, if the agent has several"},
    ),
}
"""Kind of control to its answers, and the question for each of them."""
_WIRES = ("serial", "slcan", "can", "hosts")
_USUAL = "usual"
_NONE = "none"


def keep(path: Path, answers: Answers) -> None:
    """Write the answers to a file that `init` proposes them from when it is run again."""
    write_whole(path, answers_text(answers))


def asked(ports: list[ScanPort], earlier: Answers | None, kept: Path) -> Answers:
    """The integrator's answers; each is asked for again if it is invalid. Ctrl-C, and an input that has ended, end the
    command, and what was answered until then is kept."""
    data: dict[str, object] = {} if earlier is None else earlier.model_dump(mode="json", exclude_none=True)
    try:
        _ask(data, ports)
    except click.Abort:
        if "machine" in data:
            keep(kept, read_settings(Answers, data))
        raise
    return read_settings(Answers, data)


def _ask(data: dict[str, Any], ports: list[ScanPort]) -> None:
    """Replaces the answers in `data`, which are the defaults."""
    host = re.sub(r"\W", "_", socket.gethostname().split(".")[0], flags=re.ASCII)
    name = data.get("machine", host)
    data["machine"] = click.prompt("Name of the machine", default=name, value_proc=_valid("machine"))
    first = not any(data.get(kind) for kind in _WIRES)
    listed = {port.name for port in ports}
    others = click.prompt(
        "Other serial ports, by their path, with blanks between" if listed else
        "Serial ports (none was found): their paths, with blanks between",
        default=" ".join(name for kind in ("serial", "slcan") for name in data.get(kind, ()) if name not in listed),
        value_proc=lambda text: _valid("serial")(text.split()),
    )  # fmt: skip
    for kind in ("serial", "slcan"):
        data[kind] = [name for name in data.get(kind, ()) if name in listed or name in others]
    for port in (*ports, *(ScanPort("serial", name, "as given") for name in others)):
        kinds = ["serial", "slcan"] if port.command == "serial" else [port.command]
        before = [kind for kind in kinds if port.name in data.get(kind, ())]
        default = before[0] if before else kinds[-1 if "can" in port.name.lower() else 0] if first else "no"
        answer = click.prompt(
            f"Look for devices on {port.name} ({port.remark})?", type=click.Choice([*kinds, "no"]), default=default
        )
        for kind in kinds:
            others = [name for name in data.get(kind, ()) if name != port.name]
            data[kind] = [*others, port.name] if kind == answer else others
    data["hosts"] = click.prompt(
        "Modbus TCP devices and Micro-Epsilon controllers, host or host:port, with blanks between",
        default=" ".join(data.get("hosts", ())),
        value_proc=lambda text: _valid("hosts")(text.split()),
    )
    if data["hosts"] or data.get("serial"):
        usual = data.get("units") or _USUAL
        units = click.prompt("Modbus units to ask, such as 1-16,40", default=usual, value_proc=_units)
        data["units"] = units
        if units is None:
            del data["units"]
    _ask_control(data)


def _ask_control(data: dict[str, Any]) -> None:
    before = data.get("control", {})
    kind = click.prompt("Control", type=click.Choice(["none", *_CONTROLS]), default=before.get("kind", "none"))
    data.pop("control", None)
    if kind == "none":
        return
    fields, questions = _CONTROLS[kind]
    control = {"kind": kind}
    for name, question in questions.items():
        usual = before.get(name, fields.model_fields[name].default)
        control[name] = click.prompt(question, default=usual, value_proc=_valid(name, fields, {"kind": kind}))
    data["control"] = control


def _units(text: str) -> str | None:
    return None if text.strip() == _USUAL else cast("str", _valid("units")(text.strip()))


def _valid(
    field: str, settings: type[Section] = Answers, others: Mapping[str, str] = MappingProxyType({"machine": "m"})
) -> Callable[[object], Any]:
    """Returns a valid answer to one question; click asks again for another one."""

    def checked(answer: object) -> Any:
        try:
            return read_settings(settings, {**others, field: answer}).model_dump(mode="json")[field]
        except SetupError as error:
            raise click.UsageError(str(error)) from None

    return checked


def with_own_profiles(answers: Answers, unknown: Iterable[tuple[Place, Found]]) -> Answers:
    """Asked for each of these devices that has none yet."""
    profiles = dict(answers.profiles)
    for place, device in unknown:
        key = key_of(place, device)
        if key in profiles:
            continue
        named = click.prompt(
            f"Profile of your own for unit {device.unit} at {place.title}",
            default=_NONE,
            value_proc=partial(_own_profile, place),
        )
        if named != _NONE:
            profiles[key] = named
    return answers.model_copy(update={"profiles": profiles})


def _own_profile(place: Place, name: str) -> str:
    try:
        if name != _NONE:
            own_profile(str(Path(name).absolute()), place)
    except SetupError as error:
        raise click.UsageError(str(error)) from None
    return name
