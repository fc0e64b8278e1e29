"""HTML by construction: every text is escaped, except what was built here."""

from collections.abc import Sequence
from html import escape

from robbie_mp.base.visible_text import visible

MAX_TEXT = 2000
"""Characters of one text; messages and logs may have longer ones."""


class Html(str):
    """A text that is HTML already."""

    __slots__ = ()


def text(value: object, longest: int = MAX_TEXT) -> Html:
    """Return a text as HTML: escaped, without control characters, and not too long."""
    if isinstance(value, Html):
        return value
    shown = visible(str(value))
    return Html(escape(shown if len(shown) <= longest else f"{shown[:longest]} …"))


def element(name: str, *children: object, **attributes: object) -> Html:
    """Return an element; its attributes and those of its children that are no HTML are escaped and cut off.

    Args:
        name: of the element.
        children: its content.
        attributes: `class_` is `class`, `_` in a name is `-`; None: it has no such attribute. What is long
            and made here, such as the points of a curve, is given as Html.
    """
    listed = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(value)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Html(f"<{name}{listed}>{''.join(map(text, children))}</{name}>")


def joined(*parts: object) -> Html:
    """Return parts one after the other."""
    return Html("".join(map(text, parts)))


def picture(address: str, alternative: str, **attributes: object) -> Html:
    """Return an image whose data is in its address."""
    listed = "".join(f' {key}="{text(value)}"' for key, value in attributes.items())
    return Html(f'<img src="{escape(address)}" alt="{text(alternative)}"{listed}>')


def table(headings: tuple[str, ...], rows: Sequence[tuple[object, ...]], most: int, numbers: int = 0) -> Html:
    """Return a table.

    Args:
        headings: of the columns.
        rows: the cells.
        most: rows beyond this number are only counted.
        numbers: how many of the last columns are numbers.
    """
    texts = len(headings) - numbers

    def cells(kind: str, row: tuple[object, ...]) -> Html:
        made = (element(kind, one, class_="number" if at >= texts else None) for at, one in enumerate(row))
        return element("tr", *made)

    more = len(rows) - most
    foot = element("p", f"and {more} more", class_="quiet") if more > 0 else ""
    body = element("tbody", *(cells("td", row) for row in rows[:most]))
    return joined(
        element("div", element("table", element("thead", cells("th", headings)), body), class_="wide"), foot
    )
