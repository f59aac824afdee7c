"""The service loads only what it needs: memory and seconds on a small computer."""

import subprocess
import sys

HEAVY = ("asyncua", "scipy", "osqp", "matplotlib", "jinja2", "cantools", "cryptography")


def test_a_gateway_without_opc_ua_loads_none_of_the_heavy_libraries() -> None:
    code = f"import sys, gateway.cli.main, gateway.cli.run; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
