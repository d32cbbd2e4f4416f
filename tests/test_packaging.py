"""The files around the package agree with it and with one another."""

import re
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from scripts.licences import in_doubt, licence

ROOT = Path(__file__).resolve().parents[1]
PROJECTS: dict[str, Any] = {
    file.parent.name: tomllib.loads(file.read_text("utf-8"))["project"]
    for file in sorted(ROOT.glob("packages/*/pyproject.toml"))
}
PROJECT: dict[str, Any] = PROJECTS["optipromp"]


def text(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


@pytest.mark.parametrize("file", ["constraints.txt", "constraints-real.txt"])
def test_a_constraint_is_a_name_and_a_version(file: str) -> None:
    """pip refuses a constraint with extras, and what it is for would be skipped."""
    lines = (line for line in text(file).splitlines() if not line.startswith("#"))
    assert [line for line in lines if not re.fullmatch(r"[\w.-]+==[\w.+!-]+", line)] == []


def test_the_version_is_one() -> None:
    version = PROJECT["version"]
    assert len(PROJECTS) == 8
    assert {project["version"] for project in PROJECTS.values()} == {version}
    assert yaml.safe_load(text("CITATION.cff"))["version"] == version
    assert re.findall(r'set version = "(.+)"', text("conda/meta.yaml")) == [version]


@pytest.mark.parametrize("name", PROJECTS)
def test_a_package_is_whole(name: str) -> None:
    """Name, licence, classifiers, and this version of those of ours that it needs."""
    project, home = PROJECTS[name], f"packages/{name}"
    assert project["name"] == name
    assert text(f"{home}/LICENSE") == text("LICENSE")
    assert project["classifiers"] == PROJECT["classifiers"]
    ours = [each for each in project["dependencies"] if each.startswith("optipromp")]
    assert all(each.endswith(f"=={PROJECT['version']}") for each in ours)
    said = text(f"{home}/README.md").partition("It may import")[2].partition(".")[0]
    told = re.findall(r"`(optipromp[\w-]*)`", said)
    assert {each.partition("==")[0] for each in ours} == {*told} - {name}
    assert text(f"{home}/README.md").count("\n") <= 30


@pytest.mark.parametrize("file", sorted(ROOT.glob("packages/*/sockets/*/pyproject.toml")), ids=str)
def test_a_socket_has_the_name_that_lerobot_looks_for(file: Path) -> None:
    """And this version of ours; it imports the module that registers."""
    project = tomllib.loads(file.read_text("utf-8"))["project"]
    home, name = PROJECTS[file.parts[-4]], file.parent.name
    assert project["name"] == name
    assert name.startswith(("lerobot_policy_", "lerobot_env_"))
    assert project["version"] == home["version"]
    ours = [each for each in project["dependencies"] if "optipromp" in each]
    assert all(each.endswith(f"=={PROJECT['version']}") for each in ours)
    assert ours[0].startswith(home["name"])
    assert (file.parent / "LICENSE").read_text("utf-8") == text("LICENSE")
    (line,) = re.findall(
        "^import (.+)  # noqa", (file.parent / f"{name}.py").read_text("utf-8"), re.M
    )
    assert (file.parents[2] / "src" / f"{line.replace('.', '/')}.py").is_file()


def test_extras_that_are_named_exist() -> None:
    """Helps and examples told to install `sim`, `vision` and `calibrate`, which were none."""
    extras = {each for project in PROJECTS.values() for each in project["optional-dependencies"]}
    said = r"\bextras? [`'\"\[]+([\w-]+)|the extras? ([\w-]+)(?:[.,)]| and)"
    of = ("README.md", "docs/*.md", "examples/*.py", "packages/*/*.md", "packages/*/src/**/*.py")
    pages = {file: file.read_text("utf-8") for each in of for file in ROOT.glob(each)}
    named = {"".join(told): file for file, page in pages.items() for told in re.findall(said, page)}
    assert {"film", "mesh", "view"} <= named.keys()
    assert {extra: file for extra, file in named.items() if extra not in extras} == {}


def test_the_recipe_needs_what_the_package_needs() -> None:
    run = text("conda/meta.yaml").partition("  run:\n")[2].partition("\n\n")[0]
    wanted = {
        re.sub(r"[-_]base", "", line.strip(" -").replace(" ", "")) for line in run.split("\n")
    }
    assert wanted == {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}


def installed() -> dict[str, str]:
    """The licence of each package that is installed here for the package and its extras."""
    found: dict[str, str] = {}
    left = [Requirement(each) for name in PROJECTS for each in metadata.requires(name) or []]
    while left:
        wanted = left.pop()
        try:
            package = metadata.distribution(wanted.name)
        except metadata.PackageNotFoundError:
            continue  # of an extra that is not here
        if package.name in found:
            continue
        found[package.name] = licence(package.metadata.json)
        for each in map(Requirement, package.requires or []):
            extras = ["", *wanted.extras]
            if each.marker is None or any(each.marker.evaluate({"extra": x}) for x in extras):
                left.append(each)
    return found


def test_no_package_that_is_brought_has_a_licence_in_doubt() -> None:
    found = installed()
    assert {"numpy", "numba", "scipy"} <= {*found}
    assert {name: said for name, said in found.items() if in_doubt(name, said)} == {}


@pytest.mark.parametrize(
    ("said", "doubt"),
    [
        ("", True), ("GPL-3.0-only", True), ("MIT AND GPL-2.0-or-later", True), ("AGPLv3", True),
        ("GNU General Public License v3 (GPLv3)", True), ("BSD, Other/Proprietary", True),
        ("MIT OR GPL-3.0", False), ("LGPL-3.0-or-later", False), ("BSD License", False),
        ("GNU Lesser General Public License v2 (LGPLv2)", False),
    ],
)  # fmt: skip
def test_what_is_a_licence_in_doubt(said: str, doubt: bool) -> None:
    assert in_doubt("a-new-package", said) is doubt


@pytest.mark.parametrize(
    "path",
    [*(ROOT / ".github").rglob("*.yml"), ROOT / ".pre-commit-config.yaml"],
    ids=lambda path: path.name,
)
def test_the_forms_and_workflows_are_yaml(path: Path) -> None:
    held = yaml.safe_load(path.read_text("utf-8"))
    if path.parent.name == "ISSUE_TEMPLATE" and path.name != "config.yml":
        fields = held["body"]
        assert len({field["id"] for field in fields}) == len(fields) > 2
        assert held["name"]
        assert held["description"]
    if path.name == "tests.yml":
        matrix = held["jobs"]["tests"]["strategy"]["matrix"]
        said = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if " 3." in line]
        assert matrix["python"] == said
        assert {system.partition("-")[0] for system in matrix["os"]} == {
            "ubuntu", "macos", "windows"
        }  # fmt: skip
    if path.name == ".pre-commit-config.yaml":
        assert [repo["repo"] for repo in held["repos"]] == ["local"]


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "SECURITY.md", "README.md"])
def test_the_files_that_a_page_names_are_there(page: str) -> None:
    links = re.findall(r"\]\((?!http)([^)#]+)[^)]*\)", text(page))
    named = re.findall(
        r"`((?:[\w-]+/)+\w+\.py|packages/[\w/-]+|tests/\w+|(?:core|looks)/\w+)`", text(page)
    )
    core = ROOT / "packages/optipromp"
    places = ROOT, core / "src/optipromp", core / "tests", core.parent, *ROOT.glob("packages/*/src")
    assert not [x for x in links + named if not any((top / x).exists() for top in places)]
    assert links
