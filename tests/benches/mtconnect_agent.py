"""A third-party MTConnect agent, the PyPI package `mtconnect`, behind Python's own HTTP server."""

from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from xml.etree import ElementTree

import mtconnect.xmlhelper
from mtconnect import MTConnect

ITEMS = (
    *((f"{axis}pos", "POSITION", "MILLIMETER") for axis in "XYZ"),
    *((f"{axis}pos", "ANGLE", "DEGREE") for axis in "AC"),
    ("Xwork", "POSITION", "MILLIMETER"),
    ("Xfrt", "AXIS_FEEDRATE", "MILLIMETER/SECOND"),
    ("Cfrt", "ANGULAR_VELOCITY", "DEGREE/SECOND"),
    ("Srpm", "ROTARY_VELOCITY", "REVOLUTION/MINUTE"),
    ("Sovr", "ROTARY_VELOCITY", "PERCENT"),
    ("estop", "EMERGENCY_STOP", ""),
    ("mode", "CONTROLLER_MODE", ""),
    ("exec", "EXECUTION", ""),
    ("tool", "TOOL_NUMBER", ""),
    ("flood", "ACTUATOR_STATE", ""),
)
"""Id, type and unit of the data items of a five-axis mill."""


def devices() -> str:
    """The mill, as its maker describes it to the agent."""
    axes = "".join(
        f'<{"Rotary" if axis in "ACS" else "Linear"} id="{axis}" name="{axis}"><DataItems>{_items(axis)}</DataItems>'
        f"</{'Rotary' if axis in 'ACS' else 'Linear'}>"
        for axis in "XYZACS"
    )
    path = f'<Path id="path" name="path"><DataItems>{_items("")}</DataItems></Path>'
    parts = (
        f'<Axes id="axes" name="axes"><Components>{axes}</Components></Axes>'
        f'<Controller id="cont" name="controller"><Components>{path}</Components></Controller>'
    )
    return f'<Devices><Device id="d1" name="mill" uuid="m1"><Components>{parts}</Components></Device></Devices>'


def _items(axis: str) -> str:
    """The data items of an axis, whose ids begin with its name; empty: those of no axis."""
    items = []
    for item, kind, units in ITEMS:
        if axis == (item[0] if item[0] in "XYZACS" else ""):
            about = f' units="{units}"' if units else ""
            about += ' coordinateSystem="WORK"' if item == "Xwork" else ""
            items.append(f'<DataItem id="{item}" category="{"SAMPLE" if units else "EVENT"}" type="{kind}"{about}/>')
    return "".join(items)


class _Listed(ElementTree.Element):
    """The package asks for the children by a method that Python removed in 3.9."""

    def getchildren(self) -> list[ElementTree.Element]:
        return list(self)


def _parse(file: str) -> "ElementTree.ElementTree[ElementTree.Element]":
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(element_factory=_Listed))
    return ElementTree.parse(file, parser)


@contextmanager
def mtconnect_agent(folder: Path) -> Iterator[tuple[MTConnect, str]]:
    """The agent, whose `push_data` observes a value of a data item, and its address."""
    (folder / "devices.xml").write_text(devices())
    mtconnect.xmlhelper.ElementTree = SimpleNamespace(parse=_parse)
    agent = MTConnect(str(folder / "devices.xml"))

    class Requests(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            answers = {"/probe": agent.probe, "/current": agent.current}
            if self.path not in answers:
                self.send_error(404)
                return
            answer = answers[self.path]()
            body = answer.get_xml().encode()
            self.send_response(answer.get_status())
            self.send_header("Content-Type", "text/xml")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Silent."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Requests) as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield agent, f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()
