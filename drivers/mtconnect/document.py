"""MTConnect's documents: data items that an agent describes, and what it last observed of each."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from xml.parsers import expat

from drivers.text import Text

_DEEPEST = 50
_MOST = 100_000
"""Elements; a large machine's description has some thousands. Each takes half a kilobyte and some microseconds."""
_UNAVAILABLE = "UNAVAILABLE"


class AgentError(ValueError):
    """The document is an agent's error; the message is its code and text."""


@dataclass(eq=False)
class Element:
    """One XML element."""

    name: str
    """Without its namespace."""
    attributes: Mapping[str, str]
    parent: "Element | None" = None
    texts: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        return "".join(self.texts).strip()


def elements(document: bytes) -> list[Element]:
    """Every element, in order. It takes up to half a second: call it in a thread.

    Raises AgentError, and ValueError: not XML, too deep, too many, or with a document type, which could hold entities.
    """
    found: list[Element] = []
    inside: list[Element] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        if len(inside) >= _DEEPEST:
            raise ValueError(f"more than {_DEEPEST} elements within each other")
        if len(found) >= _MOST:
            raise ValueError(f"more than {_MOST} elements")
        inside.append(Element(name.rpartition(":")[2], attributes, inside[-1] if inside else None))
        found.append(inside[-1])

    def doctype(*_: object) -> None:
        raise ValueError("it has a document type, which is not accepted")

    parser = expat.ParserCreate()  # in the encoding that the document states, else UTF-8
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: inside.pop()
    parser.CharacterDataHandler = lambda text: inside[-1].texts.append(text)
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(document, True)
    except expat.ExpatError as error:
        raise ValueError(f"it is not XML: {error}") from error
    for element in found:
        if element.name == "Error" and "errorCode" in element.attributes:
            raise AgentError(Text("mtc_reports", error=element.attributes["errorCode"][:60], said=element.text[:120]))
    return found


@dataclass(frozen=True, slots=True)
class Described:
    """An answer to `probe`."""

    instance: str
    """Identity of the agent's start and of the machine's description; empty if it states none."""
    items: Mapping[str, Mapping[str, str]]
    """Id to attributes; without any, if several data items have the id."""


@dataclass(frozen=True, slots=True)
class Observed:
    """An answer to `current`."""

    instance: str
    """As in `Described`; another one: the data items may be others, in other units."""
    values: dict[str, str]


def described(document: bytes) -> Described:
    """Raises ValueError."""
    found = elements(document)
    return Described(_instance(found), data_items(found))


def observed(document: bytes) -> Observed:
    """Raises ValueError."""
    found = elements(document)
    return Observed(_instance(found), latest_values(found))


def _instance(found: Iterable[Element]) -> str:
    header = next((e.attributes for e in found if e.name == "Header"), {})
    return " ".join(header[name] for name in ("instanceId", "deviceModelChangeTime") if name in header)


def data_items(found: Collection[Element]) -> dict[str, Mapping[str, str]]:
    """Id to the attributes of each data item, of an answer to `probe`.

    Agents from version 1.5 on name a coordinate system by its id; here `coordinateSystem` is its type in either case.
    """
    systems = {e.attributes.get("id", ""): e.attributes.get("type", "") for e in found if e.name == "CoordinateSystem"}
    items: dict[str, Mapping[str, str]] = {}
    for attributes in (e.attributes for e in found if e.name == "DataItem" and "id" in e.attributes):
        named = attributes.get("coordinateSystemIdRef", "")
        told = {**attributes, "coordinateSystem": systems[named]} if named in systems else attributes
        items[attributes["id"]] = {} if attributes["id"] in items else told
    return items


def latest_values(found: Iterable[Element]) -> dict[str, str]:
    """Id to the latest value of each data item that has one, of an answer to `current`; to all of them in one text if
    there are several, so that none passes for a number."""
    latest: dict[str, str] = {}
    for e in found:
        if (item := e.attributes.get("dataItemId")) is not None:
            latest[item] = e.text if latest.get(item, e.text) == e.text else f"{latest[item]} and {e.text}"
    return {item: text for item, text in latest.items() if text != _UNAVAILABLE}
