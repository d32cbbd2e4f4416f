"""A program of :mod:`optipromp.robots.limited`: the model that MuJoCo compiles of an MJCF file."""

import json
import os
import sys
from pathlib import Path


def main() -> None:
    """Compile a file, and leave the model as MuJoCo's binary file."""
    given = json.load(sys.stdin)
    try:
        import resource
    except ImportError:  # Windows
        pass
    else:
        resource.setrlimit(resource.RLIMIT_AS, (given["memory"],) * 2)
        resource.setrlimit(resource.RLIMIT_FSIZE, (given["output"],) * 2)
    import mujoco

    try:
        os.chdir(Path(given["out"]).parent)  # where MuJoCo leaves its log
        model = mujoco.MjModel.from_xml_path(given["path"])
        mujoco.mj_saveModel(model, given["out"])
    except (ValueError, MemoryError, mujoco.FatalError) as error:
        print(f"{error}" or type(error).__name__, file=sys.stderr)  # noqa: T201
        sys.exit(3)


if __name__ == "__main__":
    main()
