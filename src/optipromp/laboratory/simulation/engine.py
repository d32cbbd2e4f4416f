"""MuJoCo, imported when it is first needed."""

import os
import sys
from typing import Any

from optipromp.core.errors import InvalidRequestError, installed_by


def engine() -> Any:
    """The ``mujoco`` module; it renders off screen by EGL unless ``MUJOCO_GL`` says otherwise."""
    if sys.platform.startswith("linux"):
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except ImportError:
        raise InvalidRequestError(f"the simulation needs MuJoCo: {installed_by('sim')}") from None
    return mujoco
