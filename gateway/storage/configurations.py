"""The configurations that earlier runs have stored, as this program reads them."""

from hashlib import sha256

from gateway.config.extended import stored_configuration
from gateway.config.model import GatewayConfig
from gateway.config.prior import parse_prior
from gateway.storage.faults import DamagedError, StoreError
from gateway.storage.history import History


def stored_config(history: History) -> GatewayConfig:
    """The configuration of the latest run, from the first copy of it that is valid.

    Raises StoreError if the database is empty, or if this program does not accept what an earlier one has stored;
    DamagedError if every copy is damaged.
    """
    texts = history.configs()
    if not texts:
        raise StoreError("the database holds no run yet")
    wrong = ""
    for text in texts:
        try:
            return from_stored(text, history.prior())
        except (ValueError, KeyError, TypeError, AttributeError) as error:  # pydantic's are ValueErrors
            wrong = wrong or " ".join(str(error).split())
    latest = history.config()
    if latest is not None and sha256(latest[0].encode()).hexdigest() == latest[1]:  # no byte has changed
        raise StoreError(
            f"this program does not accept the configuration of the latest run: {wrong}; continue with the earlier"
            " program, or give [storage] another path to start again"
        )
    raise DamagedError(
        f"the stored configuration of the latest run is invalid or damaged: {wrong}; give [storage] another"
        " path to start again"
    )


def from_stored(text: str, prior: str | None = None) -> GatewayConfig:
    """The configuration and the prior in a stored text, as the program that stored it understood them."""
    config = stored_configuration(text)
    return config if prior is None else config.with_prior(parse_prior(prior))
