"""Turn contexts into HTML that needs no other file."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import jinja2

TEMPLATES = Path(__file__).parent / "templates"


def render(template: str, context: dict[str, Any]) -> str:
    """Return a page.

    Args:
        template: Name of a file in the folder of templates.
        context: Values for it; a value that the template needs and that is missing is an error.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["uri"] = data_uri
    return environment.get_template(template).render(context)


def data_uri(data: bytes, kind: str) -> str:
    """Return bytes as an address that holds them.

    Args:
        data: The bytes.
        kind: Their media type, such as ``image/png``.
    """
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def shown(value: Any) -> str:
    """Return a setting's value as a user would write it."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list):
        return "[" + ", ".join(map(shown, value)) + "]"
    return str(value) if value != "" else "''"
