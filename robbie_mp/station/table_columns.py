"""Columns of the tables on the page."""

from typing import Any


def columns(*names: str) -> list[dict[str, Any]]:
    """Describe columns of a table whose rows have these names as keys."""
    return [{"name": name, "label": name, "field": name, "align": "left", "sortable": True} for name in names]
