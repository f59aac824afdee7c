"""`talc-gateway opcua`: shows machines to OPC UA clients. It only listens, so it cannot affect a machine."""

from pathlib import Path

import click

from gateway.cli.arguments import Address, AnyFile, heard_options, read_config


@click.command()
@heard_options
@click.option("--settings", type=AnyFile, help="TOML file: nameplates, certificate, users (docs/umati.md).")
@click.option("--listen", type=Address, default="127.0.0.1:4840", show_default=True, metavar="HOST:PORT",
              help="Address of the server.")  # fmt: skip
@click.option("--make-password", is_flag=True, help="Ask for a password, print its hash for --settings, and end.")
def opcua(
    config: Path | None,
    connect: tuple[str, ...],
    prefix: str | None,
    settings: Path | None,
    listen: tuple[str, int],
    make_password: bool,
) -> None:
    """Show machines to OPC UA clients after OPC UA for Machine Tools (umati), read-only.

    Shows the gateway of CONFIG, which runs on this computer, and the machines that --settings names and --connect
    reaches. It only listens: no client can touch a machine. An address beyond this computer needs a certificate and
    users in --settings.
    """
    from gateway.listeners.umati.serve import serve_machines
    from gateway.runtime.passwords import ask_password

    if make_password:
        ask_password()
        return
    if config is None and not connect:
        raise click.UsageError("give CONFIG, or --connect ENDPOINT")
    serve_machines(None if config is None else read_config(config), connect, prefix, settings, *listen)
