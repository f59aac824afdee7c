"""Builds the driver of a control with an MTConnect agent, and looks at an agent for the first time."""

import asyncio

from drivers.base import BadAnswer, Clock
from drivers.mtconnect.settings import MtConnectSettings
from drivers.mtconnect.suggest import SuggestedItems, suggested_items
from drivers.nc import NumericalControl
from drivers.text import Text, text_of


def make_mtconnect(settings: MtConnectSettings, clock: Clock) -> NumericalControl:
    """The driver for these settings. No network."""
    from drivers.mtconnect.control import MtConnectControl  # loads an HTTP client, which few gateways need

    return MtConnectControl(settings, clock)


async def suggest_mtconnect(url: str, machine: str, timeout_s: float) -> SuggestedItems:
    """What the agent's description suggests; one request, `probe`, for at most `timeout_s` seconds.

    machine: name or uuid; empty: the agent's only or first one. Raises NoAnswer, ConnectError, BadAnswer.
    """
    from drivers.mtconnect.exchange import ask_agent  # loads an HTTP client

    body = await ask_agent(url, machine, "probe", timeout_s)
    try:
        return await asyncio.to_thread(suggested_items, body)
    except ValueError as error:
        raise BadAnswer(Text("mtc_probe", error=text_of(error)), device="nc") from error
