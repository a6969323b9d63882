"""The few pieces of HTML that a report is made of; whatever comes from a case is escaped."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


class Row(NamedTuple):
    """Of a table."""

    cells: Sequence[str]
    chosen: bool = False


def safe(text: str) -> Html:
    """What is no HTML yet, as such."""
    return text if isinstance(text, Html) else Html(escape(text))


def _of_class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def joined(pieces: Iterable[str], between: str = "") -> Html:
    return Html(between.join(safe(piece) for piece in pieces))


def code(name: str) -> Html:
    return Html(f"<code>{safe(name)}</code>")


def bold(text: str) -> Html:
    return Html(f"<b>{safe(text)}</b>")


def small(text: str) -> Html:
    return Html(f"<small>{safe(text)}</small>")


def paragraph(*pieces: str, kind: str = "") -> Html:
    return Html(f"<p{_of_class(kind)}>{joined(pieces)}</p>\n") if any(pieces) else Html("")


def heading(text: str) -> Html:
    return Html(f"<h2>{safe(text)}</h2>\n")


def bullets(items: Iterable[str]) -> Html:
    said = joined((Html(f"<li>{safe(item)}</li>") for item in items), Html("\n"))
    return Html(f"<ul>\n{said}\n</ul>\n")


def facts(pairs: Iterable[tuple[str, str]]) -> Html:
    """Names and what there is to say of each; those of which there is nothing are left out."""
    said = [Html(f"<dt>{safe(name)}</dt><dd>{safe(text)}</dd>\n") for name, text in pairs if text]
    return Html(f"<dl>\n{joined(said)}</dl>\n") if said else Html("")


def table(columns: Sequence[str], rows: Iterable[Row]) -> Html:
    """Columns whose names end with `>` hold numbers, and are set right."""
    kinds = [_of_class("number" if column.endswith(">") else "") for column in columns]
    head = joined(
        Html(f"<th{kind}>{safe(column.removesuffix('>'))}</th>")
        for column, kind in zip(columns, kinds, strict=True)
    )
    body = [
        Html(
            f"<tr{_of_class('chosen' if row.chosen else '')}>"
            + joined(
                Html(f"<td{kind}>{safe(cell)}</td>") for cell, kind in zip(row.cells, kinds, strict=True)
            )
            + "</tr>\n"
        )
        for row in rows
    ]
    content = f"<thead><tr>{head}</tr></thead>\n<tbody>\n{joined(body)}</tbody>"
    return Html(f'<div class="wide"><table>\n{content}</table></div>\n')


def picture(svg: bytes, alt: str, caption: str) -> Html:
    """A picture that is in the page itself."""
    source = f"data:image/svg+xml;base64,{b64encode(svg).decode('ascii')}"
    return Html(
        f'<figure><div class="wide"><img src="{source}" alt="{safe(alt)}"></div>\n'
        f"<figcaption>{safe(caption)}</figcaption></figure>\n"
    )


def document(title: str, style: str, body: str) -> str:
    """A page that may ask nothing of anyone, and says so to the browser; no line of it begins with a percent
    sign."""
    body = body.replace(" %", "\N{NO-BREAK SPACE}%")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta http-equiv="Content-Security-Policy" '
        "content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:\">\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{safe(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n{body}</body>\n</html>\n"
    )
