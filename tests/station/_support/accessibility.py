"""Faults that axe-core finds on the operator's page, in all that the page itself says it has.

Panels are those of the page's rail. Menus and dialogs are the elements of these types that NiceGUI's page
knows; lists and the like are what says by an attribute that it opens something. A new one needs no entry.
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page

from tests.station._support.browser import open_panel

axe = pytest.importorskip(
    "axe_playwright_python.sync_playwright",
    reason="THE ACCESSIBILITY OF THE OPERATOR'S PAGE IS NOT TESTED: pip install axe-playwright-python",
)
SERIOUS = ("serious", "critical")
CHECK = """([where, options]) =>
  axe.run(where ? { include: [where] } : document, options).then((found) => found.violations)"""
CONTRAST = {"runOnly": {"type": "rule", "values": ["color-contrast"]}}
"""The rule that depends on the look."""
PANELS = (
    "() => [...document.querySelectorAll('#panels [id^=tab-]')].map((one) => one.id.slice('tab-'.length))"
)
POPUPS = """() => Object.entries(mounted_app.elements)
  .filter(([, { tag }]) => /^(q|nicegui)-(menu|dialog)\\b/.test(tag)).map(([id]) => Number(id))"""
"""The ids of all menus and dialogs, whether they are shown or not."""
OPEN = """(id) => {
  const own = getElement(id), { elements } = mounted_app;
  const anchor = Object.keys(elements).find((one) => elements[one].children?.includes(id));
  const button = getElement(anchor)?.$el;
  if (button?.matches?.("button") && button.offsetParent) button.click(); // which may fill the menu
  else (own.show ? own : own.$.subTree.component.proxy).show();
  return elements[id].props.id ?? "";
}"""
CLOSE = "(id) => ((own) => (own.hide ? own : own.$.subTree.component.proxy).hide())(getElement(id))"
DIALOG = ".q-dialog__inner"
POPUP = f".q-menu, {DIALOG}"
FAINT = """(where) => {
  const numbers = (colour) => (colour.match(/[\\d.]+/g) ?? []).map(Number);
  const is_seen = (colour) => (numbers(colour)[3] ?? 1) > 0.99;
  const light = (colour) => numbers(colour).slice(0, 3).map((one) => one / 255)
    .map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4))
    .reduce((sum, one, at) => sum + one * [0.2126, 0.7152, 0.0722][at], 0);
  const behind = (one) => {
    while (one && !is_seen(getComputedStyle(one).backgroundColor)) one = one.parentElement;
    return one ? getComputedStyle(one).backgroundColor : "rgb(255, 255, 255)";
  };
  const has_text = (one) => [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  return [...document.querySelectorAll(`${where} *`)]
    .filter((one) => has_text(one) && one.checkVisibility() && !one.closest("[disabled], .disabled"))
    .map((one) => {
      const [low, high] = [light(getComputedStyle(one).color), light(behind(one))].sort((x, y) => x - y);
      const contrast = (high + 0.05) / (low + 0.05);
      return [contrast, one.textContent.trim().slice(0, 60), getComputedStyle(one).color, behind(one)];
    }).filter(([contrast]) => contrast < 4.5)
    .map(([contrast, ...about]) => `contrast ${contrast.toFixed(2)}: ${about.join(", ")}`);
}"""
"""Texts whose contrast is below that of WCAG 2 AA, for dialogs: axe-core measures the page behind them."""
OPENERS = """(where) => [...document.querySelectorAll(`${where} :is([aria-expanded=false], [aria-haspopup])`)]
  .filter((one) => one.offsetParent).map((one) => {
    window.openers = (window.openers ?? 0) + (one.dataset.opener ? 0 : 1);
    return (one.dataset.opener ??= window.openers);
  })"""
"""Marks what opens something in a part of the page; returns the marks."""
IS_STILL = """() => !document.querySelector("[class*=-enter-active], [class*=-leave-active]")
  && !document.querySelector("#link-lost")?.checkVisibility()"""
"""Nothing fades in or out, and no lost link, as on a busy machine, lays grey over the page."""
SHOWN = (
    "() => [...document.querySelectorAll('[role=dialog], [role=menu], [role=listbox]')].map((one) => one.id)"
)
SCRIPTED = re.compile(r"""(?=[^<>]*role="(?:dialog|menu|listbox)")[^<>]*\bid="([^"]+)\"""")
"""What a component of ours opens in a way of its own, in its template."""


def let_check(page: Page) -> None:
    """Load axe-core into a page, also after it has connected again. The page is loaded later."""
    page.add_init_script(axe.Axe().axe_script)


def serious_faults(page: Page, options: dict[str, Any], where: str = "") -> list[str]:
    """Return each serious fault with its rule and its elements.

    Args:
        page: the page.
        options: of axe-core.
        where: selects the part that is checked; '': the whole page.
    """
    while True:
        page.wait_for_function(IS_STILL)
        violations = page.evaluate(CHECK, [where, {"resultTypes": ["violations"], **options}])
        if not violations or page.evaluate(IS_STILL):
            break
    return [
        f"{one['id']}, {one['help']}: "
        + "; ".join(
            f"{node['html'][:160]} {node['any'][:1] and node['any'][0]['message'][:160]}"
            for node in one["nodes"][:6]
        )
        for one in violations
        if one["impact"] in SERIOUS
    ]


def scripted_popups(folders: Iterable[Path]) -> set[str]:
    """Return the ids of all dialogs, menus and lists that components open in ways of their own."""
    scripts = [path.read_text() for folder in folders for path in folder.rglob("*.js")]
    return {found for script in scripts for found in SCRIPTED.findall(script)}


class Walk:
    """Goes through everything that a page has.

    Args:
        page: the page.
        options: of axe-core.

    Attributes:
        seen: ids of all menus, dialogs and lists that were shown.
    """

    def __init__(self, page: Page, options: dict[str, Any]):
        self._page, self._options = page, options
        self._popups: set[int] = set()
        self.seen: set[str] = set()

    def faults(self) -> Iterator[str]:
        """Yield the faults of the bars, then of each panel, with all that can be opened there."""
        yield from self._opened("the bars", ".cockpit-bar")
        yield from self._opened("the bars", ".cockpit-bars")
        panels = self._page.evaluate(PANELS)
        assert len(panels) > 10
        for name in panels:
            open_panel(self._page, name)
            self._page.wait_for_timeout(500)  # what a panel shows comes in updates of its own
            yield from self._checked(name, f"#tile-{name}")
            yield from self._opened(name, f"#tile-{name}")
        yield from self._checked("the page", "")

    def _checked(self, name: str, where: str) -> Iterator[str]:
        self.seen |= set(self._page.evaluate(SHOWN))
        yield from (f"{name}: {fault}" for fault in serious_faults(self._page, self._options, where))

    def _opened(self, name: str, where: str) -> Iterator[str]:
        """Open what can be opened in a part of the page, and the menus and dialogs that came with it."""
        page = self._page
        has_unfolded = False
        for mark in page.evaluate(OPENERS, where):
            opener = page.locator(f"[data-opener='{mark}']")
            opener.evaluate("(one) => one.click()")
            page.wait_for_function(IS_STILL)
            what = f"{name}, {opener.get_attribute('aria-label') or mark}"
            if page.locator(POPUP).count():
                yield from self._checked(what, POPUP)
                opener.evaluate("(one) => one.click()")
                page.wait_for_selector(POPUP, state="detached")
            elif opener.get_attribute("aria-haspopup"):  # a script of ours opens it
                yield from self._checked(what, "body")
                opener.evaluate("(one) => one.click()")
            else:
                has_unfolded = True
        if has_unfolded:
            yield from self._checked(f"{name}, unfolded", where)
        for popup in page.evaluate(POPUPS):
            if popup in self._popups:
                continue
            self._popups.add(popup)
            known = page.evaluate(OPEN, popup)
            page.wait_for_selector(POPUP)
            if self._options == CONTRAST and page.locator(DIALOG).count():
                page.wait_for_function(IS_STILL)
                yield from (f"{name}, {known or popup}: {one}" for one in page.evaluate(FAINT, DIALOG))
            else:
                yield from self._checked(f"{name}, {known or popup}", POPUP)
            page.evaluate(CLOSE, popup)
            page.wait_for_selector(POPUP, state="detached")
