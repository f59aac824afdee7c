"""Runs axe, which judges whether everybody can use a page."""

from playwright.sync_api import Page

from tests.benches.npm_peer import PEERS, node_with


def violations(page: Page) -> object:
    """What axe finds; the page must be open without its policy."""
    node_with("axe", "axe-core")
    axe = PEERS / "axe" / "node_modules" / "axe-core" / "axe.min.js"
    page.add_script_tag(content=axe.read_text("utf-8"))
    return page.evaluate("axe.run().then((r) => r.violations.map((v) => [v.id, v.nodes.map((n) => n.html)]))")
