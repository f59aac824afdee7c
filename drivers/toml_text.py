"""TOML as people write it: the line of each key, and what is likely wrong with a line that cannot be read."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import dropwhile, takewhile
from typing import Final, TypeAlias

from drivers.text import Text, plain

Location: TypeAlias = tuple[str | int, ...]

_TOKEN: Final = re.compile(
    r""""{3}(?:\\.|[^\\])*?(?:"{3,5}|\\?\Z)|'{3}.*?(?:'{3,5}|\Z)|"(?:\\.|[^"\\\n])*+"?|'[^'\n]*+'?"""
    r"""|#[^\n]*|[\[\]{}\n]""",
    re.DOTALL,
)
"""Texts and comments, in which no bracket counts, brackets, and ends of lines. A text without an end is one, too."""
_PART: Final = re.compile(rf"""{_TOKEN.pattern}|,|[^\s\[\]{{}},"'#]+""", re.DOTALL)
"""Likewise, and commas and all other values."""
_DEEP: Final = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*\.[ \t]*){40}""")
"""A key of so many names; the parser's memory grows with the square of their number."""
_LONGEST_LINE: Final = 1000
_MOST_LINES: Final = 20
"""Of a statement, and characters of a line, that are judged."""
_AT: Final = re.compile(r"\(at line (\d+), column \d+\)")
"""Where the parser stopped: before Python 3.14 only its sentence has that."""
_ESCAPE: Final = r"""\\(?:["\\bfnrt]|u[0-9A-Fa-f]{4}|U[0-9A-Fa-f]{8})"""
_WHOLE: Final = re.compile(
    rf""""{{3}}(?:{_ESCAPE}|\\\s*\n|[^\\])*?"{{3,5}}|'{{3}}.*?'{{3,5}}|"(?:{_ESCAPE}|[^"\\\n])*"|'[^'\n]*'|#[^\n]*""",
    re.DOTALL,
)
"""Texts without a mistake, and comments."""
_KEY: Final = r"""\s*(?:[A-Za-z0-9_-]+|"")(?:\s*\.\s*(?:[A-Za-z0-9_-]+|""))*\s*"""
_REMEDIES: Final = (
    ("toml_curly", r"[“”„‟‘’‚«»]"),
    ("toml_backslash", r"\\"),
    ("toml_truth", r"=\s*(?!true\b|false\b)(?i:true|false|yes|no|on|off)\b"),
    ("toml_nothing", r"=\s*(?:None|NULL|null|nil)?\s*$"),
    ("toml_decimal", r"=\s*[-+]?\d+,\d+\s*$"),
    ("toml_point", r"[=\[,]\s*[-+]?(?:\.\d|\d+\.(?!\d))"),
    ("toml_zero", r"[=\[,]\s*[-+]?0\d"),
    (
        "toml_brackets",
        r"^\s*(?:\[\[[^\[\]]*\](?!\])|\[[^\[\]]*(?:\]\]|$)|[^=\[\]{}]*[\]}]|[\w.-]+\s*:\s*$|[{(<][^=]*$)",
    ),
    ("toml_colon", r"""(?:^|[{,])\s*(?:[\w.-]+|"")\s*:"""),
    ("toml_list", r"=\s*\("),
    ("toml_table", r"\{(?:[^{}]*,)?\s*$"),
    ("toml_quote", r"""'|(?<!")(?:"")*"(?!")"""),
    ("toml_bare", r"=\s*(?:\[+(?:[^\[\]]*,)?\s*)?(?!(?:true|false|inf|nan)\b)(?:[A-Za-z_/~]|\d+\.\d+\.)"),
    ("toml_line", rf"""^{_KEY}=\s*(?:""|true\b|false\b|[-+]?\d[\d_.:-]*+)\s*,"""),
    (
        "toml_rest",
        rf"""^{_KEY}=\s*(?:""|true\b|false\b|[-+]?\d[\d_.:-]*+|\[[^\[\]{{}}]*\]|\{{[^\[\]{{}}]*\}})\s*[^\s,]""",
    ),
    ("toml_comma", r"^\s*[^=\[]+=\s*[\[{]|\n"),
    ("toml_pair", r"^[^=\[]*$|=\s*="),
    ("toml_key", rf"^(?!{_KEY}=|\s*\[{{1,2}}{_KEY}\]{{1,2}}\s*$)"),
)
"""Code of a remedy, and the lines that it is for, in which each text is `""`; the first that fits is likely. That of a
comma is for whole statements, in which an earlier line can be the wrong one."""


class TomlError(ValueError):
    """A text is not TOML."""

    def __init__(self, what: str, line: int = 0) -> None:
        super().__init__(what)
        self.line = line
        """Counted from 1; 0: unknown."""


def utf8_text(content: bytes) -> str:
    """The text of a file, its lines ended by a line feed. Raises TomlError with the line of what is no UTF-8."""
    try:
        text = content.decode("utf-8-sig")  # editors of Windows begin a file with a byte order mark
    except UnicodeDecodeError as error:
        whole, at = error.object, error.start
        what = Text("file_not_utf8", at=at, byte=whole[at], letter=whole[at : at + 1].decode("latin-1"))
        raise TomlError(what, whole.count(b"\n", 0, at) + 1) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def toml_data(text: str) -> dict[str, object]:
    """The data of a TOML file. Raises TomlError if the text is not TOML, or has values that cannot be shown."""
    if deep := _DEEP.search(text):
        raise TomlError("a key has too many names", text.count("\n", 0, deep.start()) + 1)
    try:
        data = tomllib.loads(text)
        repr(data)  # an integer of thousands of digits cannot be written
    except RecursionError:
        raise TomlError("brackets are nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise _explained(error, text) from None
    except ValueError as error:
        raise TomlError(str(error)) from None
    return data


def toml_lines(text: str) -> Mapping[Location, int]:
    """The line on which each table, key and value of a text begins, counted from 1, up to the first that is invalid."""
    found: dict[Location, int] = {}
    for line, table, data, statement in _statements(text):
        below = _below(statement) if statement.count("\n") > 1 else {}
        for length in range(1, len(table)):
            found.setdefault(table[:length], line)
        for location in _inner(table, data):
            in_lists = dropwhile(lambda part: isinstance(part, str), location[len(table) :])
            entry = tuple(takewhile(lambda part: isinstance(part, int), in_lists))
            found.setdefault(location, line + below.get(entry, 0))
    return found


def _below(statement: str) -> Mapping[Location, int]:
    """How many lines below the first one each entry of the statement's list begins, and each of a list in that."""
    found: dict[Location, int] = {}
    at: list[int] = []
    tables = line = 0
    for token in _PART.finditer(statement):
        part = token[0]
        if at and not tables and part not in "],\n" and not part.startswith("#"):
            found.setdefault(tuple(at), line)
        if part in "{}":
            tables += 1 if part == "{" else -1
        elif part == "[" and not tables:
            at.append(0)
        elif part == "]" and not tables:
            at.pop()
        elif part == "," and not tables:
            at[-1] += 1
        line += part.count("\n")
    return found


def nearest(location: Location, lines: Mapping[Location, int]) -> Location:
    """The location or, if it has no line, the innermost table around it that has one; (): none has."""
    return next((location[:n] for n in range(len(location), 0, -1) if location[:n] in lines), ())


def _statements(text: str) -> Iterator[tuple[int, Location, Mapping[str, object], str]]:
    """First line of each statement, the table in which it is, its data alone, and its text; a header has no data."""
    table: Location = ()
    counts: dict[Location, int] = {}
    for first, statement in _cut(text):
        try:
            data = tomllib.loads(statement)
        except (tomllib.TOMLDecodeError, RecursionError):
            yield first, (), {}, ""
            return
        if statement.lstrip().startswith("["):
            table = _table(data, counts)
            data = {}
        yield first, table, data, statement


def _cut(text: str) -> Iterator[tuple[int, str]]:
    """First line of each statement, counted from 1, and its text: it ends with a line on which no bracket is open."""
    start, line, first, depth = 0, 1, 1, 0
    for token in _TOKEN.finditer(text + "\n"):
        found = token[0]
        line += found.count("\n")
        depth += (found in "[{") - (found in "]}")
        if found == "\n" and depth <= 0:
            yield first, text[start : token.end()]
            start, first, depth = token.end(), line, 0
    if start < len(text):
        yield first, text[start:]


def _table(header: Mapping[str, object], counts: dict[Location, int]) -> Location:
    """The table that a header begins. counts: the index of the last table of each array"""
    table: Location = ()
    here: object = header
    while isinstance(here, Mapping) and here:
        ((key, here),) = here.items()
        table = (*table, key)
        if isinstance(here, list):
            counts[table] = counts.get(table, -1) + 1
        if table in counts:
            table = (*table, counts[table])
    return table


def _inner(at: Location, data: object) -> Iterator[Location]:
    if at:
        yield at
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from _inner((*at, key), value)
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from _inner((*at, index), value)


def _explained(error: tomllib.TOMLDecodeError, text: str) -> TomlError:
    """With the line and, if it can be guessed, what to do."""
    said, at = str(error), _AT.search(str(error))
    line = int(at[1]) if at else max(line for line, *_ in _statements(text))
    if earlier := _earlier(text, line):
        return TomlError(Text("toml_twice", error=plain(said), line=earlier), line)
    remedy = _in_array(text, line) or _remedy(text, line)
    return TomlError(Text("toml_remedy", error=plain(said), remedy=remedy) if remedy else said, line)


def _in_array(text: str, line: int) -> Text | None:
    """What to do about the first of several sections, if it has the brackets of a single one."""
    before = text.split("\n")[:line]
    header = re.fullmatch(r"\s*\[\[([^\[\]]*)\]\]\s*(?:#.*)?", before[-1])
    single = header and re.compile(rf"\s*\[\s*{re.escape(header[1].strip())}\s*\]\s*(?:#.*)?")
    first = single and next((at for at, each in enumerate(before, 1) if single.fullmatch(each)), 0)
    return Text("toml_array", name=header[1].strip(), line=first) if header and first else None


def _remedy(text: str, line: int) -> Text | None:
    """What is likely to be done about the line that is not TOML; None: that cannot be guessed."""
    first = max((at for at, _ in _cut(text) if at <= line), default=line)
    lines = text.split("\n")[max(first - 1, line - _MOST_LINES) : line]
    statement = _WHOLE.sub(_emptied, "\n".join(each[:_LONGEST_LINE] for each in lines))
    wrong = statement.rpartition("\n")[2]
    judged = ((code, form, statement if code == "toml_comma" else wrong) for code, form in _REMEDIES)
    return next((Text(code) for code, form, part in judged if re.search(form, part)), None)


def _emptied(whole: re.Match[str]) -> str:
    return ("" if whole[0].startswith("#") else '""') + "\n" * whole[0].count("\n")


def _earlier(text: str, line: int) -> int:
    """The line on which the key or the table of this line stands already; 0: not found."""
    statements = {at: (table, data) for at, table, data, _ in _statements(text)}
    table, data = statements.get(line, ((), {}))
    mine = max(_inner(table, data), key=len, default=())
    return next((at for at, inner in statements.items() if at < line and mine in _inner(*inner)), 0)
