"""The DBC file and the profile of an emulated CAN logger, as its maker and a user would write them."""

from pathlib import Path

INPUTS = 5
_INVALID = """invalid = [{ mask = 0xFFFF, equals = 0x7FFF, quality = "sensor_fault", detail = "open" },
           { mask = 0xFFFF, equals = 0x8000, quality = "sensor_fault", detail = "short" }]"""


def logger_dbc(first: int = 0x300) -> str:
    """Four inputs in a first message, one in the next, a real number in a third."""
    signals = "".join(f' SG_ T{i} : {16 * i}|16@1- (0.1,0) [-200|850] "degC" G\n' for i in range(4))
    return f"""VERSION ""
NS_ :
BS_:
BU_: L G
BO_ {first} First: 8 L
{signals}
BO_ {first + 1} Second: 2 L
 SG_ T4 : 0|16@1- (0.1,0) [-200|850] "degC" G

BO_ {first + 2} Real: 4 L
 SG_ F : 0|32@1- (1,0) [0|0] "" G

SIG_VALTYPE_ {first + 2} F : 1;
"""


def logger_profile_text(name: str) -> str:
    """The profile beside `name`.dbc, one channel for each input."""
    text = f'protocol = "can_dbc"\ntitle = "Logger"\nunit = "degC"\ndbc = "{name}.dbc"\n'
    for i in range(INPUTS):
        text += f'[[signal]]\nmessage = "{"First" if i < 4 else "Second"}"\nname = "T{i}"\n{_INVALID}\n'
    return text


def logger_profile(folder: Path, name: str = "logger", first: int = 0x300, *, text: str | None = None) -> str:
    """Write both files into the folder; gives the path of the profile."""
    (folder / f"{name}.dbc").write_text(logger_dbc(first))
    (folder / f"{name}.toml").write_text(logger_profile_text(name) if text is None else text)
    return str(folder / f"{name}.toml")
