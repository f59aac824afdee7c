"""The pages' own scripts, styles and pictures. A browser keeps them until another version of the program serves it."""

import gzip
from collections.abc import Mapping
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Final

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

_SCRIPTS = (
    "bars.js", "chart.js", "choice.js", "commands.js", "day.js", "elements.js", "machine.js", "model.js", "page.js",
    "past.js", "screens.js", "sensitivity.js", "sensors.js", "stream.js", "tables.js", "when.js", "why.js",
    "words.js",
)  # fmt: skip
_FILES: Final[Mapping[str, tuple[str, str]]] = {
    "page.css": ("listeners/web/static/page.css", "text/css"),
    **{name: (f"listeners/web/static/{name}", "text/javascript") for name in _SCRIPTS},
    "icon.svg": ("listeners/web/static/icon.svg", "image/svg+xml"),
    "uplot.css": ("reporting/uplot/uPlot.min.css", "text/css"),
    "uplot.js": ("reporting/uplot/uPlot.iife.min.js", "text/javascript"),
    "uplot-licence.txt": ("reporting/uplot/LICENSE", "text/plain"),
}
"""Name in the address to file and type; there is no other file."""
_KEPT: Final = {"cache-control": "private, max-age=31536000, immutable"}


class PageFiles:
    """Read once: an upgrade of the program on the disk does not mix its files with those of the one that runs.

    Parameters
    ----------
    gateway: the package's folder; None: of the package that runs
    """

    def __init__(self, gateway: Traversable | None = None) -> None:
        self._bodies = {
            name: (gateway or files("gateway")).joinpath(path).read_bytes() for name, (path, _) in _FILES.items()
        }
        self._version = sha256(b"\0".join(self._bodies.values())).hexdigest()[:16]
        self._packed = {name: gzip.compress(body) for name, body in self._bodies.items()}

    @property
    def folder(self) -> str:
        """Address of all files of this version, without a slash at its end."""
        return f"/file/{self._version}"

    async def file(self, request: Request) -> Response:
        """A file. Asked for under another version, it is today's, and not kept."""
        name = request.path_params["name"]
        if name not in self._bodies:
            return PlainTextResponse("There is no such file.", 404)
        headers = {"vary": "accept-encoding"}
        if request.path_params["version"] == self._version:
            headers |= _KEPT
        if "gzip" not in request.headers.get("accept-encoding", ""):
            return Response(self._bodies[name], media_type=_FILES[name][1], headers=headers)
        return Response(self._packed[name], media_type=_FILES[name][1], headers=headers | {"content-encoding": "gzip"})
