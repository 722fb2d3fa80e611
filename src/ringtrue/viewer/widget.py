"""The 3D viewer in notebooks: an anywidget that has the viewer's one module."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import anywidget
import traitlets

from ringtrue.viewer.encoding import asset, to_block, viewer_module

_RENDER = """
function render({ model, el }) {
  const box = document.createElement("div");
  box.style.setProperty("--h", `${model.get("height")}px`);
  el.append(box);
  const theme = document.body.dataset.jpThemeLight === "false" ? "dark" : "light";
  const { view } = figure(box, unpack(model.get("drawn")), { theme });
  const shown = () => view.show(model.get("state"));
  const found = (key) => (value) => { model.set(key, value); model.save_changes(); };
  view.show({ theme });
  shown();
  model.on("change:state", shown);
  view.on("pick", found("picked"));
  view.on("box", found("boxed"));
  return () => view.destroy();
}
export default { render };
"""


class ViewerWidget(anywidget.AnyWidget):
    """A view as a widget.

    Attributes
    ----------
    drawn : bytes
        What `figure` of figure.js draws, as a block.
    state : dict
        What is shown, in the names and values of `view.show` of viewer.js.
    picked, boxed : dict
        What was clicked on, and what was inside a rectangle drawn with Ctrl.
    height : int
        Of the drawing, pixels.
    """

    _esm: ClassVar[str] = viewer_module() + _RENDER
    _css: ClassVar[str] = asset("viewer.css")
    drawn = traitlets.Bytes().tag(sync=True)
    state = traitlets.Dict().tag(sync=True)
    picked = traitlets.Dict(allow_none=True, default_value=None).tag(sync=True)
    boxed = traitlets.Dict(allow_none=True, default_value=None).tag(sync=True)
    height = traitlets.Int().tag(sync=True)

    def __init__(self, payload: Mapping[str, Any], height: int) -> None:
        super().__init__(drawn=to_block(payload), height=height)
