"""Commands from the page: of a signed-in user whose key the settings name, from this page itself, confirmed there.

The page's program signs them; the gateway decides, answers and stores (gateway.telemetry.command_door).
"""

import asyncio
import hashlib
import hmac
import os
from collections.abc import Callable
from dataclasses import asdict
from typing import Final
from urllib.parse import urlsplit

from starlette.requests import Request
from starlette.responses import JSONResponse

from drivers.base import SetupError
from drivers.error_words import in_words
from gateway.listeners.web.sentences import in_each
from gateway.listeners.web.settings import WebSettings
from gateway.model.codes import NoticeCode
from gateway.model.commands import CommandName
from gateway.model.text import Text, plain, text_of
from gateway.telemetry.answers import CommandAnswer
from gateway.telemetry.command_signer import CommandSigner
from gateway.telemetry.fields import text_from

TOKEN_HEADER: Final = "x-command-token"
"""No form and no page of others can set it."""
_AT_ONCE = 2
_OFFERED: Final = {
    name.value: name for name in (CommandName.MEASURE, CommandName.PAUSE, CommandName.RESUME, CommandName.REFERENCE)
}
"""What the page has buttons for; for the others a person uses the command line or a program."""

GivePageCommand = Callable[[str, CommandSigner, CommandName], CommandAnswer]
"""Gives a machine a command. Blocks. Raises OSError, ValueError."""


class PageCommands:
    """Takes commands of browsers.

    Parameters
    ----------
    settings: `operators` is used
    give: None: nobody may

    Raises SetupError for a key that cannot be used.
    """

    def __init__(self, settings: WebSettings, give: GivePageCommand | None) -> None:
        self._give, self._secret = give, os.urandom(32)
        self._turns = asyncio.Semaphore(_AT_ONCE)
        self._signers: dict[str, CommandSigner] = {}
        for user, path in settings.operators.items():
            try:
                self._signers[user] = CommandSigner.of_file(user, path)
            except (OSError, ValueError) as error:
                why = plain(in_words(error)) if isinstance(error, OSError) else text_of(error)
                raise SetupError(
                    Text(NoticeCode.FILE_WRONG, path=str(path), why=why), field=("operators", user)
                ) from error

    def token(self, request: Request) -> str | None:
        """What a page of this user must send with a command; None: this user may give none."""
        user = getattr(request.state, "user", None)
        if user not in self._signers:
            return None
        return hmac.digest(self._secret, user.encode(), hashlib.sha256).hex()

    async def answer(self, request: Request, machine: str) -> JSONResponse:
        """Give the command in the request's address, and pass on the gateway's answer."""
        token, headers = self.token(request), request.headers
        if token is None or self._give is None:
            return _refused(403, "this user may give no commands")
        # Another site's page can make this browser send requests in the user's name; it knows no token.
        own = urlsplit(headers.get("origin", "")).netloc.lower() == headers.get("host", "").lower()
        if not own or not hmac.compare_digest(headers.get(TOKEN_HEADER, "").encode(), token.encode()):
            return _refused(403, "the command did not come from this page; open it again")
        name = _OFFERED.get(request.path_params["command"])
        if name is None:
            return _refused(404, "there is no such command")
        try:
            async with self._turns:
                found = await asyncio.to_thread(self._give, machine, self._signers[request.state.user], name)
        except (OSError, ValueError) as error:
            return _refused(502, text_of(error))
        text = text_from(found.text, found.text_coded)
        return JSONResponse({"accepted": found.accepted, "text": found.text, "said": asdict(in_each(text))})


def _refused(status: int, text: str) -> JSONResponse:
    return JSONResponse({"accepted": False, "text": text, "said": asdict(in_each(plain(text)))}, status)
