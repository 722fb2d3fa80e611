"""Solvers by name: built-ins, and plug-ins from the entry points `ringtrue.solvers`."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points

from ringtrue.backends.embedded import EmbeddedSolver
from ringtrue.backends.mystran import MystranSolver
from ringtrue.backends.nastran import NastranSolver
from ringtrue.backends.slepc import SlepcSolver
from ringtrue.core.progress import Progress
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.model.ports import ModalSolver

GROUP = "ringtrue.solvers"
EMBEDDED = "embedded"
BUILT_IN: dict[str, Callable[[], ModalSolver]] = {
    EMBEDDED: EmbeddedSolver,
    "mystran": MystranSolver,
    "nastran": NastranSolver,
    "slepc": SlepcSolver,
}


def names() -> tuple[str, ...]:
    """All known solvers, sorted."""
    return tuple(sorted({*BUILT_IN, *_plugins()}))


def solver(name: str = EMBEDDED, *, ranks: int | None = None, progress: Progress | None = None) -> ModalSolver:
    """The solver of that name, with its default settings.

    Parameters
    ----------
    name : str
    ranks : int, optional
        Processes; only for a solver that takes them.
    progress : callable, optional
        Called with (share done, what) by the embedded solver; the others tell nothing.

    Raises
    ------
    ConfigError
        If there is none, a plug-in's object is not a solver, or it takes no ranks.
    """
    if ranks is not None:
        if name != "slepc":
            raise ConfigError(f"solver {name!r} runs in one process; ranks are for 'slepc'")
        return SlepcSolver(ranks=ranks)
    if name == EMBEDDED:
        return EmbeddedSolver(progress=progress)
    if name in BUILT_IN:
        return BUILT_IN[name]()
    plugins = _plugins()
    if name not in plugins:
        raise ConfigError(f"no solver {name!r}{did_you_mean(name, names())}")
    made = plugins[name].load()()
    if not isinstance(made, ModalSolver):
        raise ConfigError(f"plug-in {plugins[name].value} ({GROUP}) made a {type(made).__name__} without open()")
    return made


def _plugins() -> dict[str, EntryPoint]:
    return {p.name: p for p in entry_points(group=GROUP)}
