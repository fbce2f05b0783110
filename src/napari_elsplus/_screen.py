"""Test for a screen with OpenGL: ``python -m napari_elsplus._screen``.

A separate program, because Qt ends a process that has no usable screen. Exits 0 and prints platform and renderer; else
exits with another code and prints the reason to standard error.
"""

from __future__ import annotations

import os
import sys

INVISIBLE_PLATFORMS = ("offscreen", "minimal", "minimalegl")


def main() -> int:
    """Open a screen and an OpenGL context with Qt, and print the renderer."""
    platform_name = os.environ.get("QT_QPA_PLATFORM", "")
    display = platform_name or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not display:
        return _fail("neither DISPLAY nor WAYLAND_DISPLAY is set")
    try:
        from qtpy.QtGui import QGuiApplication, QOffscreenSurface, QOpenGLContext
    except ImportError as error:
        return _fail(str(error).strip().splitlines()[0])
    application = QGuiApplication([])
    platform = application.platformName()
    if platform in INVISIBLE_PLATFORMS:
        return _fail(f"the Qt platform {platform!r} is invisible")
    surface, context = QOffscreenSurface(), QOpenGLContext()
    surface.create()
    if not (context.create() and context.makeCurrent(surface)):
        return _fail(f"the screen ({platform}) offers no OpenGL")
    from OpenGL import GL

    renderer, version = (GL.glGetString(name) for name in (GL.GL_RENDERER, GL.GL_VERSION))
    context.doneCurrent()
    sys.stdout.write(f"{platform}, OpenGL {version.decode()} on {renderer.decode()}\n")
    return 0


def _fail(reason: str) -> int:
    sys.stderr.write(f"{reason}\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
