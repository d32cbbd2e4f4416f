"""A program of :mod:`optipromp.robots.limited`: the URDF that a xacro file expands to."""

import json
import sys
from pathlib import Path


def main() -> None:
    """Expand a file; ``folders``: of packages by name, ``package_dirs``: that hold packages."""
    given = json.load(sys.stdin)
    sys.stdin.close()
    try:
        import resource
    except ImportError:  # Windows
        pass
    else:
        resource.setrlimit(resource.RLIMIT_AS, (given["memory"],) * 2)
        resource.setrlimit(resource.RLIMIT_FSIZE, (given["output"],) * 2)
    try:
        import xacro
        from xacrodoc import packages

        packages.reset()
        if given["package_dirs"]:
            packages.look_in(given["package_dirs"])
        packages.walk_up_from(given["path"])
        packages.update_package_cache(given["folders"])
        text = xacro.process_file(given["path"]).toxml()
        Path(given["out"]).write_text(text, encoding="utf-8")
    except (Exception, SystemExit) as error:  # xacro raises whatever goes wrong in the file
        print(f"{type(error).__name__}: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(3)


if __name__ == "__main__":
    main()
