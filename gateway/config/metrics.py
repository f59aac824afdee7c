"""The section [metrics]: where Prometheus reads the gateway's figures."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import AfterValidator

from drivers.section import Section
from drivers.text import shown
from gateway.config.problems import Problem
from gateway.config.telemetry import EndpointParts, TelemetryTls, endpoint
from gateway.model.codes import NoticeCode
from gateway.model.text import Text


def _address(text: str) -> str:
    try:
        endpoint(f"tcp/{text}")
    except ValueError:
        raise ValueError(Text(NoticeCode.METRICS_FORM, value=shown(text))) from None
    return text


class Metrics(Section):
    """Metrics for Prometheus, at `http://HOST:PORT/metrics`; off unless `listen` is given."""

    listen: Annotated[str, AfterValidator(_address)] | None = None
    """HOST:PORT, such as `127.0.0.1:9464`. None: no metrics."""
    tls: bool = False
    """Serve them by HTTPS with the certificate of [telemetry.tls]; where that is `mutual`, Prometheus needs one too."""
    allow_unencrypted: bool = False
    """Whether they may be read from other computers without TLS."""

    @property
    def place(self) -> EndpointParts | None:
        """Where it listens."""
        return None if self.listen is None else endpoint(f"tcp/{self.listen}")


def metrics_problems(metrics: Metrics, tls: TelemetryTls) -> Iterator[Problem]:
    """What contradicts itself; reads no file."""
    place = metrics.place
    if metrics.tls and tls.certificate is None:
        yield Problem("[metrics] tls", Text(NoticeCode.METRICS_NO_CERTIFICATE))
    if place is not None and not (place.local or metrics.tls or metrics.allow_unencrypted):
        yield Problem(
            "[metrics] listen",
            f"'{metrics.listen}' can be read by everyone in that network: expected tls = true with [telemetry.tls], or"
            " a loopback address, or allow_unencrypted = true",
        )
