"""Build the message packages of ROS 2 that have no wheel, into the environment that runs this.

The generators of the wheels make them (cmake and a C++ compiler are needed). The definitions are
those that the project reads messages by, and those of an action and a service in ``definitions``.
"""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from graphlib import TopologicalSorter
from pathlib import Path

from optipromp_ros import typestore

HERE, ENVIRONMENT = Path(__file__).parent, Path(sys.prefix)
WANTED = (  # what the node speaks, and what is in it
    "tf2_msgs/msg/TFMessage", "vision_msgs/msg/Detection3DArray", "moveit_msgs/msg/PlanningScene",
    "moveit_msgs/msg/DisplayTrajectory", "moveit_msgs/msg/MotionPlanRequest",
    "moveit_msgs/msg/MotionPlanResponse",
)  # fmt: skip
HEADING = "=" * 80  # between the definitions of a type and of those in it
ABOUT = """<package format="3"><name>{name}</name><version>0.0.0</version>
<description>for tests</description><maintainer email="none@example.org">none</maintainer>
<license>BSD-3-Clause</license><buildtool_depend>ament_cmake</buildtool_depend>{needs}
<member_of_group>rosidl_interface_packages</member_of_group></package>
"""


def definitions() -> dict[str, dict[str, str]]:
    """The files of each package that is not installed, by the name of the package."""
    found: dict[str, dict[str, str]] = {}
    for file in (HERE / "definitions").rglob("*.*"):
        package, name = file.relative_to(HERE / "definitions").as_posix().split("/", 1)
        found.setdefault(package, {})[name] = file.read_text()
    for wanted in WANTED:
        first, *others = typestore().generate_msgdef(wanted, ros_version=2)[0].split(HEADING)
        texts = {wanted.replace("/msg/", "/"): first}
        for other in others:
            heading, _, text = other.strip().partition("\n")
            texts[heading.removeprefix("MSG: ")] = text
        for name, text in texts.items():
            package, kind = name.replace("/msg/", "/").split("/")
            if not (ENVIRONMENT / "share" / package).exists() or package in found:
                found.setdefault(package, {})[f"msg/{kind}.msg"] = text
    return found


def needs(files: dict[str, str], name: str) -> set[str]:
    """The packages whose types stand in some files of a package."""
    names = set(re.findall(r"^([a-z0-9_]+)/", "\n".join(files.values()), re.MULTILINE)) - {name}
    return names | ({"action_msgs"} if any("action/" in file for file in files) else set())


def build(name: str, files: dict[str, str], work: Path) -> None:
    """Generate, compile and install one package."""
    folder = work / name
    for file, text in files.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text)
    used = sorted(needs(files, name)) or ["builtin_interfaces"]
    shutil.copy(HERE / "CMakeLists.txt", folder)
    depends = "".join(f"<depend>{one}</depend>" for one in used)
    (folder / "package.xml").write_text(ABOUT.format(name=name, needs=depends))
    prefix = str(ENVIRONMENT)
    env = os.environ | {
        "PATH": f"{prefix}/bin:{os.environ['PATH']}", "AMENT_PREFIX_PATH": prefix,
        "CMAKE_PREFIX_PATH": prefix, "LD_LIBRARY_PATH": f"{prefix}/lib",
        "CXXFLAGS": "-O0", "CFLAGS": "-O0",
    }  # fmt: skip
    call = [
        "cmake", "-S", str(folder), "-B", str(folder / "build"),
        f"-DPython3_EXECUTABLE={sys.executable}", f"-DCMAKE_INSTALL_PREFIX={folder / 'made'}",
        f"-DNAME={name}", f"-DFILES={';'.join(files)}", f"-DNEEDS={';'.join(used)}",
    ]  # fmt: skip
    told = subprocess.run(call, env=env, capture_output=True, text=True, check=False)
    call = ["make", "-C", str(folder / "build"), "-j2", "install"]
    made = subprocess.run(call, env=env, capture_output=True, text=True, check=False)
    if made.returncode:
        raise SystemExit(
            f"{name}: {told.stderr[-3000:]}\n{made.stdout[-2000:]}{made.stderr[-3000:]}"
        )
    (python,) = (folder / "made").rglob(f"{name}/__init__.py")
    shutil.copytree(folder / "made", ENVIRONMENT, dirs_exist_ok=True)
    to = Path(sysconfig.get_path("purelib")) / name
    shutil.copytree(python.parent, to, dirs_exist_ok=True)


def main() -> None:
    """Build them, each after those that it needs."""
    true = sysconfig.get_path("include")
    for file in (ENVIRONMENT / "share").rglob("*.cmake"):  # where the wheels were made
        text = file.read_text()
        if "/opt/python/cp311-cp311/include/python3.11" in text:
            file.write_text(text.replace("/opt/python/cp311-cp311/include/python3.11", true))
    packages = definitions()
    order = TopologicalSorter({name: needs(files, name) for name, files in packages.items()})
    with tempfile.TemporaryDirectory() as work:
        for name in order.static_order():
            if name in packages:
                print(name, len(packages[name]), flush=True)
                build(name, packages[name], Path(work))


if __name__ == "__main__":
    main()
