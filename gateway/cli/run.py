"""`talc-gateway run`."""

import asyncio

from gateway.cli.running import serve, stop_on_signals
from gateway.clock import RealClock
from gateway.config import GatewayConfig


def run_service(config: GatewayConfig) -> None:
    """Run the gateway until SIGINT or SIGTERM."""

    async def main() -> None:
        stop = asyncio.Event()
        stop_on_signals(stop)
        await serve(config, RealClock(), stop, simulated=False)

    asyncio.run(main())
