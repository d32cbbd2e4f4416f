"""The functions that :mod:`optipromp.readers.packages` runs in a process of their own."""

import json
import os
import sys
from pathlib import Path
from typing import Any, NoReturn


def compile_mjcf(given: dict[str, Any]) -> None:
    """Compile an MJCF file to MuJoCo's binary file."""
    import mujoco

    try:
        os.chdir(Path(given["out"]).parent)  # where MuJoCo leaves its log
        model = mujoco.MjModel.from_xml_path(given["path"])
        mujoco.mj_saveModel(model, given["out"])
    except (ValueError, MemoryError, mujoco.FatalError) as error:
        _fail(f"{error}" or type(error).__name__)


def expand_xacro(given: dict[str, Any]) -> None:
    """Expand a xacro file to a URDF.

    ``folders``: of packages by name; ``package_dirs``: that hold packages; ``args``: values by
    name. The output is a JSON object: the text ``urdf``, the paths ``files`` that xacro read, and
    the names ``args`` of the arguments that these files declare.
    """
    try:
        import xacro
        from xacrodoc import packages

        packages.reset()
        if given["package_dirs"]:
            packages.look_in(given["package_dirs"])
        packages.walk_up_from(given["path"])
        packages.update_package_cache(given["folders"])
        arguments = _Arguments(given["args"])
        text = xacro.process_file(given["path"], mappings=arguments).toxml()
        files = [given["path"], *map(os.path.abspath, xacro.all_includes)]
        told = {"urdf": text, "files": files, "args": list(arguments.asked)}
        Path(given["out"]).write_text(json.dumps(told), encoding="utf-8")
    except (Exception, SystemExit) as error:  # xacro raises whatever goes wrong in the file
        _fail(f"{type(error).__name__}: {error}")


class _Arguments(dict[str, str]):
    """Arguments of a xacro, which looks for each one that it declares or uses."""

    def __init__(self, values: dict[str, str]) -> None:
        super().__init__(values)
        self.asked: dict[str, None] = {}  # the names that were looked for, in order

    def __contains__(self, name: object) -> bool:
        self.asked[str(name)] = None
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:  # used, and maybe not declared
        self.asked[name] = None
        return super().__getitem__(name)


def _fail(words: str) -> NoReturn:
    print(words, file=sys.stderr)  # noqa: T201
    sys.exit(3)


def main() -> None:
    """Run the function that standard input names, within the limits stated there."""
    given = json.load(sys.stdin)
    sys.stdin.close()
    try:
        import resource
    except ImportError:  # Windows
        pass
    else:
        resource.setrlimit(resource.RLIMIT_AS, (given["memory"],) * 2)
        resource.setrlimit(resource.RLIMIT_FSIZE, (given["output"],) * 2)
    {"compile_mjcf": compile_mjcf, "expand_xacro": expand_xacro}[given["program"]](given)


if __name__ == "__main__":
    main()
