"""The screens: each a module with one function `build(session)`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ringtrue.studio.session import StudioSession


@dataclass(frozen=True, slots=True)
class Screen:
    """A screen.

    Attributes
    ----------
    name : str
        Its module, and its address.
    title, icon : str
    stages : tuple of str
        Stages of the study whose state it shows; the last one is what it runs up to.
    figures : bool
        It draws with plotly, which the page then fetches first.
    """

    name: str
    title: str
    icon: str
    stages: tuple[str, ...] = ()
    figures: bool = False

    @property
    def build(self) -> Callable[[StudioSession], object]:
        """What fills the page; imported when it is shown first."""
        function: Callable[[StudioSession], object] = import_module(
            f"{__name__}.{self.name}"
        ).build
        return function


SCREENS = (
    Screen("model", "Model", "view_in_ar", ("model",)),
    Screen("plan", "Plan", "edit_location_alt", ("plan",)),
    Screen("sensors", "Sensors", "sensors"),
    Screen("signals", "Signals and impacts", "graphic_eq", ("identify",), figures=True),
    Screen("poles", "Poles", "scatter_plot", ("identify",), figures=True),
    Screen("frfs", "FRFs", "show_chart", figures=True),
    Screen(
        "correlation", "Correlation", "grid_on", ("compare", "correlate"), figures=True
    ),
    Screen("where", "Where it is wrong", "my_location", ("localise",)),
    Screen(
        "update",
        "Update",
        "tune",
        ("sensitivity", "update", "tune", "final"),
        figures=True,
    ),
    Screen(
        "verdict",
        "Verdict and report",
        "fact_check",
        ("uncertainty", "damping", "predict"),
    ),
)
BEGIN = Screen("begin", "A new study", "add")  # where there is no study.toml yet
