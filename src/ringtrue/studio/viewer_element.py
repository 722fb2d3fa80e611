"""The 3D viewer as an element of a page: arrays go over HTTP as bytes, what is shown over the
websocket.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from nicegui import app
from nicegui.element import Element
from nicegui.events import GenericEventArguments
from starlette.responses import Response

import ringtrue.viewer
from ringtrue.core.arrays import Float, Int
from ringtrue.errors import InputError
from ringtrue.viewer.scene import View, f4, shape_arrays, to_block, u4

ROUTE = "/ringtrue/viewer/"
EVENTS = ("pick", "menu", "hover", "box", "drag", "camera")
SOURCES = Path(ringtrue.viewer.__file__).parent
_blocks: dict[str, bytes] = {}  # by their address
_users: Counter[str] = Counter()  # elements that show a block


@app.get(ROUTE + "{key}")
def block(key: str) -> Response:
    """The bytes of a scene or a shape; no content where what showed it has gone meanwhile."""
    found = _blocks.get(ROUTE + key)
    if found is None:
        return Response(status_code=204)
    kept = {"Cache-Control": "private, max-age=86400, immutable"}
    return Response(found, media_type="application/octet-stream", headers=kept)


class Viewer(
    Element, component="viewer_element.js", esm={"ringtrue-viewer": str(SOURCES)}
):
    """A 3D view.

    Parameters
    ----------
    drawn : View or mapping
        A `View` with its controls and legend; or the scene alone: `model` of `model_arrays`, `test`
        of `test_arrays`, `sensors` of `sensor_arrays`.
    linked : str, optional
        Views of a page that have the same name here share their clock and their camera.
    **options
        Of `mount` in viewer.js: `pick`, `drag`, `controls`, `wheel`, `tips`, `theme`.

    Notes
    -----
    `viewer.on_event("pick", f)` calls `f` with a dict that has `kind`, `id` and `group`, or with
    None. What is shown stands in properties: it is the same after the page is loaded again.
    """

    def __init__(
        self, drawn: View | Mapping[str, Any], *, linked: str = "", **options: Any
    ) -> None:
        super().__init__()
        whole = isinstance(drawn, View)
        payload = drawn.payload if isinstance(drawn, View) else drawn
        self._used: dict[str, str] = {}
        self._props["drawn"] = self._placed("drawn", payload)
        self._props["whole"] = whole
        self._props["options"] = options
        self._props["linked"] = linked
        self._props["model-shapes"] = {}
        self._props["test-shapes"] = {}
        self._props["fields"] = {}
        self._props["sensors"] = ""
        self._props["state"] = {}
        self._props["playing"] = whole
        self._props["aim"] = None
        self._flights = 0
        if not whole:
            self.style("height: 100%")

    def show(self, **state: Any) -> Self:
        """Change what is shown; names and values are those of `view.show` in viewer.js.

        `viewer.show(mode="FE 3", isolate={"property": [2]}, clip=None)`.
        """
        self._props["state"] = {**self._props["state"], **plain(state)}
        self.update()
        return self

    def shapes(
        self, name: str, real: Float, imag: Float | None = None, *, on: str = "model"
    ) -> Self:
        """Keep a shape, which `show(mode=name)` moves the model by and `show(test=name)` the test.

        Parameters
        ----------
        name : str
        real, imag : (node, 3) float64
            Of the nodes of the scene in their order, or of the points of the test.
        on : {"model", "test"}
        """
        if on not in ("model", "test"):
            raise InputError(f"shapes(on={on!r}): allowed are model, test")
        address = self._placed(f"shape {on} {name}", shape_arrays(real, imag))
        key = f"{on}-shapes"
        self._props[key] = {**self._props[key], name: {"address": address}}
        self.update()
        return self

    def field(
        self,
        name: str,
        values: Float,
        *,
        of: str = "node",
        ids: Int | None = None,
        **look: Any,
    ) -> Self:
        """Keep a field, which `show(field=name)` colours the model by.

        Parameters
        ----------
        name : str
        values : (n,) float64
        of : {"node", "element"}
        ids : (n,) int64, optional
            Node or element numbers; all of the scene in their order without.
        **look
            `unit`, `range`, `signed`.
        """
        arrays: dict[str, Any] = {"values": f4(values), "of": of}
        if ids is not None:
            arrays["ids"] = u4(ids)
        address = self._placed(f"field {name}", arrays)
        entry = {"address": address, "look": look}
        self._props["fields"] = {**self._props["fields"], name: entry}
        self.update()
        return self

    def sensors(self, arrays: Mapping[str, Any]) -> Self:
        """Put other sensors (`sensor_arrays`) in place of those of the scene."""
        self._props["sensors"] = self._placed("sensors", arrays)
        self.update()
        return self

    def play(self, on: bool = True) -> Self:
        """Begin or end the motion."""
        self._props["playing"] = on
        self.update()
        return self

    def fly(self, selection: Mapping[str, Any] | None = None) -> Self:
        """Move the camera to elements, nodes or sensors; to all without."""
        self._flights += 1
        self._props["aim"] = {"count": self._flights, "selection": plain(selection)}
        self.update()
        return self

    def on_event(self, name: str, call: Callable[[Any], Any]) -> Self:
        """Call a function at an event.

        Parameters
        ----------
        name : {"pick", "menu", "hover", "box", "drag", "camera"}
        call : function
            Is given what viewer.js says of the event: a dict, or None where nothing was hit.
        """
        if name not in EVENTS:
            raise InputError(f"event {name!r}: allowed are {', '.join(EVENTS)}")

        def heard(event: GenericEventArguments) -> Any:
            return call(event.args)

        self.on(f"view-{name}", heard)  # "drag" alone is the browser's own event
        return self

    def _placed(self, what: str, payload: Any) -> str:
        """The address of the bytes of a payload, in place of what was there before."""
        data = to_block(payload)
        address = ROUTE + hashlib.blake2b(data, digest_size=16).hexdigest()
        if self._used.get(what) == address:
            return address
        self._released(what)
        _blocks[address] = data
        _users[address] += 1
        self._used[what] = address
        return address

    def _released(self, what: str) -> None:
        address = self._used.pop(what, None)
        if address is None:
            return
        _users[address] -= 1
        if not _users[address]:
            del _users[address], _blocks[address]

    def _handle_delete(self) -> None:
        for what in list(self._used):
            self._released(what)
        super()._handle_delete()


def plain(value: Any) -> Any:
    """Numbers and lists in place of arrays, for JSON."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Mapping):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(v) for v in value]
    return value
