"""Solvers by name: built-ins, and plug-ins from the entry points `ringtrue.solvers`."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from inspect import signature
from typing import Any

from ringtrue.core.iterate import Progress, quiet
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.model.ports import ModalSolver
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.mystran import MystranSolver
from ringtrue.solvers.nastran import NastranSolver
from ringtrue.solvers.slepc import SlepcSolver

GROUP = "ringtrue.solvers"
EMBEDDED = "embedded"
BUILT_IN: dict[str, Callable[..., ModalSolver]] = {
    EMBEDDED: EmbeddedSolver,
    "mystran": MystranSolver,
    "nastran": NastranSolver,
    "slepc": SlepcSolver,
}


def names() -> tuple[str, ...]:
    """All known solvers, sorted."""
    return tuple(sorted({*BUILT_IN, *_plugins()}))


def time_limits() -> dict[str, float]:
    """Time limit in s of a run of each built-in solver that is another program, where none is
    given.
    """
    limits = {
        name: signature(made).parameters.get("timeout")
        for name, made in BUILT_IN.items()
    }
    return {
        name: float(limit.default)
        for name, limit in limits.items()
        if limit is not None
    }


def solver(
    name: str = EMBEDDED,
    *,
    ranks: int | None = None,
    launcher: str = "",
    timeout: float | None = None,
    progress: Progress = quiet,
) -> ModalSolver:
    """The solver of that name, with its default settings.

    Parameters
    ----------
    name : str
    ranks : int, optional
        Processes; only for a solver that takes them.
    launcher : str
        What starts them, in place of their number, such as `srun -n 64`.
    timeout : float, s, optional
        Longest time that a run may take; only for a solver that takes one.
    progress : callable (fraction, text)
        Called by the embedded solver, not by the others.

    Raises
    ------
    ConfigError
        If there is none, a plug-in's object is not a solver, or it takes no ranks or no time limit.
    """
    if name not in names():
        raise ConfigError(f"no solver {name!r}{did_you_mean(name, names())}")
    make = BUILT_IN[name] if name in BUILT_IN else _plugins()[name].load()
    settings: dict[str, Any] = {}
    if ranks is not None or launcher:
        if name != "slepc":
            raise ConfigError(
                f"solver {name!r} runs in one process; ranks and a launcher are for 'slepc'"
            )
        settings |= {"ranks": ranks, "launcher": launcher}
    if timeout is not None:
        if not timeout > 0:
            raise ConfigError(
                f"solver {name!r}: a time limit of {timeout:g} s; must be above 0"
            )
        if "timeout" not in signature(make).parameters:
            limited = ", ".join(time_limits())
            raise ConfigError(
                f"solver {name!r} has no time limit; those that have one: {limited}"
            )
        settings["timeout"] = timeout
    if name == EMBEDDED:
        settings["progress"] = progress
    made = make(**settings)
    if not isinstance(made, ModalSolver):
        plugin = _plugins()[name].value
        raise ConfigError(
            f"plug-in {plugin} ({GROUP}) made a {type(made).__name__} without open()"
        )
    return made


def _plugins() -> dict[str, EntryPoint]:
    return {p.name: p for p in entry_points(group=GROUP)}
