"""The page for operators of a machine `mill`, in the test's process and without a gateway."""

from base64 import b64encode
from typing import cast

from starlette.testclient import TestClient

from gateway.listeners.web.app import build_app
from gateway.listeners.web.settings import WebSettings
from gateway.telemetry.codec import encode
from gateway.telemetry.messages import StatusMessage
from gateway.telemetry.subscriber.site import SiteSeen, SiteSubscription
from tests.benches.heard import BEGAN


def mill_seen() -> SiteSeen:
    """Nothing has been heard of the machine; the time stands still."""
    return SiteSeen("talc", ("mill",), lambda: BEGAN, lambda: 0.0)


def mill_page(source: object = None, *, heard: bool = False) -> TestClient:
    """
    Parameters
    ----------
    source: stands for the session with a gateway that has a store
    heard: whether the gateway has published its status
    """
    site = mill_seen()
    if heard:
        status = StatusMessage("boot-1", 1, BEGAN.isoformat(), "system", None, None, 0, {}, None, None)
        site.take("talc/mill/status", encode(status))
    app = build_app(site, WebSettings(), cast(SiteSubscription | None, source))
    return TestClient(app, base_url="http://localhost")


def logged_in(user_and_password: str) -> dict[str, str]:
    """Headers of a request, with both as in `anna:secret`."""
    return {"authorization": "Basic " + b64encode(user_and_password.encode()).decode()}
