"""Fills the templates of pages. Everything that comes from a case or a configuration is escaped."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from flying_vines.identification.report import words

TEMPLATES = Path(__file__).with_name("templates")


def filled(template: Path, pictures: Mapping[str, bytes], **content: Any) -> str:
    """A page that contains its pictures.

    Args:
        template: may extend and include others from its folder and from `TEMPLATES`.
        pictures: SVG by name, for the macro `figure`.
        content: the other names of the template.
    """
    environment = Environment(
        autoescape=True,
        loader=FileSystemLoader([template.parent, TEMPLATES]),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {
        "keep_percent_on_line": lambda body: body.replace(" %", "\N{NO-BREAK SPACE}%"),
        "label_and_unit": words.label_and_unit,
        "number": format,
        "numbers": words.numbers,
        "rounded": words.rounded,
        "share": words.share,
    }
    shown = {name: f"data:image/svg+xml;base64,{b64encode(svg).decode()}" for name, svg in pictures.items()}
    return environment.get_template(template.name).render(pictures=shown, **content)
