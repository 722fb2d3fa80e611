"""The process that `door` starts: parsers in C, and their results as plain arrays, texts, lists
and dicts.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ringtrue.io.foreign.door import DAMAGE, PACKED

# a parser is imported where it is used: a start with all of them takes twice the time
if TYPE_CHECKING:
    import h5py

try:
    import resource
except ImportError:  # Windows: the parent's clock is the only limit
    resource = None  # type: ignore[assignment]

_PAGES = Path("/proc/self/statm")  # Linux
_SAME_FILE = "."  # the name that a virtual data set has for its own file
# bytes up to which a data set is read whole; the samples of larger ones lie in plain blocks
_WHOLE = 1 << 26
_NUMBER = 8  # bytes that a number takes once it is read, however small it is stored
# seconds that the parent's clock has to stop this process before its own does
_LATER = 5


class _Damaged(RuntimeError):
    """Of a part that no reader may touch."""


def serve() -> None:
    """Read what the parent asks for, until it closes the pipe."""
    asked = sys.stdin.buffer
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # what a parser prints is no answer
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    answers.write(b".")
    answers.flush()
    while True:
        try:
            parser, path, seconds, memory = pickle.load(asked)
        except EOFError:
            return
        parse, module = PARSERS[parser]
        import_module(module)
        answers.write(b".")  # its import is no time of a file
        answers.flush()
        _limit(seconds, memory)
        try:
            answer: tuple[str, Any] = ("done", parse(path))
        except DAMAGE as exc:
            answer = (
                "failed",
                f"{type(exc).__name__}: {' '.join(str(exc).split())[:200]}",
            )
        _limit(0, 0)
        pickle.dump(answer, answers, protocol=5)
        answers.flush()


def _limit(seconds: float, memory: int) -> None:
    """So that a parser without end does not outlive a parent that was killed, nor takes the
    machine's memory; none for `seconds` 0, while this process waits or imports a parser.
    """
    if resource is None:
        return
    signal.alarm(int(seconds) + _LATER if seconds else 0)
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    most = hard
    if seconds and _PAGES.exists():
        most = int(_PAGES.read_text().split()[0]) * resource.getpagesize() + memory
        if hard != resource.RLIM_INFINITY:
            most = min(most, hard)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))


def _matrix_market(path: str) -> Any:
    from scipy import io, sparse

    return sparse.csr_array(cast(Any, io.mmread(path, spmatrix=False)))


def _matlab(path: str) -> dict[str, Any]:
    """Arrays, sparse matrices (csr), texts (str), cells (object arrays) and structures (dict) by
    name.
    """
    from scipy import io

    # mat_dtype=True drops imaginary parts
    found = io.loadmat(path, spmatrix=False, appendmat=False)
    plain = {
        name: _plain(value)
        for name, value in found.items()
        if not name.startswith("__")
    }
    return {name: value for name, value in plain.items() if value is not None}


def _plain(value: Any) -> Any:
    """None for objects and functions."""
    from scipy import sparse

    if sparse.issparse(value):
        return sparse.csr_array(cast(Any, value))
    if type(value) is not np.ndarray:
        return None
    if value.dtype.names and value.size <= 1:
        only = value.reshape(-1)
        return (
            {name: _plain(only[0][name]) for name in value.dtype.names}
            if value.size
            else None
        )
    # of several structures, each field as an object array of its values
    if value.dtype.names:
        return {name: _plain(value[name].ravel()) for name in value.dtype.names}
    if value.dtype.kind == "O":
        cells = np.empty(value.shape, dtype=object)
        for k, cell in enumerate(value.flat):
            cells.flat[k] = _plain(cell)
        return cells
    if value.dtype.kind == "U":
        return "\n".join(value.ravel().tolist())
    if value.dtype.kind == "b":
        return value.astype(np.uint8)
    return value.astype(value.dtype.newbyteorder("="), order="F", copy=False)


def _hdf5(path: str) -> str:
    """Read what a reader may read: if HDF5 does not come back from it, ends or takes all memory, it
    does so here.

    Errors are left to the reader, who may not touch what is damaged; those of memory are passed on,
    as this process is given less of it, and those of damaged headers and of attributes that cannot
    be listed.

    Returns
    -------
    str
        The first thing that stands in another file, in words; empty if there is none.
    """
    import h5py

    outside: list[str] = []
    seen: set[int] = set()
    size = Path(path).stat().st_size
    with h5py.File(path, "r") as file:
        todo: list[h5py.Group | h5py.Dataset] = [file]
        while todo:
            item = todo.pop()
            try:
                with _damage(f"the header of {item.name} is damaged"):
                    address = int(h5py.h5o.get_info(item.id).addr)
                if address in seen:
                    continue
                seen.add(address)
                with _damage(f"the attributes of {item.name} cannot be listed"):
                    names = list(item.attrs)
                for name in names:
                    try:
                        item.attrs[name]  # it may be of a type that numpy does not have
                    except (OSError, TypeError, ValueError) as exc:
                        if "alloc" in str(exc):
                            raise MemoryError(str(exc)) from exc
                if isinstance(item, h5py.Group):
                    todo += _children(item, outside)
                elif not isinstance(item, h5py.Dataset):
                    continue  # a type with a name
                elif others := _stored_elsewhere(item):
                    outside.append(f"the samples of {item.name} stand in {others[0]}")
                elif (item.size or 0) * max(item.dtype.itemsize, _NUMBER) > max(
                    _WHOLE, PACKED * size
                ):
                    raise MemoryError(
                        f"{item.name} announces shape {item.shape}, the file holds {size} bytes"
                    )
                else:
                    _touch(item)
            except (MemoryError, _Damaged):
                raise
            except DAMAGE as exc:
                if "alloc" in str(exc):
                    raise MemoryError(str(exc)) from exc
    return outside[0] if outside else ""


@contextmanager
def _damage(what: str) -> Iterator[None]:
    """Of a damaged header, or attributes that cannot be listed, HDF5 may not come back in reading
    an attribute.
    """
    try:
        yield
    except DAMAGE as exc:
        raise _Damaged(f"{what}: {exc}") from exc


def _children(group: h5py.Group, outside: list[str]) -> list[h5py.Group | h5py.Dataset]:
    """What a group holds; what it links to in other files is added to `outside`."""
    import h5py

    found = []
    for name in group:
        try:
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                outside.append(f"{name} is a link to {link.filename}")
            elif isinstance(link, h5py.HardLink):
                found.append(group[name])
        except DAMAGE:  # its neighbours may be whole
            continue
    return found


def _stored_elsewhere(data: h5py.Dataset) -> list[str]:
    """The files that hold the samples of a data set, other than its own."""
    import h5py

    made = data.id.get_create_plist()
    if made.get_external_count():
        return [os.fsdecode(made.get_external(0)[0])]
    if made.get_layout() == h5py.h5d.VIRTUAL:
        return [
            source.file_name
            for source in data.virtual_sources()
            if source.file_name != _SAME_FILE
        ]
    return []


def _touch(data: h5py.Dataset) -> None:
    if data.chunks is not None:
        data.id.get_num_chunks()
    if data.size * data.dtype.itemsize <= _WHOLE:
        data[()]
    elif data.ndim:
        data[tuple(slice(0, 1) for _ in data.shape)]


# each with the module that it imports
PARSERS: dict[str, tuple[Callable[[str], Any], str]] = {
    "matlab": (_matlab, "scipy.io"),
    "matrix market": (_matrix_market, "scipy.io"),
    "hdf5": (_hdf5, "h5py"),
}
