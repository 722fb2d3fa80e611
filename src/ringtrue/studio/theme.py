"""Colours of the studio, light and dark, and figures in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from nicegui import ui

from ringtrue.plots.style import GRID, INK, MUTED, SEQUENTIAL

PRIMARY = "#24527a"
DARK_PAPER, DARK_INK, DARK_GRID, DARK_MUTED = "#161b21", "#dfe5eb", "#313a44", "#9aa7b4"
# light colours of figures that would vanish on a dark page
ON_DARK = {INK: DARK_INK, MUTED: DARK_MUTED, GRID: DARK_GRID, "#24527a": "#6fa8d8"}
DARK_SEQUENTIAL = (
    (0.0, DARK_PAPER),
    (0.25, "#1d3a4d"),
    (0.5, "#2b6484"),
    (0.75, "#5fa6c8"),
    (1.0, "#d5eefa"),
)
CSS = Path(__file__).with_name("studio.css")


def apply() -> None:
    """The look of a page."""
    ui.colors(
        primary=PRIMARY,
        secondary="#0b7a75",
        accent="#d55e00",
        dark="#1b2129",
        dark_page=DARK_PAPER,
    )
    ui.add_css(CSS)


def drawn(figure: go.Figure, *, dark: bool, tools: bool = True) -> dict[str, Any]:
    """A figure for the page, in its theme; what holds it decides its size.

    Parameters
    ----------
    figure : plotly figure
    dark : bool
    tools : bool
        With the buttons to zoom and move.
    """
    spec: dict[str, Any] = figure.to_plotly_json()
    layout = spec["layout"]
    layout["height"] = None
    # they stand above a legend of two rows
    if tools and layout.get("showlegend", True):
        layout["margin"] = {
            **layout["margin"],
            "t": max(64, layout["margin"].get("t", 0)),
        }
    layout["uirevision"] = "kept"  # zoom and hidden traces stay when the figure changes
    layout["paper_bgcolor"] = layout["plot_bgcolor"] = "rgba(0,0,0,0)"
    layout["modebar"] = {
        "bgcolor": "rgba(0,0,0,0)",
        "color": DARK_MUTED if dark else MUTED,
    }
    if dark:
        spec = _recoloured(spec)
        spec["layout"]["hoverlabel"] = {
            "bgcolor": "#232b34",
            "font": {"color": DARK_INK},
        }
    spec["config"] = {"displaylogo": False, "responsive": True}
    spec["config"]["modeBarButtonsToRemove"] = ["select2d", "lasso2d", "autoScale2d"]
    spec["config"] |= {"scrollZoom": True} if tools else {"displayModeBar": False}
    return spec


def _recoloured(value: Any) -> Any:
    """Every colour that would vanish by its counterpart."""
    if isinstance(value, dict):
        return {k: _recoloured(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        if tuple(tuple(v) for v in value if isinstance(v, list | tuple)) == SEQUENTIAL:
            return [list(stop) for stop in DARK_SEQUENTIAL]
        return [_recoloured(v) for v in value]
    return ON_DARK.get(value, value) if isinstance(value, str) else value
