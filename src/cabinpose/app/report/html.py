"""Parts that all pages share: elements, tables, tiles, pictures, and the page with its style sheet."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files

from cabinpose.app.view.draw import jpeg
from cabinpose.store import Image

_VOID = ("img", "input", "meta")  # elements without an end


class Html(str):
    """Text that is HTML already; any other text is escaped where it enters an element."""

    __slots__ = ()


def join(parts: Iterable[object]) -> Html:
    """Parts one after the other, those that are not `Html` escaped."""
    return Html("".join(part if isinstance(part, Html) else escape(str(part)) for part in parts))


def el(tag: str, *children: object, **attributes: object) -> Html:
    """An element of HTML or SVG.

    Parameters
    ----------
    tag
        Its name.
    *children
        What is in it; text that is not `Html` is escaped.
    **attributes
        `class_` and `stroke_width` stand for class and stroke-width. Numbers get one decimal, None leaves an attribute out.

    Returns
    -------
    Html
        The element.
    """
    words = [tag]
    for name, value in attributes.items():
        if value is not None:
            text = f"{value:.1f}" if isinstance(value, float) else str(value)
            words.append(f'{name.rstrip("_").replace("_", "-")}="{escape(text)}"')
    return Html(f"<{' '.join(words)}>" + ("" if tag in _VOID else f"{join(children)}</{tag}>"))


def document(title: str, heading: str, summary: str, sections: Sequence[str]) -> str:
    """A page that needs no other file and no network: its title, its heading, a line below, and its sections (HTML)."""
    head = el(
        "head", el("meta", charset="utf-8"), el("meta", name="viewport", content="width=device-width"), el("title", title),
        el("style", style("report")),
    )  # fmt: skip
    body = el("body", el("header", el("h1", heading), el("p", summary)), el("main", Html("".join(sections))))
    return f"<!doctype html>\n{el('html', head, body, lang='en')}\n"


def style(name: str) -> Html:
    """The style sheet of a page, after the one that all pages share."""
    assets = files("cabinpose.app.report") / "assets"
    return Html("".join((assets / f"{each}.css").read_text(encoding="utf-8") for each in ("base", name)))


def section(title: str, body: str, note: str = "") -> Html:
    """A section of a page, its body HTML; nothing where the body is empty."""
    return el("section", el("h2", title), remark(note), Html(body)) if body else Html()


def remark(text: str) -> Html:
    """A paragraph in a soft colour; nothing for an empty text."""
    return el("p", text, class_="note") if text else Html()


def table(rows: Sequence[Sequence[object]], words: Sequence[int] = (0,), *, head: bool = True) -> Html:
    """A table whose first row is its head, if it has one; columns of words are left-aligned, numbers right-aligned."""
    lines = []
    for number, row in enumerate(rows):
        cells = (
            el("th" if i == 0 or (head and number == 0) else "td", cell, class_="name" if i in words and i else None)
            for i, cell in enumerate(row)
        )
        lines.append(el("tr", *cells, class_="head" if head and number == 0 else None))
    return el("div", el("table", *lines), class_="scroll") if len(rows) > head else Html()


def with_small(value: object, small: str) -> Html:
    """A cell with a smaller line below, such as a number and its interval."""
    return join((value, el("small", small)))


def tiles(entries: Iterable[tuple[str, str, str, Sequence[str], str]]) -> Html:
    """Numbers to see at a glance: value, unit, name, lines below, and "", "warn" or "bad"."""
    drawn = (
        el("div", el("b", value, el("small", " ", unit)), el("span", name), *(el("em", x) for x in lines), class_=f"tile {kind}")
        for value, unit, name, lines, kind in entries
    )
    return el("div", *drawn, class_="tiles")


def picture_uri(image: Image) -> str:
    """An image as a data URI, for `src` or `href`."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg(image, 85)).decode("ascii")


def figure(body: Html, caption: object) -> Html:
    """A picture with its caption."""
    return el("figure", body, el("figcaption", caption))
