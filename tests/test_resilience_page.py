"""What docs/cyber-resilience.md says about the telemetry and byte code is true."""

import py_compile
import re
import subprocess
import sys
from pathlib import Path

from gateway.config import GatewayConfig, validate
from gateway.config.telemetry_rules import telemetry_cautions, telemetry_problems

PAGE = Path(__file__).parents[1] / "docs" / "cyber-resilience.md"


def row(duty: str) -> str:
    """What the page says the project has for a requirement."""
    (found,) = re.findall(rf"(?m)^\| {duty}[^|]*\| ([^|]*) \|", PAGE.read_text("utf-8"))
    return str(found)


def with_telemetry(**telemetry: object) -> GatewayConfig:
    return validate({"machine": {"name": "mill"}, "telemetry": telemetry})


def test_by_default_only_this_computer_reaches_the_telemetry_unencrypted_and_without_certificates() -> None:
    telemetry = with_telemetry().telemetry
    assert [(place.local, place.encrypted) for place in telemetry.listening] == [(True, False)]
    assert not telemetry.tls.mutual
    assert "by default only programs on the same computer reach it, unencrypted" in row("confidentiality, integrity")
    assert "only with `mutual = true`, which is not the default" in row("confidentiality, integrity")


def test_listening_beyond_it_needs_tls_or_a_word() -> None:
    (refused,) = telemetry_problems(with_telemetry(listen=["tcp/0.0.0.0:7447"]).telemetry)
    assert "allow_unencrypted = true" in refused.what
    allowed = with_telemetry(listen=["tcp/0.0.0.0:7447"], allow_unencrypted=True).telemetry
    assert list(telemetry_problems(allowed)) == []
    assert "`tls/…` endpoints or `allow_unencrypted = true`" in row("confidentiality, integrity")


def test_what_it_connects_to_is_used_as_written() -> None:
    open_one = with_telemetry(connect=["tcp/192.168.1.5:7447"]).telemetry
    assert list(telemetry_problems(open_one)) == []
    assert [caution.what for caution in telemetry_cautions(open_one)] == [
        "'tcp/192.168.1.5:7447' is reached without encryption; use tls/…"
    ]
    assert "`connect` is used as written: `tcp/…` is not encrypted, of which `check` warns" in row(
        "confidentiality, integrity"
    )


def test_a_changed_source_has_no_effect_until_its_byte_code_is_deleted(tmp_path: Path) -> None:
    """With the byte code that deploy/debian/build.sh makes."""
    build = (PAGE.parents[1] / "deploy" / "debian" / "build.sh").read_text("utf-8")
    (made,) = re.findall(r"--invalidation-mode (\S+)", build)
    assert f"`{made}`" in PAGE.read_text("utf-8")
    source = tmp_path / "library.py"
    source.write_text("print('former')\n", encoding="utf-8")
    mode = py_compile.PycInvalidationMode[made.upper().replace("-", "_")]
    code = Path(str(py_compile.compile(str(source), invalidation_mode=mode)))
    source.write_text("print('changed')\n", encoding="utf-8")

    def run() -> str:
        done = subprocess.run([sys.executable, "-c", "import library"], cwd=tmp_path, capture_output=True, text=True)
        return done.stdout.strip()

    assert run() == "former"
    code.unlink()
    assert run() == "changed"
