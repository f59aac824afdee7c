"""Movements on a page: Chromium's own measure (layout shift), and where the parts begin."""

from playwright.sync_api import Page, expect

_NOTE = """() => {
  window.shifts = [];
  const take = (list) => list.forEach((e) => {
    window.shifts.push([e.value, e.sources.map(({ node }) => node && (node.id || node.textContent))]);
  });
  window.watcher = new PerformanceObserver((list) => take(list.getEntries()));
  window.watcher.observe({ type: "layout-shift", buffered: true });
  window.takeShifts = () => { take(window.watcher.takeRecords()); return window.shifts.splice(0); };
}"""
"""Notes what is displayed at another place than in the previous frame, since the page was opened."""
TWO_FRAMES = "() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(drawn))))"


def note_shifts(page: Page) -> None:
    """Note shifts from now on, and those before that the browser still knows."""
    page.evaluate(_NOTE)


def shifts(page: Page) -> object:
    """What has moved since the last call."""
    page.evaluate(TWO_FRAMES)
    return page.evaluate("window.takeShifts()")


def top_of(page: Page, selector: str) -> float:
    """Where it begins, in pixels from the beginning of the page; the page is not shown before its first state."""
    expect(page.locator(selector)).to_be_visible()
    return float(page.evaluate("(of) => document.querySelector(of).getBoundingClientRect().top + scrollY", selector))


def tops(page: Page) -> list[float]:
    """Where each heading and each part of the first screen begins."""
    found: list[float] = page.evaluate(
        """() => [...document.querySelectorAll('h1, h2, h3, .card, #word, #because, #helps, #axes article')]
          .map((each) => each.getBoundingClientRect().top + scrollY)"""
    )
    return found
