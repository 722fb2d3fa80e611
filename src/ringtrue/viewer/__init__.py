"""The one 3D viewer: WebGL code, its style, and the views that it draws."""
